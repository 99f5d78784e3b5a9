"""Gradient descent on values at vertices, with gradients smoothed over the surface."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ...meshes.topology import Topology

_MOMENTUM, _SECOND_MOMENT = 0.9, 0.98  # decay rates of the running means, Adam's β₁ and β₂
_MOST_ITERATIONS = 100  # of conjugate gradients


class SmoothDescent:
    """Adam with smoothed gradients, for positions or colours [V, C] of vertices.

    The gradient of a silhouette loss is non-zero at outline vertices only and would tangle the surface. It is therefore
    smoothed to ``(1 + λL)⁻² g``, with the graph Laplacian L, and all vertices share one step size. See Nicolet,
    Jacobson and Jakob, "Large Steps in Inverse Rendering of Geometry" (2021), sections 3 and 4.2.

    Args:
        topology: Topology of the mesh.
        smooth: λ, ≥ 0. Smoothing reaches about √λ edges far.
    """

    def __init__(self, topology: Topology, smooth: float = 16.0) -> None:
        edges = topology.edges
        start, end = torch.cat((edges, edges.flip(1))).unbind(1)
        order = torch.argsort(start, stable=True)
        degree = torch.bincount(start, minlength=topology.vertices)
        self._neighbors, self._first = end[order], degree.cumsum(0) - degree
        self._degree = degree[:, None].float()
        self._smooth = smooth
        self._count = 0
        self._mean: Tensor | None = None
        self._scale = torch.zeros((), device=edges.device)

    def step(self, values: Tensor, gradient: Tensor, rate: float) -> Tensor:
        """Take one step of descent.

        Args:
            values: [V, C] floating.
            gradient: [V, C], gradient of the loss.
            rate: Length of the step: the fastest vertex moves by about this much.

        Returns:
            [V, C], the new values.
        """
        gradient = self.blur(self.blur(gradient))
        self._count += 1
        self._mean = (1 - _MOMENTUM) * gradient + (_MOMENTUM * self._mean if self._mean is not None else 0)
        self._scale = _SECOND_MOMENT * self._scale + (1 - _SECOND_MOMENT) * gradient.square().sum(1).max()
        size = (self._scale / (1 - _SECOND_MOMENT**self._count)).sqrt().clamp(min=1e-12)
        return values - rate * self._mean / (1 - _MOMENTUM**self._count) / size

    def blur(self, values: Tensor, tolerance: float = 1e-3) -> Tensor:
        """Smooth values [V, C]: solve ``(1 + λL) x = values`` by conjugate gradients with Jacobi preconditioning."""
        diagonal = 1 + self._smooth * self._degree

        def matrix_times(x: Tensor) -> Tensor:
            total = F.embedding_bag(self._neighbors, x, self._first, mode="sum")
            return diagonal * x - self._smooth * total

        solution = values / diagonal
        residual = values - matrix_times(solution)
        goal = tolerance**2 * values.square().sum(0)
        direction = scaled = residual / diagonal
        product = (residual * scaled).sum(0)
        for _ in range(_MOST_ITERATIONS):
            if bool((residual.square().sum(0) <= goal).all()):
                break
            image = matrix_times(direction)
            length = product / (direction * image).sum(0).clamp(min=1e-30)
            solution = solution + length * direction
            residual = residual - length * image
            scaled = residual / diagonal
            product, before = (residual * scaled).sum(0), product
            direction = scaled + product / before.clamp(min=1e-30) * direction
        return solution

    def state_dict(self) -> dict[str, Any]:
        """Return the running means."""
        return {"count": self._count, "mean": self._mean, "scale": self._scale}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the running means from `state_dict`."""
        self._count, self._mean, self._scale = state["count"], state["mean"], state["scale"]
