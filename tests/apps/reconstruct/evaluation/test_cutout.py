"""Cutting objects out of pictures, and framing them like the training data."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from neural_renderer.apps.common.masks.operations import label_components, remove_specks
from neural_renderer.apps.reconstruct.evaluation.cutout import cut_out, frame_object
from neural_renderer.metrics import silhouette_iou


def scene(height: int = 240, width: int = 320) -> tuple[Tensor, Tensor]:
    """Make a noisy photo [H, W, 3] of a red ring and a blue bar on an unevenly lit wall, and its mask [H, W]."""
    generator = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
    radius = ((x - 0.1).square() + (y * 0.75).square()).sqrt()
    ring = (radius > 0.15) & (radius < 0.3)
    bar = (x > 0.35) & (x < 0.6) & (y.abs() < 0.1)
    wall = torch.tensor([0.8, 0.78, 0.72]) * (1 - 0.15 * x - 0.1 * y * y)[..., None]
    photo = torch.where(ring[..., None], torch.tensor([0.7, 0.1, 0.1]), wall)
    photo = torch.where(bar[..., None], torch.tensor([0.1, 0.2, 0.6]), photo)
    photo = photo + 0.01 * torch.randn(height, width, 3, generator=generator)
    return photo.clamp(0, 1), (ring | bar).float()


def agree(alpha: Tensor, mask: Tensor) -> float:
    return silhouette_iou(alpha[None] > 0.5, mask[None] > 0.5).item()


def test_from_a_plain_background_with_its_holes() -> None:
    photo, mask = scene()
    cut = cut_out(photo)
    assert cut.shape == (4, 240, 320) and agree(cut[3], mask) > 0.97
    assert cut[3, 120, 176] == 0  # within the ring


@pytest.mark.parametrize("background", [(1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.2, 0.6, 0.3)])
def test_any_plain_colour(background: tuple[float, float, float]) -> None:
    photo, mask = scene()
    flat = torch.where(mask[..., None] > 0, photo, torch.tensor(background))
    assert agree(cut_out(flat)[3], mask) > 0.97


def test_large_pictures_and_objects_at_the_border() -> None:
    photo, mask = scene(1000, 1400)
    rolled = torch.roll(photo, -260, 1)  # the border cuts the ring
    flat = torch.where(torch.roll(mask, -260, 1)[..., None] > 0, rolled, torch.tensor([0.9, 0.9, 0.9]))
    assert agree(cut_out(flat)[3], torch.roll(mask, -260, 1)) > 0.96


def test_a_huge_picture_is_made_smaller_without_its_background() -> None:
    rgba = torch.zeros(30, 3000, 4)  # black, transparent
    rgba[5:25, 1000:2001] = torch.tensor([0.9, 0.2, 0.1, 1])
    small = cut_out(rgba)
    assert small.shape == (4, 20, 2048)
    opaque = small[3] > 0.3
    assert (small[:3, opaque] - torch.tensor([[0.9], [0.2], [0.1]])).abs().max() < 0.01


def test_masks_and_transparency() -> None:
    photo, mask = scene()
    busy = torch.where(mask[..., None] > 0, photo, torch.rand(photo.shape))
    with pytest.warns(UserWarning, match="no plain background"):
        assert agree(cut_out(busy)[3], mask) > 0.5
    assert agree(cut_out(busy, mask)[3], mask) == 1
    smaller = torch.nn.functional.interpolate(mask[None, None], (120, 160), mode="bilinear")[0, 0]
    assert agree(cut_out(busy, smaller)[3], mask) > 0.95
    assert agree(cut_out(torch.cat((busy, mask[..., None]), 2))[3], mask) == 1
    assert agree(cut_out(torch.cat((photo, torch.ones(240, 320, 1)), 2))[3], mask) > 0.97  # opaque: as a photo
    with pytest.raises(ValueError, match="mask: expected the shape of the image, 320 x 240, got 200 x 200"):
        cut_out(photo, torch.ones(200, 200))


@pytest.mark.parametrize(
    ("image", "mask", "sentence"),
    [
        (torch.full((50, 60, 3), 0.4), None, "expected an object, got a picture without one"),
        (torch.zeros(50, 60, 4), None, "expected an object, got a picture without one"),
        (torch.rand(50, 60, 3), torch.zeros(50, 60), "expected an object, got a picture without one"),
        (torch.rand(50, 60, 3), torch.ones(50, 60), "expected background around the object"),
        (torch.rand(1, 1, 3), None, "expected an object"),
    ],
)
def test_no_object(image: Tensor, mask: Tensor | None, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        cut_out(image, mask)


def test_framed_like_the_training_data() -> None:
    for height, width, box in (
        (400, 300, (50, 60, 350, 160)),
        (30, 90, (5, 10, 25, 80)),
        (1500, 1500, (0, 0, 900, 1500)),
    ):
        rgba = torch.zeros(4, height, width)
        top, left, bottom, right = box
        rgba[:, top:bottom, left:right] = torch.tensor([0.2, 0.4, 0.6, 1.0])[:, None, None]
        image = frame_object(rgba)
        assert image.shape == (4, 64, 64) and image.dtype == torch.uint8
        rows, columns = ((image[3] > 127).any(axis).nonzero()[:, 0] for axis in (1, 0))
        sides = len(rows), len(columns)
        assert abs(max(sides) - 44) <= 1
        assert abs(min(sides) / max(sides) - min(bottom - top, right - left) / max(bottom - top, right - left)) < 0.05
        assert abs((rows[0] + rows[-1] + 1) / 2 - 33.5) <= 1 and abs((columns[0] + columns[-1] + 1) / 2 - 32) <= 1
        opaque = image[3] > 0
        assert (
            image[:3, opaque].float() - torch.tensor([51, 102, 153.0])[:, None]
        ).abs().max() <= 3  # nothing bleeds in
        assert not image[:, ~opaque].any()


def test_framed_needs_something_to_see() -> None:
    rgba = torch.zeros(4, 100, 100)
    with pytest.raises(ValueError, match="expected an object"):
        frame_object(rgba)
    rgba[:, 5:9, 5:9] = 1
    with pytest.raises(ValueError, match="expected an object of at least 8 pixels, got one of 4"):
        frame_object(rgba)


def test_specks_go_and_larger_components_stay() -> None:
    alpha = torch.zeros(100, 120)
    alpha[20:60, 20:60] = 1
    alpha[20:40, 80:100] = 1
    clean = alpha.clone()
    alpha[90, 5] = 1
    assert torch.equal(remove_specks(alpha), clean)


def test_connected_components() -> None:
    mask = torch.zeros(40, 40, dtype=torch.bool)
    mask[1::4, :] = True  # ten lines
    mask[:, 0] = True  # connected by the first column
    mask[5, 20] = False  # except for the end of one line
    label = label_components(mask)
    assert (label[~mask] == 0).all() and len(label[mask].unique()) == 2
    assert label[5, 21] != label[5, 19] == label[37, 39]


def test_a_soft_shadow_is_background_and_a_grey_object_is_not() -> None:
    y, x = torch.meshgrid(torch.arange(96.0), torch.arange(96.0), indexing="ij")
    shadow = 0.4 * torch.exp(-((x - 58) ** 2 + (y - 66) ** 2) / 250)  # steepest: 0.4 √(2 / 250 e) = 0.022 a pixel
    picture = (0.9 * (1 - shadow))[..., None].expand(-1, -1, 3).clone()
    picture[20:60, 20:50] = 0.4
    alpha = cut_out(picture)[3] > 0.5
    assert bool(alpha[22:58, 22:48].all())
    assert not bool(alpha[63:].any() or alpha[:, 53:].any())
    pale = torch.full((96, 96, 3), 1.0)
    pale[20:60, 20:50] = torch.linspace(0.88, 0.98, 30)[:, None]  # fades into the background at one side
    assert bool((cut_out(pale)[3] > 0.5)[22:58, 22:36].all())


def test_a_horizon_beside_the_object_is_background() -> None:
    picture = torch.full((96, 96, 3), 0.9)
    picture[:8] = 0.6
    picture[40:80, 30:60] = torch.tensor([0.7, 0.2, 0.1])
    alpha = cut_out(picture)[3] > 0.5
    assert bool(alpha[42:78, 32:58].all()) and not bool(alpha[:30].any())
    picture[80:] = torch.tensor([0.7, 0.2, 0.1])  # the object itself reaches over the border
    assert bool((cut_out(picture)[3] > 0.5)[42:90, 32:58].all())


def test_separate_parts_are_told() -> None:
    picture = torch.full((64, 96, 3), 0.9)
    picture[20:40, 10:30] = picture[20:40, 60:80] = 0.2
    with pytest.warns(UserWarning, match="its separate parts are taken for one object"):
        assert bool((cut_out(picture)[3] > 0.5)[22:38, 62:78].all())
    picture[20:40, 65:80] = 0.9  # a quarter of the other
    cut_out(picture)
