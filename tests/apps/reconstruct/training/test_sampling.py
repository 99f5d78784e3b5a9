"""Training batches depend on seed and step only."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.reconstruct.data.framing import view_camera
from neural_renderer.apps.reconstruct.training.sampling import Batches, mirrored_views, prepare_batch
from tests.apps.reconstruct.synthetic import SMALL, synthetic_split


def test_batches_do_not_depend_on_where_one_begins() -> None:
    split = synthetic_split()
    whole, rest = Batches(split, SMALL, 5, 0, 8), Batches(split, SMALL, 5, 6, 8)
    assert (len(whole), len(rest)) == (8, 2)
    for name, value in whole[7].items():
        assert torch.equal(value, rest[1][name])
    assert not torch.equal(whole[0]["images"], whole[1]["images"])
    assert not torch.equal(whole[0]["images"], Batches(split, SMALL, 6, 0, 8)[0]["images"])


def test_processes_share_a_batch() -> None:
    split = synthetic_split()
    whole = Batches(split, SMALL, 0, 3, 4)[0]
    parts = [Batches(split, SMALL, 0, 3, 4, rank, 2)[0] for rank in range(2)]
    for name, value in whole.items():
        across = 1 if name in ("images", "views") else 0
        assert torch.equal(torch.cat([part[name] for part in parts], across), value)
    with pytest.raises(ValueError, match="devices: expected a divisor of the batch of 4 objects, got 3"):
        Batches(split, SMALL, 0, 0, 1, 0, 3)


def test_classes_and_views_are_drawn_evenly() -> None:
    split = synthetic_split(objects=1)
    config = replace(SMALL, objects=2000, augment=False)
    batch = Batches(split, config, 0, 0, 1)[0]
    assert torch.bincount(batch["views"].flatten(), minlength=24).min() > 110  # of 167 expected
    first = torch.from_numpy(split.images["ball"][0])
    share = (batch["images"][0] == first[batch["views"][0]]).flatten(1).all(1).float().mean()
    assert 0.45 < share < 0.55


def test_a_mirrored_object_is_what_another_view_shows() -> None:
    """A flipped image equals the rendered image of the mirrored object, in every view."""
    split = synthetic_split(objects=1)
    images = torch.from_numpy(split.images["box"])  # [1, 24, 4, 64, 64]
    views = torch.arange(24)
    batch = {"images": images.transpose(0, 1), "views": views[:, None], "flip": torch.tensor([True])}
    _, alpha, views_drawn = prepare_batch(batch, 1)
    assert torch.equal(views_drawn[:, 0], mirrored_views(views)) and torch.equal(
        mirrored_views(mirrored_views(views)), views
    )

    generator = torch.Generator().manual_seed(0)
    vertices, faces = nr.cube()
    torch.rand(2, 3, generator=generator), torch.rand(3, generator=generator)  # the ball's
    size, place = torch.rand(2, 3, generator=generator)
    vertices = (vertices * (0.1 + 0.15 * size) + 0.3 * (place - 0.5)) * torch.tensor([1.0, 1.0, -1.0])
    drawn = nr.render((vertices, faces), view_camera(views_drawn[:, 0]), 64, outputs="alpha").alpha
    assert drawn is not None and (drawn - alpha[:, 0]).abs().max() < 0.003  # 8 bits


def test_prepared_images() -> None:
    batch = Batches(synthetic_split(), SMALL, 0, 0, 1)[0]
    images, alpha, views = prepare_batch(batch, 2)
    assert images.shape == (2, 4, 4, 64, 64) and views.shape == (2, 4)
    assert images.min() >= 0 and images.max() <= 1 and torch.equal(images[:, :, 3], alpha)
    plain = prepare_batch({name: batch[name] for name in ("images", "views")}, 1)
    assert torch.equal(plain[0], batch["images"][:1] / 255) and torch.equal(plain[2], batch["views"])
