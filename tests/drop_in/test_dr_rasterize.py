"""`rasterize` and `DepthPeeler` against brute force in float64."""

from __future__ import annotations

import pytest
import torch

import neural_renderer.nvdiffrast as dr
from tests.drop_in import reference
from tests.drop_in.scenes import CONTEXT, soup

HEIGHT, WIDTH = 20, 24


def agree(rast: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
    """The pixels [B, H, W] where the triangle that is shown is the one of brute force, beyond rounding.

    Elsewhere a centre lies at an edge, or two depths are equal, within 1e-5.
    """
    shown, own = rast[..., 3].long() - 1, depth.min(1)
    expected = torch.where(own.values < torch.inf, own.indices, -1)
    return shown == expected


@pytest.mark.parametrize("behind", [False, True], ids=["in front", "through the camera"])
@pytest.mark.parametrize("seed", range(4))
def test_random_triangles(device, seed, behind):
    pos, tri = soup(seed, behind=behind)
    rast, rast_db = dr.rasterize(CONTEXT, pos.to(device), tri.to(device), (HEIGHT, WIDTH))
    rast, rast_db = rast.cpu(), rast_db.cpu()
    assert rast.shape == rast_db.shape == (2, HEIGHT, WIDTH, 4)
    depth = reference.layers(pos, tri, HEIGHT, WIDTH)
    same = agree(rast, depth)
    assert same.float().mean() > 0.995
    shown = torch.where(same, rast[..., 3].long() - 1, -1)
    found = shown >= 0
    assert found.sum() > 100
    torch.testing.assert_close(rast[..., 2].double()[found], depth.amin(1)[found], rtol=0, atol=2e-5)
    uv, changes = reference.uv_and_changes(pos, tri, shown)
    torch.testing.assert_close(rast[..., :2].double()[found], uv, rtol=0, atol=2e-5)
    torch.testing.assert_close(rast_db.double()[found], changes, rtol=1e-4, atol=2e-5)
    assert not rast[rast[..., 3] == 0].any() and not rast_db[rast[..., 3] == 0].any()


@pytest.mark.parametrize("behind", [False, True], ids=["in front", "through the camera"])
@pytest.mark.parametrize("grad_db", [True, False])
def test_gradient(device, behind, grad_db):
    pos, tri = soup(5, behind=behind)
    ours = pos.to(device).requires_grad_()
    rast, rast_db = dr.rasterize(CONTEXT, ours, tri.to(device), [HEIGHT, WIDTH], grad_db=grad_db)
    # Only where the weights are well conditioned: their slopes grow without a bound towards the camera's plane.
    steady = (rast[..., 3:] > 0) & (rast_db.abs().amax(-1, keepdim=True) < 0.3)
    pull, pull_db = (torch.randn_like(rast) * steady for _ in range(2))
    [found] = torch.autograd.grad((rast * pull).sum() + (rast_db * pull_db).sum(), ours)
    exact = pos.double().requires_grad_()
    shown = rast[..., 3].long().cpu() - 1
    seen = shown >= 0
    uv, changes = reference.uv_and_changes(exact, tri, shown)
    total = (uv * pull[..., :2].cpu().double()[seen]).sum()
    if grad_db:
        total = total + (changes * pull_db.cpu().double()[seen]).sum()
    [expected] = torch.autograd.grad(total, exact)
    assert not expected[..., 2].any() and not found[..., 2].any()  # z moves no weight
    torch.testing.assert_close(found.cpu().double(), expected, rtol=2e-4, atol=2e-4 * float(expected.abs().max()))


def test_range_mode_draws_the_triangles_of_each_range(device):
    pos, tri = soup(1, batch=1, count=7)
    pos, tri = pos[0].to(device), tri.to(device)
    ranges = torch.tensor([[0, 3], [2, 5], [6, 0]], dtype=torch.int32)
    shared = pos.clone().requires_grad_()
    rast, rast_db = dr.rasterize(CONTEXT, shared, tri, (HEIGHT, WIDTH), ranges=ranges)
    total = 0.0
    alone = pos.clone().requires_grad_()
    for image, (first, count) in enumerate(ranges.tolist()):
        own, own_db = dr.rasterize(CONTEXT, alone[None], tri[first : first + count], (HEIGHT, WIDTH))
        number = torch.where(own[..., 3] > 0, own[..., 3] + first, 0.0)
        torch.testing.assert_close(rast[image, ..., 3], number[0], rtol=0, atol=0)
        torch.testing.assert_close(rast[image, ..., :3], own[0, ..., :3], rtol=0, atol=0)
        torch.testing.assert_close(rast_db[image], own_db[0], rtol=0, atol=0)
        total = total + own[..., 0].sum() + own_db[..., 3].sum()
    ours = torch.autograd.grad(rast[..., 0].sum() + rast_db[..., 3].sum(), shared)[0]
    theirs = torch.autograd.grad(total, alone)[0]
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4 * float(theirs.abs().max()))


@pytest.mark.parametrize("behind", [False, True], ids=["in front", "through the camera"])
def test_room_for_all_parts_changes_nothing(monkeypatch, behind):
    """Where reading the positions would synchronise, each triangle has room for its parts, whether it is cut or not."""
    pos, tri = soup(2, behind=behind)
    ranges = torch.tensor([[1, 4], [0, 6]], dtype=torch.int32)
    given = [(pos, tri, (HEIGHT, WIDTH)), (pos[0], tri, (HEIGHT, WIDTH), ranges)]
    before = [dr.rasterize(CONTEXT, *one) for one in given]
    monkeypatch.setattr("neural_renderer.raster.clip.clip_corners.readable", lambda device: False)
    for (rast, rast_db), one in zip(before, given, strict=True):
        again, again_db = dr.rasterize(CONTEXT, *one)
        assert torch.equal(again, rast) and torch.equal(again_db, rast_db)


