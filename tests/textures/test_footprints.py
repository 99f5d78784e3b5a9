"""`sample_texture` with footprints and with cube maps, against its formulas in float64."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from tests.drop_in import reference

B, H, W, C = 2, 6, 7, 3


def from_top(uv: torch.Tensor) -> torch.Tensor:
    """Coordinates whose first row is the image's first."""
    return torch.stack((uv[..., 0], 1 - uv[..., 1]), -1) if uv.shape[-1] == 2 else uv


def wanted_of(texture: torch.Tensor, uv: torch.Tensor, footprint: torch.Tensor, boundary: str) -> torch.Tensor:
    level = reference.level_of(from_top(uv), footprint.flatten(3), *texture.shape[-3:-1])
    images = []
    for n in range(len(uv)):
        levels = [texture[n % len(texture)]]
        while max(levels[-1].shape[-3:-1]) > 1:
            levels.append(reference.halved(levels[-1]))
        images.append(reference.trilinear(levels, from_top(uv)[n], level[n], boundary))
    return torch.stack(images)


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "cube"])
def test_samples_and_gradients(device, wrap):
    random = torch.Generator().manual_seed(0)
    cube = wrap == "cube"
    shape = (1, 6, 8, 8, C) if cube else (B, 8, 16, C)
    texture = torch.rand(shape, generator=random)
    uv = torch.randn(B, H, W, 3 if cube else 2, generator=random)
    footprint = torch.randn(B, H, W, uv.shape[-1], 2, generator=random) * 0.2
    ours = [one.clone().to(device).requires_grad_() for one in (texture, uv, footprint)]
    found = nr.sample_texture(*ours[:2], footprint=ours[2], wrap="repeat" if cube else wrap)
    exact = [one.double().requires_grad_() for one in (texture, uv, footprint)]
    wanted = wanted_of(*exact, {"repeat": "wrap"}.get(wrap, wrap))
    torch.testing.assert_close(found.cpu().double(), wanted, rtol=0, atol=2e-5)
    pull = torch.randn(found.shape, generator=random)
    mine = torch.autograd.grad(found, ours, pull.to(device))
    theirs = torch.autograd.grad(wanted, exact, pull.double())
    for one, other in zip(mine, theirs, strict=True):
        torch.testing.assert_close(one.cpu().double(), other, rtol=1e-3, atol=2e-4 * float(other.abs().max()))


def test_each_axis_has_its_own_border(device):
    random = torch.Generator().manual_seed(1)
    texture, uv = torch.rand(8, 8, C, generator=random).to(device), torch.rand(1, H, W, 2, generator=random).to(device)
    footprint = torch.full((1, H, W, 4), 0.2, device=device)

    def sampled(of: torch.Tensor, wrap: object) -> torch.Tensor:
        return nr.sample_texture(texture, of, footprint=footprint, wrap=wrap)

    apart = sampled(uv + torch.tensor([3.0, 0], device=device), ("repeat", "clamp"))
    torch.testing.assert_close(apart, sampled(uv, ("repeat", "clamp")), rtol=0, atol=1e-5)
    above, border = uv.clone(), uv.clone()
    above[..., 1], border[..., 1] = 3, 1
    torch.testing.assert_close(sampled(above, ("repeat", "clamp")), sampled(border, ("repeat", "clamp")))
    torch.testing.assert_close(sampled(-uv, "mirror"), sampled(uv, "clamp"), rtol=0, atol=1e-5)


def test_faces_give_a_cube_map_its_levels(device):
    """A cube map whose texels alternate is grey where a pixel covers many of them, and 0 where there is no face."""
    x = torch.linspace(-0.9, 0.9, 16, device=device)
    directions = torch.stack((torch.ones(16, 16, device=device), x.expand(16, 16), x[:, None].expand(16, 16)), -1)[None]
    face_index = torch.zeros(1, 16, 16, dtype=torch.int64, device=device)
    face_index[0, 0, 0] = -1
    directions[0, 0, 0] = torch.nan
    board = ((torch.arange(256)[:, None] + torch.arange(256)) % 2).float().to(device)
    found = nr.sample_texture(board.expand(6, 256, 256)[..., None], directions, face_index)
    assert found[0, 0, 0] == 0
    torch.testing.assert_close(found.flatten()[1:], torch.full((255,), 0.5, device=device), rtol=0, atol=1e-5)
    sharp = nr.sample_texture(board.expand(6, 256, 256)[..., None], directions[:, 1:])
    assert sharp.std() > 0.1
    limited = nr.sample_texture(board.expand(6, 256, 256)[..., None], directions, face_index, max_mip_level=0)
    torch.testing.assert_close(limited[:, 1:], sharp)


def test_differences_are_those_of_mipmapped_images(device):
    """Along the axes of the image, the footprint of differences gives what face_index gives."""
    x, y = torch.linspace(0, 1.5, 9, device=device), torch.linspace(0, 0.7, 9, device=device)
    uv = torch.stack((x.expand(9, 9), y[:, None].expand(9, 9)), -1)[None]
    footprint = torch.tensor([[1.5 / 8, 0], [0, 0.7 / 8]], device=device).expand(1, 9, 9, 2, 2)
    texture = torch.rand(16, 16, C, generator=torch.Generator().manual_seed(2)).to(device)
    by_faces = nr.sample_texture(texture, uv, torch.zeros(1, 9, 9, dtype=torch.int64, device=device))
    torch.testing.assert_close(nr.sample_texture(texture, uv, footprint=footprint), by_faces, rtol=0, atol=1e-5)


def test_pixels_without_a_face_give_no_gradient(device):
    uv = torch.rand(1, 2, 2, 2, device=device)
    footprint = torch.full((1, 2, 2, 4), 0.3, device=device)
    uv[0, 0, 0], footprint[0, 0, 0] = torch.nan, torch.inf
    uv.requires_grad_(), footprint.requires_grad_()
    face_index = torch.tensor([[[-1, 0], [0, 0]]], device=device)
    found = nr.sample_texture(torch.rand(8, 8, C, device=device), uv, face_index, footprint=footprint)
    assert not found[0, 0, 0].any()
    found.sum().backward()
    assert not uv.grad[0, 0, 0].any() and not footprint.grad[0, 0, 0].any() and uv.grad.isfinite().all()


@pytest.mark.parametrize(
    ("texture", "uv", "footprint", "message"),
    [
        ((6, 4, 8, 3), (1, 2, 2, 3), None, "texture: expected square faces of a cube map, got"),
        ((4, 4, 3), (1, 2, 2, 3), None, "texture: expected"),
        ((2, 6, 4, 4, 3), (1, 2, 2, 3), None, "texture: expected a batch of 1 or 1 like uv, got 2"),
        ((4, 4, 3), (1, 2, 2, 2), (1, 2, 2, 6), "footprint: expected shape"),
        ((6, 4, 4, 3), (1, 2, 2, 3), (1, 2, 2, 2, 2), "footprint: expected shape"),
    ],
)
def test_what_does_not_fit(texture, uv, footprint, message):
    given = None if footprint is None else torch.zeros(footprint)
    with pytest.raises(ValueError, match=message):
        nr.sample_texture(torch.zeros(texture), torch.zeros(uv), footprint=given)
    with pytest.raises(ValueError, match="footprint: expected finite"):
        nr.sample_texture(torch.zeros(4, 4, 3), torch.zeros(1, 2, 2, 2), footprint=torch.full((1, 2, 2, 4), torch.nan))
