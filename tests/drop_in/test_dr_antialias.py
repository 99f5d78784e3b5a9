"""`antialias` against its formula in float64, and its gradient against what the smoothed image does."""

from __future__ import annotations

import pytest
import torch

import neural_renderer.nvdiffrast as dr
from tests.drop_in import reference
from tests.drop_in.scenes import CONTEXT, fan, soup


@pytest.mark.parametrize("scene", [soup, fan])
@pytest.mark.parametrize("seed", range(3))
def test_values_and_gradients(device, scene, seed):
    pos, tri = scene(seed, 1)
    pos = pos[:, : 3 * len(tri)]
    rast, _ = dr.rasterize(CONTEXT, pos.to(device), tri.to(device), (12, 14))
    rast, color = rast.detach(), torch.rand(1, 12, 14, 3)
    ours = [color.clone().to(device).requires_grad_(), pos.clone().to(device).requires_grad_()]
    found = dr.antialias(ours[0], rast, ours[1], tri.to(device))
    exact = [color.double().requires_grad_(), pos.double().requires_grad_()]
    shown = rast[..., 3].cpu().long() - 1
    wanted = reference.antialias(exact[0], shown, rast[..., 2].cpu(), exact[1], tri)
    assert ((wanted - exact[0]).abs().amax(-1) > 0).sum() > 5  # pixels are blended
    torch.testing.assert_close(found.cpu().double(), wanted, rtol=0, atol=2e-4)
    pull = torch.randn(found.shape)
    mine = torch.autograd.grad(found, ours, pull.to(device))
    theirs = torch.autograd.grad(wanted, exact, pull.double())
    torch.testing.assert_close(mine[0].cpu().double(), theirs[0], rtol=0, atol=5e-4)
    torch.testing.assert_close(mine[1].cpu().double(), theirs[1], rtol=1e-3, atol=1e-3 * float(theirs[1].abs().max()))


@pytest.mark.parametrize("angle", [0.2, 0.6, 1.0, 1.4, 2.5])
def test_gradient_is_that_of_the_smoothed_image(device, angle):
    """The image is continuous while an edge moves: the integral of the gradient is the change.

    The loss looks at a disc that no corner enters, as the edge turns and moves through it by two pixels.
    """
    size, steps = 32, 400
    turn = torch.tensor([[torch.cos(torch.tensor(angle)), -torch.sin(torch.tensor(angle))]])
    turn = torch.cat((turn, torch.tensor([[torch.sin(torch.tensor(angle)), torch.cos(torch.tensor(angle))]])))
    corners = torch.tensor([[-3.0, 0], [3, 0], [0, -5]]) @ turn.T
    start = torch.cat((corners, torch.zeros(3, 1), torch.ones(3, 1)), 1) * torch.tensor([[1.0], [2], [1.5]])
    way = torch.randn(3, 4, generator=torch.Generator().manual_seed(3)) * torch.tensor([1.0, 1, 0, 0.1]) * 0.06
    x, y = reference.centres(size, size)
    weight = ((0.5 - (x[None] ** 2 + y[:, None] ** 2)).clamp(min=0) * (1 + x[None])).float().to(device)
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32, device=device)

    def loss(pos: torch.Tensor) -> torch.Tensor:
        rast, _ = dr.rasterize(CONTEXT, pos, tri, (size, size))
        color = (rast[..., 3:] > 0).float()
        return (dr.antialias(color, rast, pos, tri)[..., 0] * weight).sum(dim=(1, 2))

    part = torch.linspace(0, 1, steps + 1)
    pos = (start + part[:, None, None] * way).to(device).requires_grad_()
    values = loss(pos)
    [gradient] = torch.autograd.grad(values.sum(), pos)
    slope = (gradient.cpu() * way).sum((1, 2))
    change = values.detach().cpu().diff()
    mean = (slope[1:] + slope[:-1]) / 2 / steps
    assert change.abs().sum() > 0.2
    # Each step: the image is continuous, and the slope jumps where the edge passes centres and midpoints.
    torch.testing.assert_close(change, mean, rtol=0, atol=6 * float(mean.abs().max()) / 10 + 2e-4)
    torch.testing.assert_close(change.sum(), mean.sum(), rtol=5e-3, atol=2e-3)