def test_orthographic_matrices_are_ordered_by_z(device):
    """w is 1 everywhere there, and tells nothing of depth."""
    square = torch.tensor([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    pos = torch.cat([torch.cat((square, torch.full((4, 1), z), torch.ones(4, 1)), 1) for z in (0.5, -0.5, 0.9)])
    tri = torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32)
    tri = torch.cat([tri + 4 * n for n in range(3)])
    rast, _ = dr.rasterize(CONTEXT, pos[None].to(device), tri.to(device), (8, 8))
    assert set(rast[..., 3].unique().tolist()) == {3.0, 4.0}
    torch.testing.assert_close(rast[..., 2].cpu(), torch.full((1, 8, 8), -0.5))


def test_limits_of_depth_belong_to_the_volume(device):
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32, device=device)
    for z, seen in ((-1.0, True), (1.0, True), (-1.001, False), (1.001, False)):
        pos = torch.tensor([[[-1, -1, z, 1], [3, -1, z, 1], [-1, 3, z, 1]]], device=device)
        rast, _ = dr.rasterize(CONTEXT, pos, tri, (4, 4))
        assert bool((rast[..., 3] > 0).all()) is seen is bool((rast[..., 3] > 0).any())


def test_row_0_is_at_the_bottom(device):
    pos = torch.tensor([[[-1.0, -1, 0, 1], [1, -1, 0, 1], [-1, 0, 0, 1]]], device=device)
    rast, _ = dr.rasterize(CONTEXT, pos, torch.tensor([[0, 1, 2]], dtype=torch.int32, device=device), (8, 8))
    assert rast[0, 0, :7, 3].all() and not rast[0, 4:, :, 3].any()


def test_layers_are_those_of_sorted_depths(device):
    pos, tri = soup(3, count=8)
    depth = reference.layers(pos, tri, HEIGHT, WIDTH)
    order = depth.argsort(1)
    with dr.DepthPeeler(CONTEXT, pos.to(device), tri.to(device), (HEIGHT, WIDTH)) as peeler:
        for n in range(5):
            rast, rast_db = (one.cpu() for one in peeler.rasterize_next_layer())
            if n == 0:
                first = dr.rasterize(dr.RasterizeCudaContext(), pos.to(device), tri.to(device), (HEIGHT, WIDTH))
                assert torch.equal(rast, first[0].cpu()) and torch.equal(rast_db, first[1].cpu())
            seen = depth.gather(1, order[:, n : n + 1])[:, 0] < torch.inf
            expected = torch.where(seen, order[:, n] + 1, 0)
            assert (rast[..., 3] == expected).float().mean() > 0.98


def test_peeler_reserves_its_context(device):
    pos, tri = (one.to(device) for one in soup(0))
    context = dr.RasterizeCudaContext()
    peeler = dr.DepthPeeler(context, pos, tri, (8, 8))
    with pytest.raises(RuntimeError, match="inside"):
        peeler.rasterize_next_layer()
    with peeler:
        with pytest.raises(ValueError, match="glctx: expected a context that no DepthPeeler uses"):
            dr.rasterize(context, pos, tri, (8, 8))
        with pytest.raises(ValueError, match="glctx"), dr.DepthPeeler(context, pos, tri, (8, 8)):
            pass
    dr.rasterize(context, pos, tri, (8, 8))


def test_points_and_vertices_that_are_not_numbers_are_not_drawn(device):
    pos, tri = soup(0)
    pos[0, 0] = torch.nan
    pos[0, 3:6] = pos[0, 3]
    rast, rast_db = dr.rasterize(CONTEXT, pos.to(device), tri.to(device), (HEIGHT, WIDTH))
    assert not {1.0, 2.0} & set(rast[0, ..., 3].unique().tolist())
    assert rast.isfinite().all() and rast_db.isfinite().all()


def test_no_triangles(device):
    pos, tri = torch.zeros(1, 3, 4, device=device), torch.zeros(0, 3, dtype=torch.int32, device=device)
    rast, _ = dr.rasterize(CONTEXT, pos, tri, (4, 4))
    assert not rast.any()


@pytest.mark.parametrize("power", [-120, -66, 66, 120])
def test_clip_coordinates_of_any_size(power):
    """They are homogeneous: a common factor changes no pixel, and divides the gradient. It gave NaN."""
    pos, tri = soup(0)
    results = []
    for factor in (1.0, 2.0**power):
        points = (pos * factor).requires_grad_()
        rast, rast_db = dr.rasterize(CONTEXT, points, tri, (HEIGHT, WIDTH))
        image = dr.antialias(rast[..., :2].contiguous(), rast, points, tri)
        (gradient,) = torch.autograd.grad((image.square().sum() + rast_db.abs().sum()), points)
        results.append((rast.detach(), rast_db.detach(), image.detach(), gradient * factor))
    for once, again in zip(*results, strict=True):
        assert torch.allclose(once, again, rtol=1e-4, atol=1e-5 * float(once.abs().max()))
