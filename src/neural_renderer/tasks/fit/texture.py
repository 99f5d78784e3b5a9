"""`TextureFit`: the texture of a known mesh from posed images, by linear least squares."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import validate
from ..adjustable import Resumable
from ..texels import Texels
from .descent import ConjugateGradients
from .fit_views import Views, photos_of

_OUTLINE = 0.05  # weight of pixels beside an outline


class TextureFit(Resumable):
    """Fit the texture of a known mesh to posed images by linear least squares. Call `advance` until ``done``.

    With a fixed shape, images are linear in the texels: A x, with the gains of the views. The texture minimises ::

        Σ over pixels w (A x − photo)² + smooth · Σ over neighbouring texels (x_i − x_j)²

    by conjugate gradients. About 20 steps suffice. A step renders all views once and computes one gradient; the
    initialisation costs as much as four steps. Faces share the texels on their edges, so that there are no seams. The
    smoothness term fills texels that no pixel shows, and dominates where few pixels do.

    The weight w of a pixel is the squared cosine between ray and normal, because at grazing angles a small error of the
    shape shows the wrong place. Pixels beside an outline of the mesh or of a mask get a small weight.

    Args:
        views: Views with photos.
        vertices: [V, 3] float32, in the world of the views.
        faces: [F, 3] int32 or int64.
        size: T, texels along the edge of a face's texture cube, ≥ 3.
        steps: Number of steps, ≥ 1.
        smooth: Smoothness weight, > 0, relative to one pixel seen head-on.
        batch: Views rendered together. Affects memory only.

    Raises:
        TypeError, ValueError: An argument does not fit, or the views have no photos.

    Example:
        >>> from neural_renderer.tasks.fit import TextureFit, Views
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> fit = TextureFit(views, *nr.icosphere(2), steps=2)
        >>> torch.save(fit.state_dict(), "start.pt")
        >>> while not fit.done:
        ...     loss = fit.advance()["loss"]
        >>> fit.shape[2].shape
        torch.Size([320, 4, 4, 4, 3])
        >>> fit.load_state_dict(torch.load("start.pt"))  # back to the start
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
        photos = photos_of(views)
        self.steps = validate.whole("steps", steps, 1)
        self.step = 0
        self._vertices, self._faces = vertices.detach(), faces.long()
        self._texels = Texels.shared(self._faces, validate.whole("texture_size", size, 3))
        smooth, batch = validate.positive("smooth", smooth), validate.whole("batch", batch, 1)
        objective = _Objective(views, self._vertices, self._faces, self._texels, smooth, batch)
        colors = photos.new_empty(self._texels.count, 3)
        colors[:] = photos.sum((0, 2, 3)) / views.masks.sum()
        self._target = -objective.gradient(torch.zeros_like(colors), photos=True)
        self._solver = ConjugateGradients(objective.gradient, objective.diagonal(), self._target, colors)
        self._constant, self._total = objective.constant, objective.total_weight

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    @property
    def shape(self) -> tuple[Tensor, Tensor, Tensor]:
        """Vertices, faces and textures [F, T, T, T, 3] in [0, 1]."""
        return self._vertices, self._faces, self._texels.cubes(self._solver.solution).clamp(0, 1)

    def advance(self) -> dict[str, float]:
        """Take one step of conjugate gradients.

        Returns:
            "loss" before the step: the objective, divided by the sum of pixel weights over pixels and channels.
        """
        solver = self._solver
        loss = self._constant - (solver.solution * (solver.residual + self._target)).sum().item()
        solver.advance()
        self.step += 1
        return {"loss": max(loss, 0.0) / self._total}

    def state_dict(self) -> dict[str, Any]:
        state = {"step": self.step, "vertices": self._vertices, "faces": self._faces}
        return state | {"solver": self._solver.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.step = state["step"]
        self._solver.load_state_dict(state["solver"])


class _Objective:
    """Objective of a `TextureFit`, a quadratic function of the texels.

    Attributes:
        constant: Value at black texels.
        total_weight: Sum of the weights of pixels, over pixels and channels.
    """

    def __init__(
        self, views: Views, vertices: Tensor, faces: Tensor, texels: Texels, smooth: float, batch: int
    ) -> None:
        self._vertices, self._faces, self._texels, self._smooth = vertices, faces, texels, smooth
        self._edges = texels.edges()
        self._parts = [views[start : start + batch] for start in range(0, len(views), batch)]
        self._weights = [_pixel_weights(part, vertices, faces) for part in self._parts]
        squares = [
            (weights[:, None] * photos_of(part).square()).sum()
            for part, weights in zip(self._parts, self._weights, strict=True)
        ]
        self.constant = float(torch.stack(squares).sum())
        self.total_weight = max(float(3 * torch.cat(self._weights).sum()), 1e-6)

    def gradient(self, values: Tensor, photos: bool = False) -> Tensor:
        """Compute half the gradient at values [texels, 3]; without photos, of the quadratic part alone."""
        values = values.detach().requires_grad_()
        total = torch.zeros_like(values)
        for part, weights in zip(self._parts, self._weights, strict=True):
            rgb = part.draw((self._vertices, self._faces, self._texels.cubes(values)), "rgb").rgb
            error = rgb.detach() - photos_of(part) if photos else rgb.detach()
            total += torch.autograd.grad(rgb, values, weights[:, None] * error)[0]
        values = values.detach()
        first, second = self._edges.unbind(1)
        difference = self._smooth * (values[first] - values[second])
        return total.index_add_(0, first, difference).index_add_(0, second, -difference)

    def diagonal(self) -> Tensor:
        """Compute an upper bound [texels, 3] of the diagonal of the quadratic part.

        Rows of the matrix A from texels to pixels are ≥ 0 and sum to at most 1, so that AᵀwA·1 bounds diag(AᵀwA).
        """
        count = self._texels.count
        neighbors = torch.bincount(self._edges.reshape(-1), minlength=count)[:, None]
        return self.gradient(self._vertices.new_ones(count, 3)) + self._smooth * neighbors


def _pixel_weights(part: Views, vertices: Tensor, faces: Tensor) -> Tensor:
    """Compute the weight of each pixel, [N, H, W] in [0, 1]; see `TextureFit`."""
    corners = vertices[faces]
    normals = F.normalize(torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=1)
    eyes, forward = part.eyes()
    rays = eyes[:, None] - corners.mean(1) if part.camera.perspective else -forward[:, None].expand(-1, len(faces), -1)
    rays = F.normalize(rays, dim=2)
    cosines = (rays * normals).sum(2).abs()[..., None, None, None, None].expand(-1, -1, 2, 2, 2, 3)
    with torch.no_grad():
        images = replace(part, gains=None).draw((vertices, faces, cosines.contiguous()), ("rgb", "alpha"))
    covered = torch.minimum(part.masks, images.alpha)
    inside = -F.max_pool2d(-covered, 3, 1, 1) > 0.999
    return images.rgb[:, 0].square() * torch.where(inside, 1.0, _OUTLINE * part.masks)
