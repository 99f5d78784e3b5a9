"""Views of a surface in [-1, 1]³ from outside, and `Silhouettes`, the error of another surface in them."""

from __future__ import annotations

import torch
from torch import Tensor

from ....camera import Camera
from ....rendering.forward import render
from ...compare.stage import sphere_points

_VIEWS, _PIXELS = 12, 256
_APART = 0.2  # difference of depths beyond which a pixel shows another part


def cameras_outside(count: int) -> Camera:
    """Make cameras around the cube, which see all of it, without perspective."""
    return Camera.look_at(4 * sphere_points(count).float(), orthographic=True, scale=1 / 1.75)


class Silhouettes:
    """Silhouettes of a surface of vertices [V, 3] in [-1, 1]³ and faces [F, 3], and of its parts before others."""

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        self._cameras = cameras_outside(_VIEWS)
        self._alpha, self._depth = self._draw(vertices, faces)

    def error(self, vertices: Tensor, faces: Tensor) -> float:
        """Compute the area that one of two surfaces covers alone, or at another depth, relative to that of this one."""
        alpha, depth = self._draw(vertices, faces)
        both = torch.minimum(alpha, self._alpha)
        different = (alpha - self._alpha).abs() + both * ((depth - self._depth).abs() > _APART)
        return float(different.sum() / self._alpha.sum().clamp(min=1e-9))

    @torch.no_grad()
    def _draw(self, vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
        scene = vertices.float(), faces.int()
        images = render(scene, self._cameras, _PIXELS, light=None, outputs=("alpha", "depth"))
        return images.alpha, images.depth
