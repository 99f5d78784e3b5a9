"""The shape: vertices moved until the mesh has the silhouettes of the views and, if it has colours, their colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ... import losses, validate
from ...io.cubes import barycentric_grid
from ...meshes.topology import Topology
from .descent import SmoothDescent
from .fit_views import Views, agreement, chosen


@dataclass(frozen=True)
class Weights:
    """How much each loss of `losses` counts; 0: not at all. The unit of length is half the object's longest side.

    Bends and lengths shrink as a mesh gets finer. The weights on them are those of a mesh of 10,000 vertices, and are
    converted for others.
    """

    silhouette: float = 1.0
    """1 - intersection over union of the silhouettes."""
    photometric: float = 4.0
    """Mean squared difference of the colours, once vertices have colours."""
    laplacian: float = 100.0
    """Squared distance of a vertex to the mean of its neighbours."""
    edge_length: float = 0.0
    """Mean squared length of edges."""
    normal_consistency: float = 0.2
    """1 - cosine of the angle between neighbouring faces."""
    smoothness: float = 0.0
    """The paper's smoothness loss, a sum over edges."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if validate.number(name, value) < 0:
                raise ValueError(f"{name}: expected a weight of at least 0, got {value}")


class ShapeFit:
    """Descent on the vertices, step by step: call `advance` until ``done``.

    Args:
        views: `moved` so that the object lies in about [-1, 1].
        vertices: [V, 3] float32, where it begins.
        faces: [F, 3] int32 or int64.
        steps: how many steps there are.
        subdivisions: how often, evenly over the steps, each face is cut in four: coarse to fine. 0 for a start that is
            fine already.
        colour_from: the part of the steps in [0, 1] after which vertices have colours too, which follow the photos
            together with the shape; 1, or views without photos: never.
        weights: of the losses.
        rate: how far the fastest vertex moves in a step.
        smooth: λ of `SmoothDescent`.
        batch: views that are looked at in a step.
        gradient: the renderer's estimator through visibility.
        seed: of the views' order.
    """

    _vertices: Tensor
    _faces: Tensor
    _colours: Tensor | None
    _topology: Topology
    _descent: SmoothDescent
    _colour_descent: SmoothDescent

    def __init__(
        self,
        views: Views,
        vertices: Tensor,
        faces: Tensor,
        *,
        steps: int = 150,
        subdivisions: int = 0,
        colour_from: float = 1.0,
        weights: Weights = Weights(),
        rate: float = 0.01,
        smooth: float = 8.0,
        batch: int = 6,
        gradient: str = "edge",
        seed: int = 0,
    ) -> None:
        self.steps = validate.whole("steps", steps, 1)
        self.step = 0
        self._views, self._weights, self._gradient = views, weights, gradient
        self._rate, self._smooth = validate.positive("rate", rate), smooth
        self._batch, self._seed = min(validate.whole("batch", batch, 1), len(views)), seed
        self._subdivisions, self._refined = validate.whole("subdivisions", subdivisions, 0), 0
        if not 0 <= validate.number("colour_from", colour_from) <= 1:
            raise ValueError(f"colour_from: expected a part in [0, 1], got {colour_from}")
        self._colour_from = self.steps if views.photos is None else round(colour_from * self.steps)
        self._have(vertices.detach().clone(), faces.long(), None)

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    @property
    def shape(self) -> tuple[Tensor, ...]:
        """What there is now, as the renderer takes it: vertices, faces and, if vertices have colours, textures."""
        if self._colours is None:
            return self._vertices, self._faces
        return self._vertices, self._faces, _blended(self._colours, self._faces).clamp(0, 1)

    def advance(self) -> dict[str, float]:
        """Take one step; returns the ``loss`` and the mean ``iou`` of the views it looked at, before it."""
        while self._refined < min(self._subdivisions, self.step * (self._subdivisions + 1) // self.steps):
            self._refine()
        if self.step == self._colour_from and self._colours is None:
            self._have(self._vertices, self._faces, torch.full_like(self._vertices, 0.5))
        part = self._views[chosen(len(self._views), self._batch, self._seed, self.step)]
        moving = [self._vertices.requires_grad_()]
        shape: tuple[Tensor, ...] = moving[0], self._faces
        if self._colours is not None:
            moving.append(self._colours.requires_grad_())
            shape = (*shape, _blended(moving[1], self._faces))
        images = part.draw(shape, "alpha" if self._colours is None else ("rgb", "alpha"), self._gradient)
        weights, topology = self._weights, self._topology
        loss = weights.silhouette * losses.silhouette_iou_loss(images.alpha, part.masks)  # type: ignore[arg-type]
        if self._colours is not None:
            loss = loss + weights.photometric * losses.photometric(images.rgb, part.photos, part.masks)  # type: ignore[arg-type]
        for name in ("laplacian", "edge_length", "normal_consistency", "smoothness"):
            if getattr(weights, name):
                # On V vertices edges are as long as V⁻½; offsets from neighbours, and so bends, are their squares.
                finer = (len(moving[0]) / 10_000) ** (2 if name == "laplacian" else 1)
                loss = loss + finer * getattr(weights, name) * getattr(losses, name)(moving[0], topology)
        gradients = torch.autograd.grad(loss, moving)
        slow = min(1.0, 2 * (1 - self.step / self.steps) + 0.05)  # from half of the way on, ever smaller steps
        self._vertices = self._descent.step(self._vertices.detach(), gradients[0], self._rate * slow)
        if self._colours is not None:
            self._colours = self._colour_descent.step(self._colours.detach(), gradients[1], 0.1 * slow)
        self.step += 1
        return {"loss": loss.item(), "iou": agreement(images.alpha, part.masks).mean().item()}  # type: ignore[arg-type]

    def _have(self, vertices: Tensor, faces: Tensor, colours: Tensor | None) -> None:
        self._vertices, self._faces, self._colours = vertices, faces, colours
        self._topology = Topology.of(faces)
        self._descent = SmoothDescent(self._topology, self._smooth)
        self._colour_descent = SmoothDescent(self._topology, 1.0)

    def _refine(self) -> None:
        """Each face in four, at the middles of its edges."""
        edges, faces, count = self._topology.edges, self._faces, len(self._vertices)
        sides = torch.stack((faces, faces.roll(-1, 1)), -1)  # ab, bc, ca
        key = sides.amin(-1) * count + sides.amax(-1)
        ab, bc, ca = (torch.searchsorted(edges[:, 0] * count + edges[:, 1], key) + count).unbind(1)
        a, b, c = faces.unbind(1)
        children = torch.stack([torch.stack(f, 1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))], 1)

        def finer(values: Tensor | None) -> Tensor | None:
            return None if values is None else torch.cat((values, values[edges].mean(1)))

        vertices = torch.cat((self._vertices, self._vertices[edges].mean(1)))
        self._have(vertices, children.reshape(-1, 3), finer(self._colours))
        self._refined += 1

    def state_dict(self) -> dict[str, Any]:
        """All that changes from step to step."""
        return {
            "step": self.step,
            "refined": self._refined,
            "vertices": self._vertices.detach(),
            "faces": self._faces,
            "colours": None if self._colours is None else self._colours.detach(),
            "descent": self._descent.state_dict(),
            "colour_descent": self._colour_descent.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.step, self._refined = state["step"], state["refined"]
        self._have(state["vertices"], state["faces"], state["colours"])
        self._descent.load_state_dict(state["descent"])
        self._colour_descent.load_state_dict(state["colour_descent"])


def _blended(colours: Tensor, faces: Tensor) -> Tensor:
    """Cubes [F, 2, 2, 2, 3] that blend the colours [V, 3] of each face's corners."""
    weights = torch.from_numpy(barycentric_grid(2)).to(colours)
    return torch.einsum("gk,fkc->fgc", weights, colours[faces]).reshape(len(faces), 2, 2, 2, 3)
