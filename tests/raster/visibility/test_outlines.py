"""Outlines of surfaces that are cut into other faces: strips too narrow for a pixel, and T-junctions."""

from __future__ import annotations

import math

import pytest
import torch

from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.ops.half_edges import find_half_edges
from neural_renderer.raster.visibility.edge import EdgeOptions, edge_gradient_backward
from tests.raster.scenes import FAR, NEAR, Scene

SIZE = 24


def total_gradient(places, depths, triangles, shades, grad, shared):
    """Draw faces [F, 3] of grey shades [F] with corners [V, 2] in pixels; sum the gradient to all corners, [2]."""
    screen = torch.cat((2 * places / SIZE - 1, depths[:, None]), 1).float().to(grad.device)
    triangles = triangles.to(grad.device)
    faces = screen[triangles][None]
    index = coverage(faces, SIZE, SIZE, NEAR, FAR, True, True)
    colors = torch.cat((shades.to(grad.device), torch.zeros(1, device=grad.device)))  # the last one is the background
    image = colors[index.long()][:, None]
    half_edges = find_half_edges(triangles).siblings if shared else None
    found = edge_gradient_backward(grad, image, faces, index, EdgeOptions(True, True, True), None, half_edges)
    return found.sum((0, 1, 2))[:2].cpu()


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("width", [1e-3, 0.05])
def test_strips_that_no_pixel_shows(device, width, shared):
    """A square that ends in a rim of two strips moves as the square alone: the outline is in the same pixels."""
    grad = Scene(0, 1, 1, 1, 1, True, True, ()).noise(1, 1, SIZE, SIZE).to(device)
    square = torch.tensor([[4.31, 4.12], [4.07, 19.73]], dtype=torch.float64)
    ends = torch.tensor([[17.22, 4.63], [16.81, 19.27]], dtype=torch.float64)
    results = []
    for strips in (0, 2):
        rims = [ends + n * torch.tensor([width / 2, 0.0]) for n in range(-strips, 1)]
        places = torch.cat((square, *rims))
        depths = torch.tensor([2.0, 2.0] + [2 + 0.1 * n for n in range(strips + 1) for _ in range(2)])
        low = 2 * torch.arange(strips + 1)
        triangles = torch.cat((torch.stack((low, low + 2, low + 3), 1), torch.stack((low, low + 3, low + 1), 1)))
        results.append(total_gradient(places, depths, triangles, torch.ones(len(triangles)), grad, shared))
    assert results[0].abs().min() > 1
    # The strips take no part in the sums, whose crossings are the same: about 60, of 12 times a number of order one.
    torch.testing.assert_close(results[1], results[0], rtol=1e-3, atol=1e-2)


def test_t_junctions(device):
    """A small wall that stands with one edge within the long edge of a large wall; both move together.

    With weights of a constant slope along x, the derivative of the loss is the slope times the sum of the image.
    """
    large = torch.tensor([[12.4, 2.3], [13.1, 21.6], [21.2, 20.4], [20.3, 3.1]], dtype=torch.float64)
    places = torch.cat((large, large[0] + torch.tensor([[0.27], [0.74]]) * (large[1] - large[0])))
    places = torch.cat((places, torch.tensor([[3.4, 16.8], [4.1, 7.2]])))
    triangles = torch.tensor([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]])
    shades, depths = torch.tensor([0.2, 0.2, 0.9, 0.9]), torch.full((len(places),), 2.0)
    weight = torch.linspace(-1, 2, SIZE, device=device).expand(1, 1, SIZE, SIZE)
    shifts = (torch.cartesian_prod(torch.arange(8), torch.arange(8)) + 0.5) / 8 - 0.5
    found = torch.stack([total_gradient(places + s, depths, triangles, shades, weight, False) for s in shifts]).mean(0)
    a, b = (places[triangles[:, k]] - places[triangles[:, 0]] for k in (1, 2))
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).abs() / 2
    expected = 3 / (SIZE - 1) * float(area @ shades.double()) * SIZE / 2  # for a motion by a screen unit
    # Without the seam, a ninth would be missing. The mean is over 64 shifts of outlines of some 60 pixels.
    assert abs(float(found[0]) - expected) < 0.01 * expected
    assert abs(float(found[1])) < 0.01 * expected


def test_hidden_fan_with_two_faces_at_each_edge(device):
    """An edge of three faces may lead to another face than it came from; the search through hidden faces ends."""
    corner, count = (0.0, 0.0, 3.0), 8
    rim = [(0.6 * math.cos(n * math.pi / 6), 0.6 * math.sin(n * math.pi / 6), 3.0) for n in range(count + 2)]
    middles = [((n + 0.5) * math.pi / 6) for n in range(count)]
    fan = [(corner, rim[n], rim[n + 1]) for n in range(count + 1)]
    second = [(corner, (0.3 * math.cos(t), 0.3 * math.sin(t), 3.2), rim[n + 1]) for n, t in enumerate(middles)]
    behind = [(rim[n + 1], rim[n], (0.8 * math.cos(t), 0.8 * math.sin(t), 3.0)) for n, t in enumerate(middles) if n > 0]
    wall = [((-2, -2, 1), (2, -2, 1), (2, 2, 1)), ((-2, -2, 1), (2, 2, 1), (-2, 2, 1))]
    faces = torch.tensor([second + fan + behind + wall], dtype=torch.float32, device=device)
    index = coverage(faces, 32, 32, NEAR, FAR, False, True)
    grad = torch.ones((1, 1, 32, 32), device=device)
    found = edge_gradient_backward(grad, None, faces, index, EdgeOptions(False, True, False))
    assert not found[:, :-2].any() and found.isfinite().all()
