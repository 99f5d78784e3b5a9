"""`texture` against its formulas in float64: filters, borders, cube maps, levels of detail, and their gradients."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer.nvdiffrast as dr
from tests.drop_in import reference

B, H, W, C = 2, 7, 9, 3


def directions(seed: int = 0) -> torch.Tensor:
    random = torch.Generator().manual_seed(seed)
    return torch.randn(B, H, W, 3, generator=random)


def lookup(cube: bool, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """A texture, and coordinates beyond it on all sides or directions to all faces."""
    random = torch.Generator().manual_seed(seed)
    if cube:
        return torch.rand(1, 6, 8, 8, C, generator=random), directions(seed)
    return torch.rand(B, 8, 16, C, generator=random), torch.rand(B, H, W, 2, generator=random) * 2.4 - 0.7


def one_level(levels: list[torch.Tensor], uv: torch.Tensor, boundary: str, nearest: bool = False) -> torch.Tensor:
    return torch.stack(
        [reference.sample(levels[n % len(levels)], uv[n], boundary, nearest=nearest) for n in range(len(uv))]
    )


@pytest.mark.parametrize("boundary", ["wrap", "clamp", "zero", "cube"])
@pytest.mark.parametrize("filter_mode", ["nearest", "linear"])
def test_one_level(device, boundary, filter_mode):
    tex, uv = lookup(boundary == "cube")
    ours = [one.clone().to(device).requires_grad_() for one in (tex, uv)]
    found = dr.texture(*ours, filter_mode=filter_mode, boundary_mode=boundary)
    exact = [one.double().requires_grad_() for one in (tex, uv)]
    wanted = one_level(list(exact[0]), exact[1], boundary, filter_mode == "nearest")
    torch.testing.assert_close(found.cpu().double(), wanted, rtol=0, atol=1e-5)
    pull = torch.randn(found.shape)
    mine = torch.autograd.grad(found, ours, pull.to(device))
    theirs = torch.autograd.grad(wanted, exact, pull.double(), allow_unused=True)
    torch.testing.assert_close(mine[0].cpu().double(), theirs[0], rtol=0, atol=1e-4)
    slope = torch.zeros_like(exact[1]) if filter_mode == "nearest" else theirs[1]
    torch.testing.assert_close(mine[1].cpu().double(), slope, rtol=1e-4, atol=1e-4 * float(slope.abs().max()))


@pytest.mark.parametrize("boundary", ["wrap", "clamp", "zero", "cube"])
@pytest.mark.parametrize("given", ["footprint", "bias", "both"])
def test_trilinear(device, boundary, given):
    cube = boundary == "cube"
    tex, uv = lookup(cube, 1)
    random = torch.Generator().manual_seed(2)
    uv_da = torch.randn(B, H, W, 6 if cube else 4, generator=random) * 0.2
    bias = torch.randn(B, H, W, generator=random) + (0.5 if given == "both" else 1.5)
    inputs = [tex, uv, uv_da if given != "bias" else None, bias if given != "footprint" else None]
    ours = [None if one is None else one.clone().to(device).requires_grad_() for one in inputs]
    found = dr.texture(*ours, boundary_mode=boundary)
    exact = [None if one is None else one.double().requires_grad_() for one in inputs]
    level = torch.zeros(B, H, W, dtype=torch.float64)
    if exact[2] is not None:
        level = level + reference.level_of(exact[1], exact[2], *tex.shape[-3:-1])
    if exact[3] is not None:
        level = level + exact[3]
    images = []
    for n in range(B):
        levels = [exact[0][n % len(tex)]]
        while max(levels[-1].shape[-3:-1]) > 1:
            levels.append(reference.halved(levels[-1]))
        images.append(reference.trilinear(levels, exact[1][n], level[n], boundary))
    wanted = torch.stack(images)
    inside = ((level > 0) & (level < len(levels) - 1)).float().mean()
    assert 0.3 < inside < 1  # limits, and what lies between them
    torch.testing.assert_close(found.cpu().double(), wanted, rtol=0, atol=2e-5)
    pull = torch.randn(found.shape)
    mine = torch.autograd.grad(found, [one for one in ours if one is not None], pull.to(device))
    theirs = torch.autograd.grad(wanted, [one for one in exact if one is not None], pull.double())
    for one, other in zip(mine, theirs, strict=True):
        torch.testing.assert_close(one.cpu().double(), other, rtol=1e-3, atol=2e-4 * float(other.abs().max()))


def test_one_level_is_the_finer_one(device):
    """As nvdiffrast does it: the level is rounded down, although the mode is called nearest."""
    tex, uv = torch.rand(1, 8, 8, C), torch.rand(1, 4, 4, 2)
    bias = torch.tensor([-1.0, 0.4, 0.6, 1.4, 1.6, 2.4, 2.6, 9.0]).repeat(2).view(1, 4, 4)
    found = dr.texture(
        tex.to(device), uv.to(device), mip_level_bias=bias.to(device), filter_mode="linear-mipmap-nearest"
    )
    levels = [tex[0].double()]
    while len(levels) < 4:
        levels.append(reference.halved(levels[-1]))
    for j in range(4):
        for i in range(4):
            level = min(max(math.floor(float(bias[0, j, i])), 0), 3)
            wanted = reference.sample(levels[level], uv[0, j, i].double(), "wrap")
            torch.testing.assert_close(found[0, j, i].cpu().double(), wanted, rtol=0, atol=1e-5)


def test_samples_are_continuous_across_edges_and_corners_of_cubes(device):
    tex = torch.rand(1, 6, 4, 4, 1)
    # A circle of directions that comes near two corners, in steps of 1e-3 of a texel.
    angle = torch.linspace(0, 2 * torch.pi, 40001, dtype=torch.float64)
    around = torch.stack((angle.cos(), angle.sin(), 0.98 * angle.cos() + 0.01), -1).float()[None, None]
    for bias in (0.0, 0.5, 1.0, 2.0):
        levels = torch.full((1, 1, 40001), bias)
        found = dr.texture(tex.to(device), around.to(device), mip_level_bias=levels.to(device), boundary_mode="cube")
        # Adjacent texels differ by at most 1; on the surface a step is at most 2e-3 texels.
        assert (found[0, 0, 1:] - found[0, 0, :-1]).abs().max() < 4e-3


def test_directions_without_a_face_give_zero(device):
    uv = torch.tensor([[0.0, 0, 0], [torch.nan, 1, 0], [1, torch.inf, 0], [0, 0, 1]])[None, None].to(device)
    uv.requires_grad_()
    tex = torch.ones(1, 6, 2, 2, 1, device=device, requires_grad=True)
    found = dr.texture(tex, uv, filter_mode="linear", boundary_mode="cube")
    assert found.flatten().tolist() == [0, 0, 0, 1]
    found.sum().backward()
    assert tex.grad.sum() == 1 and not uv.grad[0, 0, :3].any()


def test_mipmaps_of_the_caller_get_their_own_gradients(device):
    tex = torch.rand(1, 4, 8, C, device=device, requires_grad=True)
    mip = [torch.rand(1, 2, 4, C, device=device, requires_grad=True), torch.rand(1, 1, 2, C, device=device)]
    uv, level = torch.rand(1, 5, 5, 2, device=device), torch.full((1, 5, 5), 1.0, device=device)
    found = dr.texture(tex, uv, mip_level_bias=level, mip=mip)
    torch.testing.assert_close(found, dr.texture(mip[0], uv))
    found.sum().backward()
    assert not tex.grad.any() and mip[0].grad.any()


@pytest.mark.usefixtures("deterministic")
def test_a_stack_gives_the_same_as_none_again_and_again(device):
    tex = torch.rand(2, 8, 8, C, device=device, requires_grad=True)
    uv, uv_da = torch.rand(2, 5, 5, 2, device=device), torch.rand(2, 5, 5, 4, device=device) * 0.3
    mip = dr.texture_construct_mip(tex)
    expected = torch.autograd.grad(dr.texture(tex, uv, uv_da).square().sum(), tex)[0]
    for _ in range(2):
        found = torch.autograd.grad(dr.texture(tex, uv, uv_da, mip=mip).square().sum(), tex)[0]
        assert torch.equal(found, expected)
    with torch.no_grad():
        assert torch.equal(dr.texture(tex, uv, uv_da, mip=mip), dr.texture(tex, uv, uv_da))


def test_sides_that_cannot_be_halved_need_a_limit(device):
    tex, uv, uv_da = (torch.rand(shape, device=device) for shape in ((1, 4, 20, C), (1, 5, 5, 2), (1, 5, 5, 4)))
    with pytest.raises(ValueError, match=r"tex: expected sides that can be halved.* max_mip_level=2"):
        dr.texture(tex, uv, uv_da)
    full = dr.texture(tex, uv, uv_da, max_mip_level=2)
    assert torch.equal(full, dr.texture(tex, uv, uv_da, mip=dr.texture_construct_mip(tex, max_mip_level=2)))
    assert not torch.equal(full, dr.texture(tex, uv, uv_da, max_mip_level=0))
