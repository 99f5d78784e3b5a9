"""Gradient descent on a mesh that is remeshed as it moves."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ...common.geometry.edges import Edges, lengths
from ...common.geometry.remesh import remesh_once
from ...common.geometry.surface import Surface
from ..descent import adam_means, smooth_once
from .fairing import faired

_DECAYS = 0.8, 0.9  # Adam's β₁ and β₂
_OWN = 8  # columns of position, target length, mean gradient and mean squared gradient
_STEADY = 0.3  # faces become coarser where the mean step, at most 1, is longer
_GAIN = 0.2  # relative change of the target length in a step, for a difference of 1 from `_STEADY`
_EVERY = 2  # steps between remeshings
_BORDER = 0.1  # difference of colours at borders in the images, across which vertices are smoothed less
_RELAX = 0.3  # strength of the smoothing along the surface


class AdaptiveDescent:
    """Descent on vertices with step sizes and face sizes that adapt to the detail.

    The step of a vertex is Adam's, with one size for its three coordinates, times the target length of the edges around
    it. Where steps agree with each other the surface still moves, and larger faces move faster: the target grows. Where
    they do not, what is missing is finer than the faces: the target shrinks. After Palfinger, "Continuous remeshing for
    inverse rendering" (2022).

    Args:
        vertices: [V, 3] float32, initial positions.
        faces: [F, 3] int64.
        colors: [V, 3] float32, initial colours, which descend, too, and are carried along; or None.

    Attributes:
        surface: The mesh; its values are positions, target lengths, the running means of gradients, and the same of
            colours, if there are any.
    """

    surface: Surface

    def __init__(self, vertices: Tensor, faces: Tensor, colors: Tensor | None = None) -> None:
        vertices, faces = vertices.detach(), faces.long()
        size = lengths(vertices, Edges.of(faces, len(vertices)).ends).mean()
        target = size.expand(len(vertices), 1)
        state = vertices.new_zeros(len(vertices), 4)  # mean gradient and mean squared gradient
        of_colors = [] if colors is None else [colors.detach(), state]
        self.surface = Surface(torch.cat((vertices, target, state, *of_colors), 1), faces).compact()
        self._count, self._color_count = 0, 0

    @property
    def vertices(self) -> Tensor:
        """Current positions, [V, 3]."""
        return self.surface.vertices

    @property
    def faces(self) -> Tensor:
        """Current faces, [F, 3] int64."""
        return self.surface.faces

    @property
    def colors(self) -> Tensor:
        """Current colours, [V, 3], or [V, 0] if there are none."""
        return self.surface.values[:, _OWN : _OWN + 3]

    def forget(self) -> None:
        """Start the running means of gradients anew, because the loss changes its scale."""
        values = self.surface.values.clone()
        values[:, 4:_OWN], values[:, _OWN + 3 :] = 0.0, 0.0
        self.surface, self._count, self._color_count = self.surface.with_values(values), 0, 0

    def step_colors(self, gradient: Tensor, rate: float, floor: float = 0.0) -> None:
        """Take one step of descent on colours by the gradient of the loss, [V, 3]; call it before `step`.

        Rate and floor are as in `step`, but colours have no length.
        """
        others, colors, mean, square = self.surface.values.split((_OWN, 3, 3, 1), 1)
        self._color_count += 1
        step, mean, square, _ = self._adam(gradient, mean, square, self._color_count, floor)
        self.surface = self.surface.with_values(torch.cat((others, colors - rate * step, mean, square), 1))

    def _adam(
        self, gradient: Tensor, mean: Tensor, square: Tensor, count: int, floor: float = 0.0
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Compute steps of at most about 1, and the running means; and the lengths of the steps without a floor."""
        now = gradient.square().sum(1, keepdim=True)
        average, size, mean, square = adam_means(gradient, now, mean, square, _DECAYS, count)
        speed = (average / size).norm(dim=1, keepdim=True)
        return average / torch.maximum(size, floor * size.mean()), mean, square, speed

    def step(
        self,
        gradient: Tensor,
        *,
        rate: float,
        smooth: float,
        least: float,
        most: float,
        floor: float = 0.0,
        reach: float = 0.0,
        fair: float = 0.0,
        fixed: bool = False,
    ) -> None:
        """Take one step of descent, and at every second step remesh.

        Args:
            gradient: [V, 3], gradient of the loss.
            rate: Length of a steady step, relative to the target length.
            smooth: Share of the way to the mean of its neighbours that each vertex moves, too.
            least, most: Limits of the target length, in world units.
            floor: Size of a gradient, relative to the mean of all vertices, below which steps become shorter.
            reach: λ of `smooth_once`, which is applied to the gradient twice; 0 leaves the gradient as it is.
            fair: Share of the way that vertices move to a surface without noise, see `faired`.
            fixed: Whether faces and target lengths stay as they are.
        """
        rest = self.surface.values[:, _OWN:]
        vertices, target, mean, square = self.surface.values[:, :_OWN].split((3, 1, 3, 1), 1)
        self._count += 1
        edges = self.surface.edges
        if reach:
            gradient = smooth_once(gradient, edges.ends, reach, times=2)
        step, mean, square, speed = self._adam(gradient, mean, square, self._count, floor)
        vertices = vertices - rate * target * step
        if smooth:
            vertices = vertices + smooth * _offset(vertices, edges, self._likeness(edges))  # details at borders stay
        if not fixed:
            steady = speed + _offset(speed, edges) / 2
            target = (target * (1 + _GAIN * (steady - _STEADY))).clamp(least, max(least, most))
        self.surface = self.surface.with_values(torch.cat((vertices, target, mean, square, rest), 1))
        if fair:
            self.surface = self.surface.moved(faired(self.surface, fair))
        if self._count % _EVERY == 0 and not fixed:
            self.surface = remesh_once(self.surface, rounds=1, strength=_RELAX)

    def _likeness(self, edges: Edges) -> Tensor:
        """Compute weights of edges [E, 1]: 1 between vertices of one colour, 0.5 where they differ by `_BORDER`."""
        a, b = edges.ends.unbind(1)
        return 1 / (1 + (self.colors[a] - self.colors[b]).square().sum(1, keepdim=True) / _BORDER**2)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        counts = {"count": self._count, "color_count": self._color_count}
        return {**counts, "values": self.surface.values, "faces": self.faces}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        self._count, self._color_count = state["count"], state["color_count"]
        self.surface = Surface(state["values"], state["faces"])


def _offset(values: Tensor, edges: Edges, weights: Tensor | None = None) -> Tensor:
    """Subtract values [V, C] from the means over the neighbours of each vertex, with weights of edges [E, 1]."""
    a, b = edges.ends.unbind(1)
    step = (values[b] - values[a]) * (1 if weights is None else weights)
    total = torch.zeros_like(values).index_add(0, a, step).index_add(0, b, -step)
    return total / edges.valence().clamp(min=1)[:, None]
