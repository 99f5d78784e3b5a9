"""Texels that no face shows get the surrounding colours; all others stay unchanged."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr

RED = torch.tensor([1.0, 0.0, 0.0])


def test_gutters_take_the_colours_beside_them():
    texture = torch.zeros(32, 32, 3)
    texture[8:24, 8:16] = torch.tensor([1.0, 0, 0])
    texture[8:24, 16:24] = torch.tensor([0.0, 0, 1])
    quad = torch.tensor([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]])
    uv = quad[torch.tensor([[0, 1, 2], [0, 2, 3]])]
    texture.requires_grad_()
    filled = nr.fill_gutters(texture, uv)
    assert torch.equal(filled[8:24, 8:24], texture[8:24, 8:24])
    assert (filled.sum(-1) - 1).abs().max() < 1e-5  # means of means: nothing of the black
    assert filled[16, 2, 0] > 0.8 and filled[16, 29, 2] > 0.8
    filled.sum().backward()
    assert (texture.grad[:8] == 0).all() and (texture.grad[8:24, 8:24] >= 1).all()
    for other in (uv + 3, uv.flip(1)):  # in another repetition of the image; mirrored, as charts are that serve twice
        torch.testing.assert_close(nr.fill_gutters(texture.detach(), other), filled.detach())


def test_texels_that_are_not_known_take_the_colours_around():
    quad = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    uv = quad[torch.tensor([[0, 1, 2], [0, 2, 3]])]
    texture = torch.full((16, 16, 3), 0.25)
    texture[4:9, 5:11] = 1.0
    known = texture[..., 0] < 1
    torch.testing.assert_close(nr.fill_gutters(texture, uv, known), torch.full((16, 16, 3), 0.25))
    assert torch.equal(nr.fill_gutters(texture, uv, torch.zeros_like(known)), texture)  # nothing to begin from


@pytest.mark.parametrize("spread", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("shape", [[[0, 0], [0, 0], [0, 0]], [[0, 0], [1, 0], [2, 0]], [[0, 0], [0, 1], [1, 0]]])
def test_what_faces_without_area_show_is_kept(shape, spread):
    """As on a palette, whose faces are points in it: all texels that are blended there are shown."""
    generator = torch.Generator().manual_seed(0)
    texture = torch.rand(40, 60, 3, generator=generator)
    place = torch.rand(30, 1, 2, generator=generator) * torch.tensor([0.9, 0.9]) + 0.05
    uv = place + spread * torch.tensor(shape) / torch.tensor([60.0, 40.0])
    filled = nr.fill_gutters(texture, uv)
    weights = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [1 / 3, 1 / 3, 1 / 3]])
    inside = (weights @ uv)[None]
    torch.testing.assert_close(nr.sample_texture(filled, inside), nr.sample_texture(texture, inside))
    assert (filled != texture).any(-1).float().mean() > 0.5


def test_an_image_that_repeats_within_a_face_is_shown_whole():
    texture = torch.zeros(8, 8, 3)
    texture[:, :4] = RED
    strip = torch.tensor([[[0.0, 0.0], [10.0, 0.0], [10.0, 0.2]]])
    assert torch.equal(nr.fill_gutters(texture, strip), texture)


def test_beyond_its_borders_an_image_that_is_clamped_shows_them():
    texture = torch.rand(16, 16, 3)
    outside = torch.tensor([[[1.2, 0.1], [1.5, 0.1], [1.2, 0.9]]])
    filled = nr.fill_gutters(texture, outside, wrap="clamp")
    places = torch.tensor([[[1.2, 0.1], [1.3, 0.5], [9.0, 0.9]]])[None]
    clamped = nr.sample_texture(filled, places, wrap="clamp")
    torch.testing.assert_close(clamped, nr.sample_texture(texture, places, wrap="clamp"))
    assert not torch.equal(filled[1:-1, 1:-1], texture[1:-1, 1:-1])


def test_a_sliver_that_leaves_an_image_that_is_clamped():
    texture = torch.rand(64, 64, 3)
    sliver = torch.tensor([[[0.1, 0.1], [4.0, 0.9], [4.0, 0.901]]])
    filled = nr.fill_gutters(texture, sliver, wrap="clamp")
    along = sliver[:, :1] + torch.linspace(0, 1, 200)[None, :, None] * (sliver[:, 1:2] - sliver[:, :1])
    shown, expected = (nr.sample_texture(each, along[None], wrap="clamp") for each in (filled, texture))
    torch.testing.assert_close(shown, expected)
    assert not torch.equal(filled, texture)


def test_slivers_without_number_leave_an_image_as_it_is():
    texture = torch.rand(256, 256, 3)
    ends = torch.rand(30000, 2, 2)
    slivers = torch.cat((ends, ends[:, 1:] + 1e-4), 1)
    assert torch.equal(nr.fill_gutters(texture, slivers), texture)


def test_what_does_not_fit():
    uv = torch.zeros(1, 3, 2)
    for sentence, arguments, options in (
        ("uv: expected shape", (torch.zeros(4, 4, 3), torch.zeros(2, 2)), {}),
        ("uv: expected finite", (torch.zeros(4, 4, 3), uv + torch.nan), {}),
        ("known: expected bool", (torch.zeros(4, 4, 3), uv, torch.zeros(4, 4)), {}),
        ("known: expected bool", (torch.zeros(4, 4, 3), uv, [1]), {}),
        (
            "wrap: expected one of repeat, clamp, mirror",
            (torch.zeros(4, 4, 3), uv),
            {"wrap": "border"},
        ),
    ):
        with pytest.raises(ValueError, match=sentence):
            nr.fill_gutters(*arguments, **options)
