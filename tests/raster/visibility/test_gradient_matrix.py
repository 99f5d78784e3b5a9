"""A part of the benchmark `gradient_matrix`: gradients of outputs against differences of the mean over shifts."""

from __future__ import annotations

import pytest
import torch

from benchmarks.gradient_matrix.cases import cases
from benchmarks.gradient_matrix.limits import limit
from benchmarks.gradient_matrix.measure import Cell, backward, differences, drawing, forward
from neural_renderer import Camera, UVMesh, render

CELLS = [  # each scene and each output, plain and anti-aliased
    ("large faces", "position", False),
    ("5 px faces", "normal", False),
    ("3 px faces", "rgb", False),
    ("3 px faces", "normal", True),
    ("1 px faces", "normal", False),
    ("seams, large faces", "depth", True),
    ("seams, 5 px faces", "rgb", True),
    ("seams, 3 px faces", "position", True),
    ("seams, 1.4 px faces", "uv", False),
    ("seams of a sheet", "rgb", False),
    ("hard texture", "rgb", False),
    ("crossing planes", "normal", False),
    ("intersecting bodies", "depth", False),
    ("overlap, near moves", "alpha", True),
    ("overlap, far moves", "uv", True),
    ("outline over the border", "alpha", False),
    ("outline along the border", "depth", False),
]


@pytest.mark.parametrize(("name", "output", "anti_aliased"), CELLS)
def test_a_mean_gradient_is_the_difference_of_means(name: str, output: str, anti_aliased: bool) -> None:
    """Size and direction are right but for three times their noise and the limits of the benchmark."""
    case = cases()[name]()
    draw = drawing(case, output, anti_aliasing=anti_aliased)
    cell = Cell.of(backward(case, draw, 6, 4), differences(case, drawing(case, output), 10, 2), 144)
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


def slopes(
    right: list[tuple[float, float]], size: int, shifts: torch.Tensor, left: tuple[float, ...] = ()
) -> torch.Tensor:
    """Draw quadrilaterals, one behind the other, of which right and left sides are given in pixels from the middle.

    Returns the derivative of the summed silhouette by the motion of each right side in pixels, [shifts, sides].
    """
    starts = [2 * x / size for x in left] or [-0.8] * len(right)
    corners = [
        [(start, -0.8, z), (2 * low / size, -0.8, z), (2 * high / size, 0.8, z), (start, 0.8, z)]
        for z, (start, (low, high)) in enumerate(zip(starts, right, strict=True))
    ]
    moved = torch.tensor(corners).flatten(0, 1) + torch.nn.functional.pad(2 / size * shifts[:, None], (0, 1))
    moved.requires_grad_()
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    faces = torch.cat([faces + 4 * n for n in range(len(right))])
    camera = Camera.look_at((0.0, 0.0, -2.5), orthographic=True)
    render((moved, faces), camera, size, outputs=("alpha",), anti_aliasing=False).alpha.sum().backward()
    assert moved.grad is not None
    return 2 / size * moved.grad[..., 0].unflatten(1, (-1, 4))[..., 1:3].sum(-1)


@pytest.mark.parametrize(("place", "share"), [(0.3, 0), (0.45, 0), (0.55, 2), (0.95, 2), (1.05, 1), (3.0, 1)])
def test_an_outline_along_the_border(place: float, share: float) -> None:
    """Its gradient has this share at some pixels from the border, which is the limit of the matrix in the mean."""
    right = 10 - place
    assert slopes([(right, right)], 20, torch.zeros(1, 2)).item() == pytest.approx(16 * share, abs=1e-3)


@pytest.mark.parametrize("widens", [0.1, 0.2, 0.4])
def test_outlines_that_cross(widens: float) -> None:
    """Where the farther one lies less than a pixel outside, the nearer one has its gradient: of 1 / (2 c) rows."""
    shifts = torch.rand(400, 2, generator=torch.Generator().manual_seed(0)) - 0.5
    rows, lost = 0.4 * 48, 1 / (2 * widens)
    found = slopes([(0.0, 0.0), (-widens * rows, widens * rows)], 48, shifts)
    error = found.mean(0) - torch.tensor([rows + lost, rows - lost])
    assert (error.abs() < 3 * found.std(0) / 20 + 0.02 * lost).all(), error


