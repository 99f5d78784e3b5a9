"""The gradient of `edge_gradient` where faces intersect.

`candidates` and `nearness` run inside its kernels: a face that `candidates` misses would have no gradient here.
"""

from __future__ import annotations

import pytest
import torch

from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.visibility.edge import EdgeOptions, edge_gradient_backward
from tests.raster.scenes import FAR, NEAR
from tests.raster.visibility.checks import compare


def test_pages_of_an_open_book_do_not_intersect(device):
    """Before a wall. The depth of both pages is equal to the last bit where they meet, and moves nothing."""
    random = torch.Generator().manual_seed(0)
    book = torch.tensor([[0, -0.9, 3.0], [0, 0.9, 3], [-0.8, 0, 2], [0.8, 0, 2]])
    wall = torch.tensor([[[-9.0, -9, 5], [9, -9, 5], [0, 9, 5]]])
    for _ in range(20):
        pages = (book + 0.1 * torch.rand(4, 3, generator=random))[torch.tensor([[0, 1, 2], [0, 3, 1]])]
        faces = torch.cat((pages, wall))[None].to(device)
        index = coverage(faces, 16, 16, NEAR, FAR, True, True)
        found = edge_gradient_backward(
            torch.ones_like(index)[:, None].float(),
            index[:, None].float(),
            faces,
            index,
            EdgeOptions(True, True, False),
        )
        assert not found[..., 2].any()


def quads(device, turn: float = 0.13) -> torch.Tensor:
    """Two quads that intersect; one is upright, the other turned about the vertical axis."""
    one = torch.tensor(
        [[-0.713, -0.621, 1.6], [0.707, -0.617 - turn, 2.6], [0.719, 0.631, 2.6], [-0.723, 0.629 + turn, 1.6]]
    )
    other = torch.tensor(
        [[-0.611, -0.727, 2.7], [0.613, -0.731, 1.7], [0.619, 0.733, 1.6], [-0.627 + turn, 0.717, 2.6]]
    )
    space = torch.cat((one, other))
    return space[torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])][None].to(device)


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("seams", [False, True])
def test_intersecting_quads(device, perspective, seams):
    faces = quads("cpu")
    compared = compare(device, faces, 40, 33, 3, True, perspective, seams)
    assert compared[0] == 4
    index = coverage(faces.to(device), 40, 33, NEAR, FAR, True, perspective)
    image = (index < 2).float()[:, None]
    found = edge_gradient_backward(
        torch.ones_like(image), image, faces.to(device), index, EdgeOptions(True, perspective, seams)
    )
    # The first quad gains pixels if it comes nearer, or if the other goes farther away.
    assert (found[0, :2, :, 2].sum() < -1) and (found[0, 2:, :, 2].sum() > 1)


def test_mean_gradient_is_a_central_difference(device):
    """The visible area of one of two quads, differentiated by each corner's depth; the mean over sub-pixel shifts.

    The tolerance is that of 64 shifts; a pixel of the intersection, at one of its ends, would be 4 %.
    """
    faces, size, fine = quads(device), 48, 32

    def white(at, size):
        return (coverage(at, size, size, NEAR, FAR, True, True).clamp(min=-1) // 2 == 0).float()[:, None]

    shifts = (
        torch.cartesian_prod(torch.arange(8.0), torch.arange(8.0))
        + torch.rand(64, 2, generator=torch.Generator().manual_seed(0))
    ) / 8
    moved = faces + 2 / size * torch.cat((shifts, torch.zeros(64, 1)), 1).to(device)[:, None, None]
    index = coverage(moved, size, size, NEAR, FAR, True, True)
    image = white(moved, size)
    mean = edge_gradient_backward(torch.ones_like(image), image, moved, index, EdgeOptions(True, True, False)).mean(0)
    for same in (faces[0] == corner for corner in faces.reshape(-1, 3).unique(dim=0)):
        same = same.all(-1)
        areas = []
        for sign in (1, -1):
            moved = faces.clone()
            moved[0, :, :, 2] += 0.02 * sign * same
            areas.append(float(white(moved, size * fine).sum()) / fine**2)
        expected = (areas[0] - areas[1]) / 0.04
        found = float(mean[..., 2][same].sum())
        assert abs(found - expected) < 0.01 * abs(expected) + 0.5, (found, expected)


def test_faces_in_one_plane_do_not_intersect(device):
    """One face twice, with its corners rotated: rounding decides which copy is visible, and gradients stay finite."""
    random = torch.Generator().manual_seed(0)
    for _ in range(100):
        face = torch.rand(3, 3, generator=random) * torch.tensor([1.8, 1.8, 2]) - torch.tensor([0.9, 0.9, -1])
        faces = torch.stack((face, face[[1, 2, 0]]))[None].to(device)
        index = coverage(faces, 32, 32, NEAR, FAR, True, True)
        image = (1.0 + index)[:, None]
        found = edge_gradient_backward(torch.ones_like(image), image, faces, index, EdgeOptions(True, True, True))
        assert found.isfinite().all() and found.abs().max() < 1e3
