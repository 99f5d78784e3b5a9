"""`interpolate` against its formula in float64."""

from __future__ import annotations

import pytest
import torch

import neural_renderer.nvdiffrast as dr
from tests.drop_in.scenes import CONTEXT, soup
from tests.rounding import rounding


def expected(attr, rast, tri, rast_db, chosen):
    """Sums of corners' attributes, weighed by (u, v, 1 − u − v), and of their differences by the changes of u and v."""
    shown = rast[..., 3].detach().long() - 1
    image = torch.arange(len(rast))[:, None, None]
    attr = attr.expand(len(rast), -1, -1)
    corner = attr[image[..., None], tri.long()[shown.clamp(min=0)]]  # [B, H, W, 3, A]
    u, v = rast[..., 0:1], rast[..., 1:2]
    value = u * corner[..., 0, :] + v * corner[..., 1, :] + (1 - u - v) * corner[..., 2, :]
    by_u, by_v = (corner[..., k, chosen] - corner[..., 2, chosen] for k in (0, 1))
    right = rast_db[..., 0:1] * by_u + rast_db[..., 2:3] * by_v
    up = rast_db[..., 1:2] * by_u + rast_db[..., 3:4] * by_v
    seen = (shown >= 0)[..., None]
    return value * seen, torch.stack((right, up), -1).flatten(-2) * seen


@pytest.mark.parametrize("diff_attrs", ["all", [2, 0], [1], None])
@pytest.mark.parametrize("shared", [False, True], ids=["own", "shared"])
def test_values_and_gradients(device, diff_attrs, shared):
    pos, tri = soup(2)
    rast, rast_db = (
        one.detach().requires_grad_() for one in dr.rasterize(CONTEXT, pos.to(device), tri.to(device), (9, 13))
    )
    attr = torch.randn(1 if shared else 2, pos.shape[1], 3).to(device).requires_grad_()
    found = dr.interpolate(attr, rast, tri.to(device), rast_db=rast_db, diff_attrs=diff_attrs)
    chosen = [0, 1, 2] if diff_attrs == "all" else diff_attrs or []
    assert found[1].shape == (2, 9, 13, 2 * len(chosen))
    exact = [one.detach().cpu().double().requires_grad_() for one in (attr, rast, rast_db)]
    wanted = expected(exact[0], exact[1], tri, exact[2], chosen)
    for ours, theirs in zip(found, wanted, strict=True):
        torch.testing.assert_close(ours.cpu().double(), theirs, **rounding(16, 16))
    pulls = [torch.randn_like(one) for one in found]
    ours = torch.autograd.grad(found, (attr, rast, rast_db), pulls, allow_unused=True)
    theirs = torch.autograd.grad(wanted, exact, [pull.cpu().double() for pull in pulls], allow_unused=True)
    for one, other in zip(ours, theirs, strict=True):
        if one is None:
            assert other is None or not other.any()
            continue
        # Sums over at most all pixels of products of normal numbers.
        torch.testing.assert_close(one.cpu().double(), other, **rounding(9 * 13 * 2, 16))


def test_range_mode(device):
    pos, tri = soup(2, batch=1)
    ranges = torch.tensor([[0, 4], [2, 4]], dtype=torch.int32)
    rast, _ = dr.rasterize(CONTEXT, pos[0].to(device), tri.to(device), (9, 13), ranges=ranges)
    attr = torch.randn(pos.shape[1], 3, device=device)
    one, empty = dr.interpolate(attr, rast, tri.to(device))
    other, _ = dr.interpolate(attr.expand(2, -1, -1), rast, tri.to(device))
    assert torch.equal(one, other) and empty.shape == (2, 9, 13, 0)


def test_numbers_of_triangles_that_do_not_exist_show_nothing(device):
    rast = torch.tensor([[[[0.2, 0.2, 0, 99], [0.2, 0.2, 0, -3], [0.2, 0.2, 0, torch.nan], [0.2, 0.2, 0, 1]]]])
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32, device=device)
    found, _ = dr.interpolate(torch.ones(1, 3, 1, device=device), rast.to(device), tri)
    assert found.flatten().tolist() == [0, 0, 0, 1]
