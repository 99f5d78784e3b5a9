"""The texture: the colours with which the images of a mesh are those of the views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import validate
from ..texels import Texels
from .fit_views import Views

_OUTLINE = 0.05  # a pixel beside an outline counts so much
_CHANGING = ("_colours", "_residual", "_direction", "_product")


class TextureFit:
    """The colours of a mesh by linear least squares, step by step: call `advance` until ``done``.

    The image of a known shape is linear in its texels x, an A x, so that the best texture is the minimum of

        Σ over pixels w (A x − photo)² + smooth Σ over neighbouring texels (x_i − x_j)²

    which conjugate gradients find in some twenty steps, each of which draws all views once and takes the gradient once;
    four more are the preparation.
    Faces share the texels on their edges, so that no seam can appear; a texel that no pixel shows gets the colours
    around it, and one that few show is drawn to them.

    The weight w of a pixel is the squared cosine of the angle at which it sees the surface: where that is flat, a shape
    that is a little off shows the wrong place. Beside an outline, of the mesh's or the photo's, it is small.

    Args:
        views: with photos.
        vertices, faces: [V, 3] float32 and [F, 3], the mesh in the views' world.
        size: T, texels along the edge of a face's cube, at least 3.
        steps: how many steps there are.
        smooth: what it counts that neighbours are alike, beside a pixel that shows one of them squarely; above 0.
        batch: views that are drawn together, which costs memory, not accuracy.

    Raises:
        TypeError, ValueError: what does not fit; views without photos.
    """

    def __init__(
        self,
        views: Views,
        vertices: Tensor,
        faces: Tensor,
        *,
        size: int = 4,
        steps: int = 20,
        smooth: float = 0.05,
        batch: int = 6,
    ) -> None:
        if views.photos is None:
            raise ValueError("views: expected photos to take colours from, got silhouettes only")
        self.steps = validate.whole("steps", steps, 1)
        self.step = 0
        self._vertices, self._faces = vertices.detach(), faces.long()
        self._texels = Texels.shared(self._faces, validate.whole("texture_size", size, 3))
        self._edges = self._texels.edges()
        self._smooth = validate.positive("smooth", smooth)
        batch = validate.whole("batch", batch, 1)
        self._parts = [views[start : start + batch] for start in range(0, len(views), batch)]
        self._photos = views.photos.split(batch)
        self._weights = [_weights(part, self._vertices, self._faces) for part in self._parts]
        self._colours = views.photos.new_empty(self._texels.count, 3)
        self._colours[:] = views.photos.sum((0, 2, 3)) / views.masks.sum()
        # Rows of A are shares of a pixel: the product with ones bounds the diagonal, the preconditioner, from above.
        neighbours = torch.bincount(self._edges.reshape(-1), minlength=self._texels.count)[:, None]
        self._diagonal = self._gradient(torch.ones_like(self._colours)) + self._smooth * neighbours
        self._target = -self._gradient(torch.zeros_like(self._colours), self._photos)
        self._residual = self._target - self._gradient(self._colours)
        self._direction = self._residual / self._diagonal
        self._product = (self._residual * self._direction).sum(0)
        pairs = zip(self._weights, self._photos, strict=True)
        self._constant = float(
            torch.stack([(weights[:, None] * photos.square()).sum() for weights, photos in pairs]).sum()
        )
        self._total = max(float(3 * torch.cat(self._weights).sum()), 1e-6)

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    @property
    def shape(self) -> tuple[Tensor, Tensor, Tensor]:
        """Vertices, faces and textures [F, T, T, T, 3] in [0, 1]."""
        return self._vertices, self._faces, self._texels.cubes(self._colours).clamp(0, 1)

    def advance(self) -> dict[str, float]:
        """Take one step; returns the ``loss``, the sum above for each pixel's weight and channel, before it."""
        image = self._gradient(self._direction)
        loss = self._constant - (self._colours * (self._residual + self._target)).sum().item()
        length = self._product / (self._direction * image).sum(0).clamp(min=1e-30)
        self._colours = self._colours + length * self._direction
        self._residual = self._residual - length * image
        scaled = self._residual / self._diagonal
        product, before = (self._residual * scaled).sum(0), self._product
        self._direction, self._product = scaled + product / before.clamp(min=1e-30) * self._direction, product
        self.step += 1
        return {"loss": max(loss, 0.0) / self._total}

    def _gradient(self, values: Tensor, photos: Sequence[Tensor] | None = None) -> Tensor:
        """Half the gradient of the sum above at values [texels, 3]; without photos that of its quadratic part."""
        values = values.detach().requires_grad_()
        total = torch.zeros_like(values)
        for index, (part, weights) in enumerate(zip(self._parts, self._weights, strict=True)):
            rgb = part.draw((self._vertices, self._faces, self._texels.cubes(values)), "rgb").rgb
            error = rgb.detach() if photos is None else rgb.detach() - photos[index]  # type: ignore[union-attr]
            total += torch.autograd.grad(rgb, values, weights[:, None] * error)[0]  # type: ignore[arg-type]
        values = values.detach()
        first, second = self._edges.unbind(1)
        apart = self._smooth * (values[first] - values[second])
        return total.index_add_(0, first, apart).index_add_(0, second, -apart)

    def state_dict(self) -> dict[str, Any]:
        """All that changes from step to step, and the shape."""
        state = {"step": self.step, "vertices": self._vertices, "faces": self._faces}
        return state | {name: getattr(self, name) for name in _CHANGING}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.step = state["step"]
        for name in _CHANGING:
            setattr(self, name, state[name])


def _weights(part: Views, vertices: Tensor, faces: Tensor) -> Tensor:
    """How much each pixel of some views tells of colours, [N, H, W] in [0, 1]; see `TextureFit`."""
    corners = vertices[faces]
    normals = F.normalize(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=1)
    eyes, forward = part.eyes()
    rays = eyes[:, None] - corners.mean(1) if part.camera.perspective else -forward[:, None].expand(-1, len(faces), -1)
    rays = F.normalize(rays, dim=2)
    cosines = (rays * normals).sum(2).abs()[..., None, None, None, None].expand(-1, -1, 2, 2, 2, 3)
    with torch.no_grad():
        images = part.draw((vertices, faces, cosines.contiguous()), ("rgb", "alpha"))
    covered = torch.minimum(part.masks, images.alpha)  # type: ignore[arg-type]
    inside = -F.max_pool2d(-covered, 3, 1, 1) > 0.999
    return images.rgb[:, 0].square() * torch.where(inside, 1.0, _OUTLINE * part.masks)  # type: ignore[index]
