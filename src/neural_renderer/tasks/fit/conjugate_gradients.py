"""`ConjugateGradients`: iterative solution of linear equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from torch import Tensor

_LEAST = 1e-30  # of a divisor: a column that is solved exactly would divide 0 by 0


class ConjugateGradients:
    """Solve A x = b by conjugate gradients with Jacobi preconditioning, each column by itself.

    Args:
        multiply: Multiplies a symmetric positive definite matrix A by columns [N, C].
        diagonal: [N, 1] or [N, C] > 0, diagonal of A or an approximation.
        target: [N, C], b.
        start: [N, C], the initial x.

    Attributes:
        solution: [N, C], the current x.
        residual: [N, C], b − A x.

    Example:
        >>> from neural_renderer.tasks.fit.conjugate_gradients import ConjugateGradients
        >>> matrix, target = torch.tensor([[2.0, 1.0], [1.0, 3.0]]), torch.tensor([[3.0], [4.0]])
        >>> solver = ConjugateGradients(lambda x: matrix @ x, matrix.diag()[:, None], target, torch.zeros(2, 1))
        >>> for _ in range(2):
        ...     solver.advance()
        >>> torch.allclose(solver.solution, torch.ones(2, 1))
        True
    """

    def __init__(self, multiply: Callable[[Tensor], Tensor], diagonal: Tensor, target: Tensor, start: Tensor) -> None:
        self._multiply, self._diagonal = multiply, diagonal
        self.solution, self.residual = start, target - multiply(start)
        self._direction = self.residual / diagonal
        self._product = (self.residual * self._direction).sum(0)

    def advance(self) -> None:
        """Take one step."""
        image = self._multiply(self._direction)
        length = self._product / (self._direction * image).sum(0).clamp(min=_LEAST)
        self.solution = self.solution + length * self._direction
        self.residual = self.residual - length * image
        scaled = self.residual / self._diagonal
        product, before = (self.residual * scaled).sum(0), self._product
        self._direction = scaled + product / before.clamp(min=_LEAST) * self._direction
        self._product = product

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
