"""The gradient "edge" where faces interpolate values of their corners, which `edge_gradient` then knows at edges."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster.colors.texture_cubes import CornerColors

SIZE, STRIPES = 24, 12


def stripes(width: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Stripes of a width in pixels over ten rows: vertices [2 · (STRIPES + 1), 2] in pixels, two faces for each."""
    x = 5.3137 + width * torch.arange(STRIPES + 1.0)
    vertices = torch.cat([torch.stack((x, torch.full_like(x, y)), 1) for y in (7.0, 17.0)])
    low = torch.arange(STRIPES)
    high = low + STRIPES + 1
    squares = torch.stack((low, low + 1, high + 1, high), 1)
    return vertices, torch.cat((squares[:, :3], squares[:, [0, 2, 3]]))


def pulls(device: str, width: float, colors: torch.Tensor, perspective: bool) -> torch.Tensor:
    """Gradients of the summed image to x of each border between stripes, in pixels, at 25 shifts: [25, STRIPES + 1]."""
    vertices, faces = stripes(width)
    shifts = (torch.arange(25.0) + 0.5) / 25
    moved = vertices + torch.stack((shifts, 0 * shifts), 1)[:, None]
    moved = torch.nn.functional.pad(moved * 2 / SIZE - 1, (0, 1), value=2.0).to(device).requires_grad_()
    cubes = torch.cat((colors, colors)).view(1, -1, 1, 1, 1, 1).expand(-1, -1, -1, -1, -1, 3).to(device)
    options = {"textures": cubes, "anti_aliasing": False, "gradient": "edge", "perspective": perspective}
    image = nr.rasterize_images(moved[:, faces], SIZE, outputs="rgb", **options).rgb
    (found,) = torch.autograd.grad(image[:, 0].sum(), moved)
    return found[..., 0].view(25, 2, -1).sum(1).cpu() * 2 / SIZE


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("width", [1.05, 1.3])
def test_narrow_stripes_at_any_shift(device: str, width: float, perspective: bool) -> None:
    """A border that moves by a pixel changes ten pixels by the difference of its colours.

    A stripe reaches as far as a pixel on either side of each border, so that one of its faces is visible.
    """
    colors = torch.rand(STRIPES, generator=torch.Generator().manual_seed(0)) + 0.5
    around = torch.cat((torch.zeros(1), colors, torch.zeros(1)))
    expected = 10 * (around[:-1] - around[1:])
    found = pulls(device, width, colors, perspective)
    torch.testing.assert_close(found[:, 2:-2], expected[2:-2].expand(25, -1), rtol=0, atol=2e-3)
    torch.testing.assert_close(found.mean(0), expected, rtol=0, atol=0.3)


@pytest.mark.parametrize("width", [0.2, 0.55])
def test_stripes_that_most_pixels_miss(device: str, width: float) -> None:
    """Up to eight of ten pixels miss a stripe; the mean over shifts is right."""
    colors = torch.rand(STRIPES, generator=torch.Generator().manual_seed(1)) + 0.5
    around = torch.cat((torch.zeros(1), colors, torch.zeros(1)))
    found = pulls(device, width, colors, True)
    expected = 10 * (around[:-1] - around[1:])
    error = (found.mean(0) - expected).abs()
    assert (error < 3 * found.std(0) / 5 + 0.05).all(), error


def test_light_on_the_visible_side() -> None:
    corners = torch.tensor([[[-1.0, -1, 1], [1, -1, 1], [0, 1, 1]], [[-1, -1, 1], [0, 1, 1], [1, -1, 1]]])[None]
    light = torch.tensor([[[2.0, 3, 4], [5, 6, 7]], [[8, 9, 10], [11, 12, 13]]])[None]  # front and back of two faces
    found = CornerColors(torch.ones(1, 2, 3, 3), light)(corners, True)
    assert found[0, 0].tolist() == [[2, 3, 4]] * 3 and found[0, 1].tolist() == [[11, 12, 13]] * 3
    behind = corners * torch.tensor([1.0, 1, 1]) - torch.tensor([[0.0, 0, 0], [0, 0, 2], [0, 0, 0]])
    assert CornerColors(torch.ones(1, 2, 3, 3), light)(behind, True)[0, 0].tolist() == [[8, 9, 10]] * 3
    assert CornerColors(torch.ones(1, 2, 3, 3), light)(behind, False)[0, 0].tolist() == [[2, 3, 4]] * 3
