"""`Layout`: which face, and which point of it, each texel of the charts shows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from ...rendering.forward import render


@dataclass(frozen=True, eq=False)
class Layout:
    """Texels of a square image that faces cover in texture coordinates, with a border of a few texels.

    Attributes:
        size: Side of the image.
        texels: [N] int64, row · size + column, rows from the top.
        faces: [N] int64, the face of each texel.
        weights: [N, 3] float32, barycentric weights of its centre; outside of the face they extrapolate.
        inside: [N] bool, whether a face covers the centre.
    """

    size: int
    texels: Tensor
    faces: Tensor
    weights: Tensor
    inside: Tensor

    @classmethod
    @torch.no_grad()
    def of(cls, uv: Tensor, size: int, margin: int) -> Layout:
        """Find the texels of charts [F, 3, 2] in [0, 1], v up, and those up to ``margin`` texels away."""
        clip = functional.pad(2 * uv.reshape(-1, 2) - 1, (0, 2), value=1.0)
        faces = torch.arange(len(clip)).view(-1, 3)
        drawn = render((clip, faces), None, size, light=None, outputs=("face_index",), anti_aliasing=False)
        index = drawn.face_index[0].long()
        inside = index >= 0
        for _ in range(margin):
            index = _grown(index)
        texels = torch.nonzero(index.flatten() >= 0)[:, 0]
        face = index.flatten()[texels]
        at = torch.stack((texels % size + 0.5, size - texels.div(size, rounding_mode="floor") - 0.5), 1) / size
        return cls(size, texels, face, _weights(at, uv[face]), inside.flatten()[texels])

    def image(self, values: Tensor) -> Tensor:
        """Make an image [size, size, C] of values [N, C] of the texels; 0 elsewhere."""
        flat = values.new_zeros(self.size**2, values.shape[1])
        flat[self.texels] = values
        return flat.view(self.size, self.size, -1)

    @property
    def shown(self) -> Tensor:
        """The texels that have a face, [size, size] bool."""
        flat = torch.zeros(self.size**2, dtype=torch.bool)
        flat[self.texels] = True
        return flat.view(self.size, self.size)


def _grown(index: Tensor) -> Tensor:
    """Give texels without a face, −1, that of one of the four next to them."""
    padded = functional.pad(index, (1, 1, 1, 1), value=-1)
    around = torch.stack((padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]))
    return torch.where(index < 0, around.amax(0), index)


def _weights(at: Tensor, corners: Tensor) -> Tensor:
    """Compute the barycentric weights [N, 3] of points [N, 2] in triangles [N, 3, 2]; those of slivers are bounded."""
    a, b, c = corners.double().unbind(1)
    p = at.double()
    area = _cross(b - a, c - a)
    area = torch.where(area.abs() < 1e-20, 1e-20, area)
    second, third = _cross(p - a, c - a) / area, _cross(b - a, p - a) / area
    weights = torch.stack((1 - second - third, second, third), 1).clamp(-3, 4)
    return (weights / weights.sum(1, keepdim=True).clamp(min=0.25)).float()


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
