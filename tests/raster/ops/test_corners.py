"""Gathering corners: against indexing, in value and gradient."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from neural_renderer.raster.ops.corners import gather_corners
from tests.raster.reference.drawing import gather_corners_reference
from tests.raster.scenes import examples


@examples(50)
@given(
    seed=st.integers(0, 2**31),
    batch=st.integers(0, 3),
    count=st.integers(0, 30),
    vertices=st.integers(0, 9),
    shared=st.booleans(),
    beyond=st.integers(0, 2),
)
def test_values_and_gradient(device, seed, batch, count, vertices, shared, beyond):
    random = torch.Generator().manual_seed(seed)
    points = torch.randn(batch, vertices, 3, generator=random)
    low, high = -beyond, max(vertices + beyond, 1 - beyond)
    faces = torch.randint(low, high, (1 if shared else batch, count, 3), generator=random, dtype=torch.int32)
    # (-1, -1, -1) is padding: a face without area at the first vertex, if there are vertices.
    plain = torch.where((faces == -1).all(-1, keepdim=True) & (vertices > 0), 0, faces)
    ours, exact = points.to(device).requires_grad_(), points.double().requires_grad_()
    found, expected = gather_corners(ours, faces.to(device)), gather_corners_reference(exact, plain)
    assert found.shape == (batch, count, 3, 3)
    assert torch.equal(found.detach().cpu().nan_to_num(7e7), expected.detach().float().nan_to_num(7e7))
    # Whole numbers add up exactly in any order.
    grad = torch.randint(-9, 10, found.shape, generator=random).float()
    found.backward(grad.to(device))
    result = torch.zeros(batch, vertices + 2 * beyond + 1, 3)
    for b in range(batch):
        index = plain[0 if shared else b].long().flatten() + beyond
        result[b].index_add_(0, index, grad[b].reshape(-1, 3))
    assert torch.equal(ours.grad.cpu(), result[:, beyond : beyond + vertices])


def test_corners_out_of_range_are_not_numbers_and_have_no_gradient(device):
    vertices = torch.rand(1, 4, 3, device=device, requires_grad=True)
    faces = torch.tensor([[[0, 1, 4], [-1, 2, 3], [2**31 - 1, -(2**31), 0]]], dtype=torch.int32, device=device)
    corners = gather_corners(vertices, faces)
    assert corners.isnan().all(-1).tolist() == [[[False, False, True], [True, False, False], [True, True, False]]]
    corners.nan_to_num().sum().backward()
    assert vertices.grad[0, :, 0].tolist() == [2, 1, 1, 1]
