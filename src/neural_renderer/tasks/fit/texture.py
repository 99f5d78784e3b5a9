"""The texture: colours until the images of a mesh are those of the views."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ... import losses, validate
from ...io.cubes import barycentric_grid
from ...optim import Adam
from ...topology import Topology
from .descent import SmoothDescent
from .views import Views, chosen


class TextureFit:
    """Descent on the colours of a mesh, step by step: call `advance` until ``done``.

    First the vertices have colours, whose gradient is blurred over the surface, so that what no view shows gets the
    colours around it. From a third of the steps on each texel goes its own way.

    Args:
        views: with photos.
        vertices, faces: [V, 3] float32 and [F, 3], the mesh in the views' world.
        colours: [V, 3] in about [0, 1] to begin with, or None for grey.
        size: T, texels along the edge of a face's cube, at least 2.
        steps: how many steps there are.
        batch: views that are looked at in a step.
        seed: of the views' order.
    """

    def __init__(
        self,
        views: Views,
        vertices: Tensor,
        faces: Tensor,
        *,
        colours: Tensor | None = None,
        size: int = 4,
        steps: int = 150,
        batch: int = 6,
        seed: int = 0,
    ) -> None:
        if views.photos is None:
            raise ValueError("views: expected photos to take colours from, got silhouettes only")
        self.steps = validate.whole("steps", steps, 1)
        self.step = 0
        self._views, self._vertices, self._faces = views, vertices.detach(), faces.long()
        self._size, self._seed = validate.whole("size", size, 2), seed
        self._batch = min(validate.whole("batch", batch, 1), len(views))
        self._colours = torch.full_like(self._vertices, 0.5) if colours is None else colours.detach()
        self._descent = SmoothDescent(Topology.of(self._faces), 1.0)
        self._cubes: Tensor | None = None

    @property
    def done(self) -> bool:
        """Whether all steps are taken."""
        return self.step >= self.steps

    @property
    def shape(self) -> tuple[Tensor, Tensor, Tensor]:
        """Vertices, faces and textures [F, T, T, T, 3] in [0, 1]."""
        cubes = blended_cubes(self._colours, self._faces, self._size) if self._cubes is None else self._cubes
        return self._vertices, self._faces, cubes.detach().clamp(0, 1)

    def advance(self) -> dict[str, float]:
        """Take one step; returns the ``loss``, the mean squared difference of colours on the object, before it."""
        if self._cubes is None and self.step >= self.steps // 3:
            self._start_texels(self.shape[2])
        part = self._views[chosen(len(self._views), self._batch, self._seed, self.step)]
        slow = 1.02 - self.step / self.steps
        if self._cubes is None:
            colours = self._colours.requires_grad_()
            loss = self._loss(part, blended_cubes(colours, self._faces))
            (gradient,) = torch.autograd.grad(loss, colours)
            self._colours = self._descent.step(colours.detach(), gradient, 0.2 * slow)
        else:
            loss = self._loss(part, self._cubes)
            self._optimizer.param_groups[0]["lr"] = 0.05 * slow
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
        self.step += 1
        return {"loss": loss.item()}

    def _loss(self, part: Views, cubes: Tensor) -> Tensor:
        images = part.draw((self._vertices, self._faces, cubes), "rgb")
        return losses.photometric(images.rgb, part.photos, part.masks)  # type: ignore[arg-type]

    def _start_texels(self, cubes: Tensor) -> None:
        self._cubes = cubes.clone().requires_grad_()
        self._optimizer = Adam([self._cubes])

    def state_dict(self) -> dict[str, Any]:
        """All that changes from step to step, and the shape."""
        state = {
            "step": self.step,
            "vertices": self._vertices,
            "faces": self._faces,
            "colours": self._colours.detach(),
            "descent": self._descent.state_dict(),
            "cubes": None,
        }
        if self._cubes is not None:
            state |= {"cubes": self._cubes.detach(), "optimizer": self._optimizer.state_dict()}
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self.step, self._colours = state["step"], state["colours"]
        self._descent.load_state_dict(state["descent"])
        if state["cubes"] is not None:
            self._start_texels(state["cubes"])
            self._optimizer.load_state_dict(state["optimizer"])


def blended_cubes(colours: Tensor, faces: Tensor, size: int = 2) -> Tensor:
    """Cubes [F, T, T, T, 3] that blend the colours [V, 3] of each face's corners."""
    weights = torch.from_numpy(barycentric_grid(size)).to(colours)
    cubes = torch.einsum("gk,fkc->fgc", weights, colours[faces])
    return cubes.reshape(len(faces), size, size, size, 3)
