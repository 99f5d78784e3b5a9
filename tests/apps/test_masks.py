"""Masks of pictures by colour, threshold and morphology."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.masks.operations import dilate, erode, fill_holes, opened
from neural_renderer.apps.common.masks.rule import MaskRule


@pytest.mark.parametrize("radius", [0, 1, 3, 7])
def test_dilation_by_a_disc(radius: int) -> None:
    mask = torch.rand(30, 24, generator=torch.Generator().manual_seed(0)) > 0.97
    y, x = torch.meshgrid(torch.arange(30), torch.arange(24), indexing="ij")
    points = torch.nonzero(mask)
    near = (y[..., None] - points[:, 0]) ** 2 + (x[..., None] - points[:, 1]) ** 2 <= radius**2
    assert torch.equal(dilate(mask, radius), near.any(-1))
    assert torch.equal(erode(~mask, radius), ~near.any(-1))


def test_opening_removes_what_is_thin() -> None:
    mask = torch.zeros(40, 40, dtype=torch.bool)
    mask[10:30, 10:30] = True
    block = mask.clone()
    mask[20, :] = True
    clean = opened(mask, 2)  # a disc rounds the corners of the block, and those between block and line
    assert (clean & ~block).sum() <= 4 and (clean & block).sum() > 0.95 * block.sum()


def test_threshold_with_closing_and_specks() -> None:
    image = torch.full((60, 60, 3), 0.1)
    image[15:45, 15:45] = 0.5
    image[28:31, 28:31] = 0.05  # a shadow
    image[2, 2] = 0.9  # a speck
    mask = MaskRule(below=0.19).find(image)
    assert mask[29, 29] == 0 and mask[2, 2] == 0 and mask.sum() == 900 - 9
    closed = MaskRule(below=0.19, closing=(4, 4)).find(image)
    assert closed.sum() == 900 and closed[29, 29] == 1
    filled = MaskRule(below=0.19, fill=0.02).find(image)  # the shadow has 9 / 891 of the object
    assert filled.sum() == 900 and MaskRule(below=0.19, fill=0.005).find(image).sum() == 891
    assert MaskRule(below=0.19, closing=(5, 3)).find(image).sum() > 1000


def test_holes_of_large_masks_are_filled() -> None:
    mask = torch.zeros(1500, 2600, dtype=torch.bool)
    mask[200:1300, 300:2200] = True
    whole = mask.clone()
    mask[700:741, 903:950] = False
    mask[200:500, 1000:1600] = False  # a bay
    bay = mask[200:500, 1000:1600].clone()
    filled = fill_holes(mask, 0.01)
    assert filled[700:741, 903:950].all() and not (filled & ~whole).any()
    assert torch.equal(filled[200:500, 1000:1600], bay)


def test_rules_that_do_not_fit() -> None:
    for options, sentence in (
        ({"background": (255, 255, 255)}, r"background: expected red, green and blue in \[0, 1\]"),
        ({"tolerance": 2}, r"tolerance: expected a number in \[0, 1\]"),
        ({"below": 19}, "mask_below: expected a brightness"),
        ({"fill": 2}, r"mask_fill: expected a share in \[0, 1\]"),
        ({"closing": (-1, 0)}, "mask_close: expected at least 0"),
    ):
        with pytest.raises(ValueError, match=sentence):
            MaskRule(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("background", [(1.0, 1.0, 1.0), (0.1, 0.2, 0.6), (0.0, 0.0, 0.0)])
def test_outlines_are_sub_pixel_right(background: tuple[float, float, float]) -> None:
    """Pixels that a threshold counts as whole lie half a pixel outside of the outline, in the mean."""
    camera = nr.Camera.look_at((1.0, 1.5, 3.0), viewing_angle=25.0)
    light = nr.Light(direction=(-0.4, -0.8, -1.0))
    images = nr.render(nr.Mesh.icosphere(3), camera, 200, light=light, shading="smooth")
    alpha, paper = images.alpha[0], torch.tensor(background)
    colors = torch.tensor([0.9, 0.6, 0.3])[:, None, None] * images.rgb[0] + 0.1 * alpha
    photo = (colors + (1 - alpha) * paper[:, None, None]).permute(1, 2, 0)
    photo = (photo + 0.01 * torch.randn(photo.shape, generator=torch.Generator().manual_seed(0))).clamp(0, 1)
    rim = ((alpha > 0) & (alpha < 1)).sum()
    rules = [MaskRule(), MaskRule(background)] + [MaskRule(below=0.09)] * (max(background) == 0)
    for rule in rules:
        mask = rule.find(photo)
        assert abs(mask - alpha).sum() < 0.2 * rim and abs((mask - alpha).sum()) < 0.1 * rim
    margin = MaskRule(background, closing=(5, 3)).find(photo)  # as asked for
    assert set(margin.unique().tolist()) == {0.0, 1.0}


def test_outlines_of_the_background_s_color_stay() -> None:
    image = torch.full((40, 40, 3), 0.5)
    image[10:30, 10:30] = 0.58  # hardly another colour: mixtures tell nothing
    assert set(MaskRule((0.5, 0.5, 0.5)).find(image).unique().tolist()) == {0.0, 1.0}