@pytest.mark.parametrize("left", [(-19.0, -0.3), (-0.7, -19.0)])
@pytest.mark.parametrize("gap", [0.15, 0.4])
def test_a_short_chord_that_another_surface_continues(left: tuple[float, float], gap: float) -> None:
    """One row has one outline at each shift if both move, although its chord is shorter than a pixel.

    Without the other surface, weights 1 / chord would make it 1 + gap (1 / chord - 1) for a chord whose other end a
    nearer surface hides, and 2 - chord for a strip before a farther one that reaches less than a pixel farther.
    """
    shifts = torch.stack((torch.arange(20) / 20 + 0.013, torch.zeros(20)), 1)
    found = slopes([(0.0, 0.0), (gap, gap)], 48, shifts, left).sum(1)
    torch.testing.assert_close(found, torch.full((20,), 38.0), rtol=0, atol=1e-3)  # rows between -19.2 and 19.2


FRONT, FAR = (-16.0, 0.0, 0.0, 0.9), (-40.0, 40.0, 9.0, 0.2)


@pytest.mark.parametrize(
    ("stripes", "change"),
    [
        # A strip narrower than a pixel beside another stripe: half hidden, with little behind it, apart, in front.
        ([FRONT, (-16.0, 0.35, 1.0, 0.5), FAR], 0.7),
        ([FRONT, (-0.2, 0.35, 1.0, 0.5), FAR], 0.7),
        ([FRONT, (0.1, 0.35, 1.0, 0.5), FAR], 0.7),
        ([FRONT, (-0.3, 0.35, -1.0, 0.5), FAR], 0.7),
        # A seam of the far surface, visible and hidden beside an outline, which moves alone.
        ([FRONT, (-40.0, 0.3, 9.0, 0.2), (0.3, 40.0, 9.0, 0.5)], 0.7),
        ([FRONT, (-40.0, -0.3, 9.0, 0.2), (-0.3, 40.0, 9.0, 0.5)], 0.4),
        # The seam, which moves alone.
        ([(-16.0, 0.0, -9.0, 0.9), (-40.0, 0.3, 0.0, 0.2), (0.3, 40.0, 0.0, 0.5)], -0.3),
        ([(-16.0, 0.0, -9.0, 0.9), (-40.0, -0.3, 0.0, 0.2), (-0.3, 40.0, 0.0, 0.5)], 0.0),
    ],
)
def test_surfaces_less_than_a_pixel_apart(stripes: list[tuple[float, float, float, float]], change: float) -> None:
    """Where stripes near the depth 0 move to the right together, each row changes by the jump of values there.

    A stripe has a left and a right side in pixels from the middle, a depth and a value, which its corners know.
    """
    size, count = 48, 20
    corners = [[(a, -40.0, z), (b, -40.0, z), (b, 40.0, z), (a, 40.0, z)] for a, b, z, _ in stripes]
    vertices = (torch.tensor(corners).flatten(0, 1) * torch.tensor([2 / size, 2 / size, 0.1])).requires_grad_()
    faces = torch.cat([torch.tensor([[0, 1, 2], [0, 2, 3]]) + 4 * n for n in range(len(stripes))])
    uv = torch.tensor([value for *_, value in stripes]).repeat_interleave(2)[:, None, None].expand(-1, 3, 2)
    mesh = UVMesh(vertices, faces, uv, torch.zeros(2, 2, 3))
    shifts = torch.stack((torch.arange(count) / count - 0.487, torch.zeros(count)), 1)
    camera = Camera.look_at((0.0, 0.0, -2.5), orthographic=True)[[0] * count].shifted(shifts, size)
    drawn = render(mesh, camera, size, outputs=("uv",), gradient="edge", anti_aliasing=False).uv
    (gradient,) = torch.autograd.grad(drawn[:, 0, :, :32].sum(), vertices)  # without the left sides
    moves = torch.tensor([abs(z) < 9 for _, _, z, _ in stripes]).repeat_interleave(4)
    assert float(2 / size * gradient[moves, 0].sum()) / (size * count) == pytest.approx(change, abs=1e-3)


def test_a_cell_fails_beyond_noise_and_bound() -> None:
    truth = torch.tensor([[3.0, 4.0]]).double()
    exact = Cell.of(truth.expand(4, 2), truth, 4)
    assert (exact.ratio, exact.cosine) == pytest.approx((1.0, 1.0)) and exact.noise == exact.spread == 0
    assert not exact.fails() and Cell.of(1.03 * truth.expand(4, 2), truth, 4).fails()
    noisy = truth * (1 + torch.tensor([[-0.2], [0.3], [-0.1], [0.1]]))
    assert Cell.of(noisy, truth, 4).ratio == pytest.approx(1.025) and not Cell.of(noisy, truth, 4).fails()
    assert Cell.of(torch.tensor([[4.0, 3.0]]).double(), truth, 1).fails(0.5)
