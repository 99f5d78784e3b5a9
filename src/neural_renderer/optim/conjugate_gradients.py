"""Conjugate gradients for symmetric positive definite matrices that are given by their products with vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

_LEAST_DIVISOR = 1e-30  # least divisor: a column that is solved exactly would divide 0 by 0


class ConjugateGradients:
    """Solve A x = b, each column of the target b [N, C] separately, with Jacobi preconditioning.

    Hestenes and Stiefel, "Methods of conjugate gradients for solving linear systems" (1952), with the preconditioner as
    in Saad, "Iterative methods for sparse linear systems" (2003), algorithm 9.1.

    Args:
        multiply: Function that multiplies A by columns [N, C].
        diagonal: The diagonal of A, which may be approximate, [N, 1] or [N, C]; 1 for no preconditioning.
        target: b.
        start: First x, [N, C].

    Attributes:
        solution: The current x.
        residual: b − A x.
    """

    def __init__(
        self,
        multiply: Callable[[Tensor], Tensor],
        diagonal: Tensor | float,
        target: Tensor,
        start: Tensor | None = None,
    ) -> None:
        self._multiply, self._diagonal = multiply, diagonal
        self.solution = torch.zeros_like(target) if start is None else start
        self.residual = target if start is None else target - multiply(start)
        self._direction = self.residual / diagonal
        self._product = (self.residual * self._direction).sum(0)

    def advance(self) -> bool:
        """Take one step; return False, without a step, if no column has a direction of positive curvature."""
        image = self._multiply(self._direction)
        curvature = (self._direction * image).sum(0)
        if not bool((curvature > 0).any()):
            return False
        length = self._product / curvature.clamp(min=_LEAST_DIVISOR)
        self.solution = self.solution + length * self._direction
        self.residual = self.residual - length * image
        scaled = self.residual / self._diagonal
        product, before = (self.residual * scaled).sum(0), self._product
        self._direction = scaled + product / before.clamp(min=_LEAST_DIVISOR) * self._direction
        self._product = product
        return True

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        return {
            "solution": self.solution,
            "residual": self.residual,
            "direction": self._direction,
            "product": self._product,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        self.solution, self.residual = state["solution"], state["residual"]
        self._direction, self._product = state["direction"], state["product"]


def solve(
    multiply: Callable[[Tensor], Tensor],
    target: Tensor,
    *,
    iterations: int,
    tolerance: float,
    diagonal: Tensor | float = 1.0,
    start: Tensor | None = None,
) -> Tensor:
    """Solve A x = b to a residual relative to b [N, C]; arguments as of `ConjugateGradients`."""
    solver = ConjugateGradients(multiply, diagonal, target, start)
    goal = tolerance**2 * target.square().sum(0)
    for _ in range(iterations):
        if bool((solver.residual.square().sum(0) <= goal).all()) or not solver.advance():
            break
    return solver.solution
