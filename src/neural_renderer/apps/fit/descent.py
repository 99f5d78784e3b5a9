"""Optimisers: Adam with one step size for a vector, and descent with gradients smoothed over a surface."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import torch
from scipy import sparse
from scipy.sparse.linalg import splu
from torch import Tensor

from ...meshes.topology import Topology
from ...optim import conjugate_gradients

_MOMENTUM = 0.9  # decay rate of the mean gradient, Adam's β₁
_LEAST_SIZE = 1e-12  # least size of a gradient; smaller ones move nothing
_DECAY = 0.95  # decay rate of the mean square, β₂
_MOST_ITERATIONS = 100  # limit of conjugate gradients


class VectorAdam:
    """Adam with one step size for all values, that of the largest gradient.

    `torch.optim.Adam` scales each coordinate separately. This rotates steps towards the diagonals of the coordinate
    axes, and moves a vertex with a vanishing gradient as far as the others. Here a step has the direction of the mean
    gradient.
    """

    def __init__(self) -> None:
        self._count = 0
        self._mean: Tensor | None = None
        self._square: Tensor | None = None

    def step(self, values: Tensor, gradient: Tensor, rate: float) -> Tensor:
        """Take one step of descent: values [N, C] by the gradient of the loss, [N, C].

        The fastest row moves by about ``rate``.
        """
        self._count += 1
        means = self._mean, self._square, (_MOMENTUM, _DECAY), self._count
        step, size, self._mean, self._square = adam_means(gradient, gradient.square().sum(1).max(), *means)
        return values - rate * step / size

    def state_dict(self) -> dict[str, Any]:
        """Return the running means."""
        return {"count": self._count, "mean": self._mean, "square": self._square}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the running means from `state_dict`."""
        self._count, self._mean, self._square = state["count"], state["mean"], state["square"]


class SmoothDescent:
    """`VectorAdam` with smoothed gradients, for positions or colours [V, C] of vertices.

    The gradient of a silhouette loss is non-zero at outline vertices only and would tangle the surface. It is therefore
    smoothed to ``(1 + λL)⁻² g``, with the graph Laplacian L, and all vertices share one step size. See Nicolet,
    Jacobson and Jakob, "Large Steps in Inverse Rendering of Geometry" (2021), sections 3 and 4.2.

    The matrix is factorised at the first step, on the CPU, where gradients on other devices are copied to.

    Args:
        topology: Topology of the mesh.
        smooth: λ, ≥ 0. Smoothing reaches about √λ edges far.
    """

    def __init__(self, topology: Topology, smooth: float) -> None:
        self._topology, self._smooth = topology, smooth
        self._adam = VectorAdam()

    def step(self, values: Tensor, gradient: Tensor, rate: float) -> Tensor:
        """Take one step of descent, as `VectorAdam.step`: the fastest vertex moves by about ``rate``."""
        return self._adam.step(values, self.smoothed(self.smoothed(gradient)), rate)

    def smoothed(self, values: Tensor) -> Tensor:
        """Solve ``(1 + λL) x = values``, [V, C], by the factors of the matrix."""
        return torch.from_numpy(self._factors.solve(values.cpu().numpy())).to(values)

    @functools.cached_property
    def _factors(self) -> Any:
        """LU factors of 1 + λL, in a fill-reducing order; it is positive definite and needs no pivoting."""
        matrix = _smoothing_matrix(self._topology.edges, self._topology.vertices, self._smooth).tocsc()
        order = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        return splu(matrix, **order)

    def state_dict(self) -> dict[str, Any]:
        """Return the running means."""
        return self._adam.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the running means from `state_dict`."""
        self._adam.load_state_dict(state)


def smooth_once(values: Tensor, edges: Tensor, smooth: float, times: int = 1, tolerance: float = 1e-3) -> Tensor:
    """Compute ``(1 + λL)⁻¹ values``, [V, C], on the CPU by conjugate gradients: faster than factors used once or twice.

    The matrix of the edges [E, 2] is inverted some ``times``, up to a residual relative to the values.
    """
    matrix = _smoothing_matrix(edges, len(values), smooth).tocsr()
    diagonal = torch.from_numpy(matrix.diagonal())[:, None]
    result = values.cpu()
    for _ in range(times):
        result = conjugate_gradients.solve(
            lambda x: torch.from_numpy(matrix @ x.numpy()),
            result,
            iterations=_MOST_ITERATIONS,
            tolerance=tolerance,
            diagonal=diagonal,
            start=result / diagonal,
        )
    return result.to(values)


def _smoothing_matrix(edges: Tensor, count: int, smooth: float) -> Any:
    """Make the matrix 1 + λL, float32, of a mesh with these edges [E, 2] and a number of vertices."""
    low, high = edges.cpu().numpy().T
    degree = np.bincount(low, minlength=count) + np.bincount(high, minlength=count)
    half = sparse.csr_matrix((np.full(len(low), -smooth, np.float32), (low, high)), shape=(count, count))
    return half + half.T + sparse.diags((1 + smooth * degree).astype(np.float32))


def adam_means(
    gradient: Tensor,
    square: Tensor,
    mean: Tensor | None,
    mean_square: Tensor | None,
    decays: tuple[float, float],
    count: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Average gradients and their squares (Kingma and Ba, "Adam: a method for stochastic optimization", 2015, alg. 1).

    Returns the mean gradient and its size, above 0, both corrected for the start at 0 before ``count`` steps; and the
    running means for the next step.
    """
    first, second = decays
    mean = (1 - first) * gradient + (0 if mean is None else first * mean)
    mean_square = (1 - second) * square + (0 if mean_square is None else second * mean_square)
    size = (mean_square / (1 - second**count)).sqrt().clamp(min=_LEAST_SIZE)
    return mean / (1 - first**count), size, mean, mean_square
