"""Texture images: bilinear and mipmapped sampling, and gradients to texels and coordinates."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from tests.rounding import rounding


def ramp(height, width, device):
    """A texture whose colour is the coordinate of each texel's centre."""
    u = (torch.arange(width, device=device) + 0.5) / width
    v = 1 - (torch.arange(height, device=device) + 0.5) / height
    return torch.stack((u.expand(height, width), v[:, None].expand(height, width)), -1)


def test_a_ramp_gives_back_the_coordinates(device):
    uv = 0.1 + 0.8 * torch.rand(2, 9, 7, 2, generator=torch.Generator().manual_seed(0)).to(device)
    for wrap in ("repeat", "clamp"):
        # A place among 48 texels is a few roundings of 48 off, and texels differ by 1 / 32.
        torch.testing.assert_close(nr.sample_texture(ramp(32, 48, device), uv, wrap=wrap), uv, **rounding(8, 48 / 32))


def test_beyond_the_border(device):
    texture = torch.rand(4, 4, 3, generator=torch.Generator().manual_seed(0)).to(device)
    uv = torch.rand(1, 5, 5, 2, generator=torch.Generator().manual_seed(1)).to(device)
    # uv + 3 is rounded at 4, and then there are 4 texels.
    torch.testing.assert_close(nr.sample_texture(texture, uv + 3), nr.sample_texture(texture, uv), **rounding(8, 16))
    left, right = torch.tensor([[[[0.0, 0.375]]]], device=device), torch.tensor([[[[1.0, 0.375]]]], device=device)
    torch.testing.assert_close(nr.sample_texture(texture, left), nr.sample_texture(texture, right))
    torch.testing.assert_close(nr.sample_texture(texture, left)[0, 0, 0], (texture[2, 0] + texture[2, -1]) / 2)
    far = left - torch.tensor([5.0, 0.0], device=device)
    torch.testing.assert_close(nr.sample_texture(texture, far, wrap="clamp")[0, 0, 0], texture[2, 0])


def plane(device, size):
    vertices = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], device=device)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]], device=device)
    camera = nr.Camera.look_at((0.0, 0.0, 3.0), viewing_angle=20).to(device)
    fragments = nr.fragments((vertices, faces), camera, size, anti_aliasing=False)
    return fragments, fragments.interpolate((vertices[:, :2] + 1) / 2)


def test_mipmaps_average_what_a_pixel_covers(device):
    """A checkerboard far finer than the pixels is grey, and one coarser than them is itself."""
    fragments, uv = plane(device, 24)
    board = (torch.arange(512, device=device)[:, None] + torch.arange(512, device=device)) % 2
    fine = nr.sample_texture(board[..., None].float(), uv, fragments.face_index)
    assert (fine[fragments.mask] - 0.5).abs().max() < 0.01
    assert nr.sample_texture(board[..., None].float(), uv)[fragments.mask].std() > 0.1
    coarse = torch.rand(6, 6, 3, generator=torch.Generator().manual_seed(0)).to(device)
    filtered = nr.sample_texture(coarse, uv, fragments.face_index)
    torch.testing.assert_close(filtered[fragments.mask], nr.sample_texture(coarse, uv)[fragments.mask])
    assert (filtered[~fragments.mask] == 0).all()


def test_gradients(device):
    fragments, uv = plane(device, 24)
    texture = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0)).to(device).requires_grad_()
    colors = nr.sample_texture(texture, uv, fragments.face_index)
    (fragments.composite(colors, 1.0) ** 2).sum().backward()
    assert texture.grad.isfinite().all() and (texture.grad.sum(-1) != 0).float().mean() > 0.9
    place = (0.1 + 0.8 * torch.rand(1, 3, 3, 2, generator=torch.Generator().manual_seed(1))).to(device).requires_grad_()
    nr.sample_texture(ramp(16, 16, device), place).sum().backward()
    # Differences of 1 / 16 between texels, times 16.
    torch.testing.assert_close(place.grad, torch.ones_like(place), **rounding(32, 16))


def test_what_does_not_fit(device):
    uv = torch.zeros(2, 4, 4, 2, device=device)
    with pytest.raises(ValueError, match="uv: expected shape"):
        nr.sample_texture(torch.zeros(4, 4, 3, device=device), uv[..., :1])
    with pytest.raises(ValueError, match="texture: expected a batch of 1 or 2 like uv, got 3"):
        nr.sample_texture(torch.zeros(3, 4, 4, 3, device=device), uv)
    with pytest.raises(ValueError, match="texture: expected at least one texel"):
        nr.sample_texture(torch.zeros(0, 4, 3, device=device), uv)
    with pytest.raises(ValueError, match="wrap: expected one of repeat, clamp"):
        nr.sample_texture(torch.zeros(4, 4, 3, device=device), uv, wrap="border")
    with pytest.raises(ValueError, match="face_index: expected"):
        nr.sample_texture(
            torch.zeros(4, 4, 3, device=device), uv, torch.zeros(2, 4, 5, dtype=torch.int32, device=device)
        )
