"""A whole fit: from views to a textured mesh, in the world of their cameras."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor

from ... import validate
from ...meshes.mesh import Mesh
from ...meshes.primitives import icosphere
from ...pictures.clay import plain_texture
from .fit_views import Views
from .hull import carve, frame
from .shape import ShapeFit, Weights
from .texture import TextureFit


class MeshFit:
    """The shape and then the texture of what views show, step by step: call `advance` until ``done``.

    >>> fit = MeshFit(load_views("photos"))
    >>> while not fit.done:
    ...     fit.advance()
    >>> fit.mesh().save("object.glb")

    Args:
        views: with or without photos; without them there is no texture to be found.
        start: "hull", the visual hull of the silhouettes; "sphere"; or a `Mesh` in the world of the cameras.
        recover: "shape" moves the vertices, "texture" leaves the given mesh as it is.
        steps, texture_steps: for the shape and for the texture, at least 1 each.
        cells: along each side of the grid that the hull is carved from, at least 8.
        texture_size: T, texels along the edge of a face's cube, at least 3.
        colour_from, weights, batch, gradient, seed: see `ShapeFit`.

    Raises:
        TypeError, ValueError: what does not fit; silhouettes that have no point in common.
    """

    def __init__(
        self,
        views: Views,
        start: Literal["hull", "sphere"] | Mesh = "hull",
        *,
        recover: Literal["shape", "texture"] = "shape",
        steps: int = 150,
        texture_steps: int = 20,
        cells: int = 64,
        texture_size: int = 4,
        colour_from: float = 1.0,
        weights: Weights = Weights(),  # noqa: B008 (immutable)
        batch: int = 6,
        gradient: str = "edge",
        seed: int = 0,
    ) -> None:
        if recover == "texture" and not isinstance(start, Mesh):
            raise ValueError("start: expected the mesh whose texture is looked for, got none")
        self._centre, self._scale = frame(views)
        self.views = views.moved(self._centre, self._scale)
        """The views of a world in which the object lies in about [-1, 1]."""
        self._texture_options = {
            "size": validate.whole("texture_size", texture_size, 3),
            "steps": validate.whole("texture_steps", texture_steps, 1),
            "batch": batch,
        }
        self._shape_options = {"steps": steps, "weights": weights, "gradient": gradient, "colour_from": colour_from}
        self._shape_options |= {"batch": batch, "seed": seed}
        if start == "sphere":  # which is coarse, and far from what it becomes
            self._shape_options |= {"subdivisions": 2, "rate": 0.03}
        vertices, faces = self._start(start, validate.whole("cells", cells, 8))
        self.phase = recover
        self._fit: ShapeFit | TextureFit = self._begun(vertices, faces)

    @property
    def step(self) -> int:
        """Steps taken in this phase."""
        return self._fit.step

    @property
    def steps(self) -> int:
        """Steps of this phase."""
        return self._fit.steps

    @property
    def done(self) -> bool:
        """Whether all phases are over."""
        return self._fit.done and (self.phase == "texture" or self.views.photos is None)

    @property
    def shape(self) -> tuple[Tensor, ...]:
        """The mesh as it is now, in the world of ``views``: vertices, faces and, as soon as it has any, textures."""
        return tuple(part.detach() for part in self._fit.shape)

    def placed(self, views: Views) -> Views:
        """Other views of the same cameras' world, in the world of ``views``."""
        return views.moved(self._centre, self._scale)

    def mesh(self) -> Mesh:
        """The mesh as it is now, in the world of the cameras; without colours it is the blue of clay."""
        vertices, faces, textures = with_texture(self.shape)
        return Mesh(vertices * self._scale + self._centre, faces, textures)

    def advance(self) -> dict[str, float]:
        """Take one step; returns its ``loss`` and, while the shape is looked for, the mean ``iou`` of its views."""
        if self._fit.done and not self.done:
            vertices, faces, *_ = self.shape
            self.phase = "texture"
            self._fit = self._begun(vertices, faces)
        return self._fit.advance()

    def state_dict(self) -> dict[str, Any]:
        """All that changes from step to step."""
        return {"phase": self.phase, "fit": self._fit.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` of a fit of the same views was taken."""
        self.phase = state["phase"]
        self._fit = self._begun(state["fit"]["vertices"], state["fit"]["faces"])
        self._fit.load_state_dict(state["fit"])

    def _begun(self, vertices: Tensor, faces: Tensor) -> ShapeFit | TextureFit:
        if self.phase == "shape":
            return ShapeFit(self.views, vertices, faces, **self._shape_options)  # type: ignore[arg-type]
        return TextureFit(self.views, vertices, faces, **self._texture_options)

    def _start(self, start: Any, cells: int) -> tuple[Tensor, Tensor]:
        device = self.views.masks.device
        if isinstance(start, Mesh):
            corners = start.vertices.detach()[start.faces[(start.faces >= 0).all(1)].long()].to(device)
            # Files split vertices where texture coordinates jump; here what lies in one place is one vertex.
            placed = (corners.flatten(0, 1) - self._centre) / self._scale
            vertices, faces = torch.unique(placed, dim=0, return_inverse=True)
            faces = faces.view(-1, 3)
            if not bool(self.views.quality((vertices, faces))["iou"].any()):
                raise ValueError("start: expected a mesh in the world of the cameras, got one that meets no silhouette")
            return vertices, faces
        if start == "hull":
            return carve(self.views, cells)
        if start != "sphere":
            raise ValueError(f'start: expected "hull", "sphere" or a Mesh, got {start!r}')
        vertices, faces = icosphere(3, 0.6)
        return vertices.to(device), faces.to(device)


def with_texture(shape: tuple[Tensor, ...]) -> tuple[Tensor, Tensor, Tensor]:
    """Return vertices, faces and textures of a shape; a shape without textures gets the colour of clay."""
    return shape if len(shape) == 3 else (shape[0], shape[1], plain_texture(shape[1]))
