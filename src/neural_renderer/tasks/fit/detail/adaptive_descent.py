"""Gradient descent on a mesh that is remeshed as it moves."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ....meshes.remeshing.edges import Edges, lengths
from ....meshes.remeshing.remesh import remesh_once
from ....meshes.remeshing.surface import Surface

_MEAN_DECAY, _SQUARE_DECAY = 0.8, 0.9  # Adam's β₁ and β₂
_LEAST_SIZE = 1e-12  # of a gradient; smaller ones move nothing
_STEADY = 0.3  # length of a mean step, of at most 1, from which faces become coarser
_GAIN = 0.2  # relative change of the target length in a step, for a difference of 1 from `_STEADY`
_EVERY = 2  # steps from one remeshing to the next
_RELAX = 0.3  # strength of the smoothing along the surface


class AdaptiveDescent:
    """Descent on vertices whose steps and faces have the scale of the detail that is being found.

    The step of a vertex is Adam's, with one size for its three coordinates, times the target length of the edges around
    it. Where steps agree with each other the surface still moves, and larger faces move faster: the target grows.
    Where they do not, what is missing is finer than the faces: the target shrinks. After Palfinger, "Continuous
    remeshing for inverse rendering" (2022).

    Args:
        vertices: [V, 3] float32, initial positions.
        faces: [F, 3] int64.

    Attributes:
        surface: The mesh; its values are positions, target lengths, and the running means of gradients.

    Example:
        >>> from neural_renderer.tasks.fit.detail.adaptive_descent import AdaptiveDescent
        >>> descent = AdaptiveDescent(*nr.icosphere(2))
        >>> for _ in range(10):  # grow
        ...     descent.step(-descent.vertices, rate=0.3, smooth=0.0, least=0.1, most=0.2)
        >>> descent.vertices.norm(dim=1).min() > 1.2
        tensor(True)
    """

    surface: Surface

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        vertices, faces = vertices.detach(), faces.long()
        size = lengths(vertices, Edges.of(faces, len(vertices)).ends).mean()
        target = size.expand(len(vertices), 1)
        state = vertices.new_zeros(len(vertices), 4)  # mean gradient and mean squared gradient
        self.surface = Surface(torch.cat((vertices, target, state), 1), faces).compact()
        self._count = 0

    @property
    def vertices(self) -> Tensor:
        """Current positions, [V, 3]."""
        return self.surface.vertices

    @property
    def faces(self) -> Tensor:
        """Current faces, [F, 3] int64."""
        return self.surface.faces

    def step(self, gradient: Tensor, *, rate: float, smooth: float, least: float, most: float) -> None:
        """Take one step of descent, and at every second step remesh.

        Args:
            gradient: [V, 3], gradient of the loss.
            rate: Length of a steady step, relative to the target length.
            smooth: Share of the way to the mean of its neighbours that each vertex moves, too.
            least, most: Limits of the target length, in world units.
        """
        vertices, target, mean, square = self.surface.values.split((3, 1, 3, 1), 1)
        self._count += 1
        mean = _MEAN_DECAY * mean + (1 - _MEAN_DECAY) * gradient
        square = _SQUARE_DECAY * square + (1 - _SQUARE_DECAY) * gradient.square().sum(1, keepdim=True)
        size = (square / (1 - _SQUARE_DECAY**self._count)).sqrt().clamp(min=_LEAST_SIZE)
        step = mean / (1 - _MEAN_DECAY**self._count) / size
        speed = step.norm(dim=1, keepdim=True)
        edges = Edges.of(self.faces, len(vertices))
        steady = speed + _offset(speed, edges) / 2
        vertices = vertices - rate * target * step
        vertices = vertices + smooth * _offset(vertices, edges)
        target = (target * (1 + _GAIN * (steady - _STEADY))).clamp(least, max(least, most))
        self.surface = Surface(torch.cat((vertices, target, mean, square), 1), self.faces)
        if self._count % _EVERY == 0:
            self.surface = remesh_once(self.surface, rounds=1, strength=_RELAX)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        return {"count": self._count, "values": self.surface.values, "faces": self.faces}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        self._count, self.surface = state["count"], Surface(state["values"], state["faces"])


def _offset(values: Tensor, edges: Edges) -> Tensor:
    """Subtract values [V, C] from the means over the neighbours of each vertex."""
    a, b = edges.ends.unbind(1)
    total = torch.zeros_like(values).index_add(0, a, values[b]).index_add(0, b, values[a])
    return total / edges.valence().clamp(min=1)[:, None] - values
