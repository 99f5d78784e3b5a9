"""Steps of descent for what lives on the vertices of a mesh: gradients blurred over the surface, one rate for all."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ...meshes.topology import Topology


class SmoothDescent:
    """Adam for positions or colours of vertices, [V, C], that keeps the surface together.

    Silhouettes move only the vertices at the outline, each for itself, which tangles the surface. So the gradient is
    blurred over the surface, (1 + λL)⁻² g with the graph Laplacian L, and one step size holds for all vertices:
    "Large Steps in Inverse Rendering of Geometry" (Nicolet, Jacobson and Jakob, 2021), sections 3 and 4.2.

    Args:
        topology: of the mesh.
        smooth: λ, ≥ 0; the blur reaches about √λ edges far.
    """

    def __init__(self, topology: Topology, smooth: float = 16.0) -> None:
        edges = topology.edges
        start, end = torch.cat((edges, edges.flip(1))).unbind(1)
        order = torch.argsort(start, stable=True)
        degree = torch.bincount(start, minlength=topology.vertices)
        self._neighbours, self._first = end[order], degree.cumsum(0) - degree
        self._degree = degree[:, None].float()
        self._smooth = smooth
        self._count = 0
        self._mean: Tensor | None = None
        self._scale = torch.zeros((), device=edges.device)

    def step(self, values: Tensor, gradient: Tensor, rate: float) -> Tensor:
        """``values`` [V, C] moved down ``gradient``; the vertex that moves most moves by about ``rate``."""
        gradient = self.blur(self.blur(gradient))
        self._count += 1
        self._mean = (1 - 0.9) * gradient + (0.9 * self._mean if self._mean is not None else 0)
        self._scale = 0.98 * self._scale + 0.02 * gradient.square().sum(1).max()
        size = (self._scale / (1 - 0.98**self._count)).sqrt().clamp(min=1e-12)
        return values - rate * self._mean / (1 - 0.9**self._count) / size

    def blur(self, values: Tensor, tolerance: float = 1e-3) -> Tensor:
        """(1 + λL)⁻¹ of values [V, C], by conjugate gradients with the diagonal as preconditioner."""
        diagonal = 1 + self._smooth * self._degree

        def times(x: Tensor) -> Tensor:
            total = F.embedding_bag(self._neighbours, x, self._first, mode="sum")
            return diagonal * x - self._smooth * total

        solution = values / diagonal
        residual = values - times(solution)
        goal = tolerance**2 * values.square().sum(0)
        direction = scaled = residual / diagonal
        product = (residual * scaled).sum(0)
        for _ in range(100):
            if bool((residual.square().sum(0) <= goal).all()):
                break
            image = times(direction)
            length = product / (direction * image).sum(0).clamp(min=1e-30)
            solution = solution + length * direction
            residual = residual - length * image
            scaled = residual / diagonal
            product, before = (residual * scaled).sum(0), product
            direction = scaled + product / before.clamp(min=1e-30) * direction
        return solution

    def state_dict(self) -> dict[str, Any]:
        """The running means."""
        return {"count": self._count, "mean": self._mean, "scale": self._scale}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue where `state_dict` was taken."""
        self._count, self._mean, self._scale = state["count"], state["mean"], state["scale"]
