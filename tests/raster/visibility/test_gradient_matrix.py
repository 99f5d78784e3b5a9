"""A part of the benchmark `gradient_matrix`: gradients of outputs against differences of the mean over shifts."""

from __future__ import annotations

import pytest
import torch

from benchmarks.gradient_matrix.cases import cases
from benchmarks.gradient_matrix.limits import limit
from benchmarks.gradient_matrix.measure import Cell, backward, differences, drawing, forward

CELLS = [
    ("large faces", "position", False),
    ("large faces", "depth", True),
    ("3 px faces", "rgb", False),
    ("3 px faces", "normal", True),
    ("5 px faces", "normal", False),
    ("1 px faces", "normal", False),
    ("seams, 1.4 px faces", "uv", False),
    ("seams of a sheet", "rgb", False),
    ("overlap, near moves", "alpha", True),
    ("overlap, far moves", "rgb", False),
    ("intersecting bodies", "depth", False),
    ("crossing planes", "normal", False),
    ("outline over the border", "depth", False),
]


@pytest.mark.parametrize(("name", "output", "anti_aliased"), CELLS)
def test_a_mean_gradient_is_the_difference_of_means(name: str, output: str, anti_aliased: bool) -> None:
    """Size and direction are right but for three times their noise and the limits of the benchmark."""
    case = cases()[name]()
    draw = drawing(case, output, anti_aliasing=anti_aliased)
    cell = Cell.of(backward(case, draw, 6, 4), differences(case, drawing(case, output), 12, 2), 144)
    bound = limit(name, output, anti_aliased)
    assert not cell.fails(bound.error, bound.turn, bound.size), cell
    assert cell.noise < 0.1, cell


@pytest.mark.parametrize("anti_aliased", [False, True])
@pytest.mark.parametrize(("name", "output"), [("crossing planes", "depth"), ("seams, 3 px faces", "rgb")])
def test_both_modes_have_one_gradient(name: str, output: str, anti_aliased: bool) -> None:
    """Forward and backward mode are transposes, so they agree at the same shifts up to rounding."""
    case = cases()[name]()
    draw = drawing(case, output, anti_aliasing=anti_aliased)
    one, other = (mode(case, draw, 2, 2) for mode in (backward, forward))
    torch.testing.assert_close(one, other, rtol=0, atol=1e-4 * float(one.abs().max()))


def test_a_cell_fails_beyond_noise_and_bound() -> None:
    truth = torch.tensor([[3.0, 4.0]]).double()
    exact = Cell.of(truth.expand(4, 2), truth, 4)
    assert (exact.ratio, exact.cosine) == pytest.approx((1.0, 1.0)) and exact.noise == exact.spread == 0
    assert not exact.fails() and Cell.of(1.03 * truth.expand(4, 2), truth, 4).fails()
    noisy = truth * (1 + torch.tensor([[-0.2], [0.3], [-0.1], [0.1]]))
    assert Cell.of(noisy, truth, 4).ratio == pytest.approx(1.025) and not Cell.of(noisy, truth, 4).fails()
    assert Cell.of(torch.tensor([[4.0, 3.0]]).double(), truth, 1).fails(0.5)
