"""`TextureFit`: the texture of a known mesh from posed images, by linear least squares."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from scipy import sparse
from torch import Tensor

from ....base import validate
from ....optim.conjugate_gradients import ConjugateGradients
from ....raster.fragments import Fragments
from ...common.adjustable import Resumable
from ...common.texels import Texels
from ...common.views.views import WHOLE, Views, photos_of
from ..settings import DescentSettings, TextureSettings
from .outliers import weigh_views

_OUTLINE = 0.05  # weight of pixels next to an outline


class TextureFit(Resumable):
    """Fit the texture of a known mesh to posed images by linear least squares. Call `advance` until ``done``.

    With a fixed shape, images are linear in the texels: A x, with the gains of the views. The texture minimises ::

        Σ over pixels w (A x − photo)² + smooth · Σ over neighbouring texels (x_i − x_j)²

    by conjugate gradients. About 20 steps suffice. A step renders all views once and computes one gradient; the
    initialisation costs as much as four steps. Faces share the texels on their edges, so that there are no seams. The
    smoothness term fills texels that no pixel shows, and dominates where few pixels do.

    The weight w of a pixel is the squared cosine between ray and normal, because at grazing angles a small error of the
    shape shows the wrong place. Pixels next to an outline of the mesh or of a mask get a small weight, and a view in
    which a face has another colour than in most views, because something stands before it or it shines, a smaller one.

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
        >>> from neural_renderer.apps.fit import TextureFit, Views
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
        size: int = TextureSettings.size,
        steps: int = TextureSettings.steps,
        smooth: float = 0.05,
        batch: int = DescentSettings.batch,
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
        self._target = objective.target
        self._solver = ConjugateGradients(objective.multiply, objective.diagonal, self._target, colors)
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
    """Objective of a `TextureFit`, a quadratic function of the texels: its matrix, AᵀwA and the smoothness term.

    A has a row for each pixel. It is made and used up view by view, because the matrix is much smaller than all of A.
    ``target`` is Aᵀw · photo, ``diagonal`` an upper bound of the diagonal of the matrix, [texels, 3] both; ``constant``
    is the value at black texels, ``total_weight`` the sum of weights over pixels and channels.
    """

    def __init__(
        self, views: Views, vertices: Tensor, faces: Tensor, texels: Texels, smooth: float, batch: int
    ) -> None:
        gains = np.ones((len(views), 1), np.float32) if views.gains is None else views.gains.cpu().numpy()
        agreeing = weigh_views(views, vertices, faces)
        self._matrices = [sparse.csr_array((texels.count, texels.count), dtype=np.float32) for _ in gains[0]]
        target, row_sums = np.zeros((2, texels.count, 3), np.float32)
        self.constant = self.total_weight = 0.0
        for start in range(0, len(views), batch):
            part = views[start : start + batch]
            weights = _pixel_weights(part, vertices, faces) * agreeing[start : start + batch]
            photos = photos_of(part)
            self.constant += float((weights[:, None] * photos.square()).sum())
            self.total_weight += float(3 * weights.sum())
            pixels = _rows_of_pixels(part.fragments((vertices, faces)), weights > 0, texels)
            gain = np.repeat(gains[start : start + batch], pixels.shape[0] // len(part), 0)  # [pixels, 1 or 3]
            weighted = pixels.T.multiply(weights.flatten().cpu().numpy()).tocsr()
            for number, factor in enumerate(gain.T):
                left = weighted if views.gains is None else weighted.multiply(factor**2).tocsr()
                self._matrices[number] += left @ pixels
            target += weighted @ (gain * photos.movedim(1, 3).reshape(-1, 3).cpu().numpy())
            row_sums += weighted @ (gain**2 * pixels.sum(1)[:, None])
        self.total_weight = max(self.total_weight, 1e-6)
        ends = texels.edges().cpu().numpy()
        both = np.concatenate((ends, ends[:, ::-1]))
        joined = (np.full(len(both), -smooth, np.float32), (both[:, 0], both[:, 1]))
        degree = smooth * np.bincount(both[:, 0], minlength=texels.count).astype(np.float32)
        smoothness = sparse.coo_array(joined, shape=(texels.count,) * 2) + sparse.diags_array(degree)
        self._matrices = [(matrix + smoothness).tocsr() for matrix in self._matrices]
        # Rows of A are ≥ 0 and sum to at most 1, so that AᵀwA·1 bounds diag(AᵀwA).
        self.diagonal = torch.from_numpy(row_sums + degree[:, None]).to(vertices)
        self.target = torch.from_numpy(target).to(vertices)

    def multiply(self, values: Tensor) -> Tensor:
        """Multiply the matrix by values [texels, 3]."""
        columns = values.cpu().numpy()
        if len(self._matrices) == 1:
            product = self._matrices[0] @ columns
        else:
            product = np.stack([each @ columns[:, row] for row, each in enumerate(self._matrices)], 1)
        return torch.from_numpy(product).to(values)


def _rows_of_pixels(fragments: Fragments, counts: Tensor, texels: Texels) -> sparse.csr_array:
    """Make the rows of A of all pixels, [N · H · W, texels]; only pixels that count, [N, H, W] bool, have entries."""
    scale = fragments.settings.scale
    counts = counts.repeat_interleave(scale, 1).repeat_interleave(scale, 2) & fragments.mask
    image, y, x = np.nonzero(counts.cpu().numpy())
    pixel = (image * fragments.settings.height + y // scale) * fragments.settings.width + x // scale
    faces, weights = fragments.face_index[counts].cpu().numpy(), fragments.weights[counts].cpu().numpy()
    share = np.full(len(pixel), scale**-2, np.float32)
    shape = len(fragments.mask) * fragments.settings.height * fragments.settings.width, len(pixel)
    mean = sparse.coo_array((share, (pixel, np.arange(len(pixel)))), shape=shape)
    return mean.tocsr() @ texels.read(faces, weights, fragments.settings.eps)


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
    inside = -F.max_pool2d(-covered, 3, 1, 1) > WHOLE
    return images.rgb[:, 0].square() * torch.where(inside, 1.0, _OUTLINE * part.masks)
