"""Conjugate gradients on matrices with known solutions."""

from __future__ import annotations

import pytest
import torch

from neural_renderer.optim.conjugate_gradients import ConjugateGradients, solve


def positive_matrix(size: int = 12) -> torch.Tensor:
    """A symmetric matrix with eigenvalues from 1 to 12 and unequal diagonal elements."""
    random = torch.Generator().manual_seed(0)
    basis = torch.linalg.qr(torch.rand(size, size, generator=random, dtype=torch.float64)).Q
    return basis @ torch.diag(torch.arange(1.0, size + 1, dtype=torch.float64)) @ basis.T


@pytest.mark.parametrize("preconditioned", [False, True])
def test_as_many_steps_as_unknowns_solve_every_column(preconditioned: bool) -> None:
    A, right = positive_matrix(), torch.eye(12, dtype=torch.float64)[:, :3].clone()
    right[:, 2] = 0  # solved by the start: its direction is 0
    diagonal = A.diagonal()[:, None] if preconditioned else 1.0
    found = solve(lambda x: A @ x, right, iterations=12, tolerance=0.0, diagonal=diagonal)
    torch.testing.assert_close(found, torch.linalg.solve(A, right), rtol=0, atol=1e-12)


def test_residual_is_that_of_the_solution_and_the_state_resumes() -> None:
    A, right = positive_matrix(), torch.ones(12, 1, dtype=torch.float64)
    solver = ConjugateGradients(lambda x: A @ x, A.diagonal()[:, None], right, 0.1 * right)
    for _ in range(3):
        assert solver.advance()
    torch.testing.assert_close(solver.residual, right - A @ solver.solution, rtol=0, atol=1e-13)
    other = ConjugateGradients(lambda x: A @ x, A.diagonal()[:, None], right, right)
    other.load_state_dict(solver.state_dict())
    solver.advance()
    other.advance()
    assert torch.equal(solver.solution, other.solution)


def test_it_stops_at_the_tolerance_and_without_curvature() -> None:
    A, right = positive_matrix(), torch.ones(12, 1, dtype=torch.float64)
    calls: list[int] = []
    found = solve(lambda x: calls.append(1) or A @ x, right, iterations=12, tolerance=0.25)
    residual = float((right - A @ found).norm() / right.norm())
    assert residual <= 0.25 and len(calls) < 12
    assert torch.equal(solve(lambda x: -x, right, iterations=3, tolerance=0.1), torch.zeros_like(right))