def test_interior_edges_are_not_blended(device):
    """A square of two triangles of different colours keeps the line between them."""
    pos = torch.tensor([[-0.7, -0.6, 0, 1], [0.8, -0.6, 0, 1], [0.8, 0.7, 0, 1], [-0.7, 0.7, 0, 1]], device=device)[
        None
    ]
    tri = torch.tensor([[0, 1, 2], [0, 2, 3]], dtype=torch.int32, device=device)
    rast, _ = dr.rasterize(CONTEXT, pos, tri, (24, 24))
    color = rast[..., 3:].clone()
    smooth = dr.antialias(color, rast, pos, tri)
    inner = (slice(None), slice(6, 18), slice(6, 18))
    assert torch.equal(smooth[inner], color[inner]) and not torch.equal(smooth, color)
    # Vertices that exist twice make it a silhouette.
    twice = torch.cat((pos[:, [0, 1, 2]], pos[:, [0, 2, 3]]), 1)
    apart = torch.arange(6, dtype=torch.int32, device=device).view(2, 3)
    assert not torch.equal(dr.antialias(color, rast, twice, apart)[inner], color[inner])


def test_boost_and_topology_hash(device):
    pos, tri = (one.to(device) for one in fan(0))
    rast, _ = dr.rasterize(CONTEXT, pos, tri, (16, 16))
    color = torch.rand(1, 16, 16, 2, device=device)
    pos.requires_grad_()
    plain = dr.antialias(color, rast, pos, tri)
    topology = dr.antialias_construct_topology_hash(tri)
    boosted = dr.antialias(color, rast, pos, tri, topology_hash=topology, pos_gradient_boost=3.0)
    assert torch.equal(plain, boosted)
    pull = torch.randn_like(plain)
    one, other = (torch.autograd.grad(each, pos, pull)[0] for each in (plain, boosted))
    torch.testing.assert_close(3 * one, other)


def test_range_mode(device):
    pos, tri = (one.to(device) for one in fan(1))
    ranges = torch.tensor([[0, 3], [3, 3]], dtype=torch.int32)
    flat = pos[0].requires_grad_()
    rast, _ = dr.rasterize(CONTEXT, flat, tri, (16, 16), ranges=ranges)
    color = torch.rand(2, 16, 16, 2, device=device)
    found = dr.antialias(color, rast, flat, tri)
    for n in range(2):
        own, _ = dr.rasterize(CONTEXT, flat[None], tri[3 * n : 3 * n + 3], (16, 16))
        torch.testing.assert_close(
            found[n : n + 1], dr.antialias(color[n : n + 1], own, flat[None], tri[3 * n : 3 * n + 3])
        )


@pytest.mark.usefixtures("deterministic")  # for emulated CUDA
@pytest.mark.parametrize("threads", [1, 4])
def test_same_to_the_bit(threads):
    """Sums are in one order on the CPU, whatever the number of threads."""
    before = torch.get_num_threads()

    def gradients() -> list[torch.Tensor]:
        pos, tri = soup(7, 2, 40)
        pos.requires_grad_()
        attr = torch.rand(1, pos.shape[1], 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
        rast, rast_db = dr.rasterize(CONTEXT, pos, tri, (96, 96))
        color, change = dr.interpolate(attr, rast, tri, rast_db, "all")
        tex = torch.rand(1, 16, 16, 3, generator=torch.Generator().manual_seed(1)).requires_grad_()
        color = dr.texture(tex, color[..., :2].contiguous(), change[..., :4].contiguous())
        image = dr.antialias(color, rast, pos, tri)
        return [image, *torch.autograd.grad(image.square().sum(), (pos, attr, tex))]

    try:
        torch.set_num_threads(1)
        one = gradients()
        torch.set_num_threads(threads)
        assert all(torch.equal(a, b) for a, b in zip(one, gradients(), strict=True))
    finally:
        torch.set_num_threads(before)
