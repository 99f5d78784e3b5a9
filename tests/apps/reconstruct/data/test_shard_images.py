"""Training data in shards of `neural-renderer dataset`: the pictures of the reconstruction frame, by random access."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.reconstruct.data.arrays import classes_of, open_split
from neural_renderer.apps.reconstruct.data.dataset import Settings, make_object
from neural_renderer.apps.reconstruct.training.sampling import Batches
from tests.apps.reconstruct.synthetic import SMALL

FRAME = ["--views", "24", "--size", "64", "--azimuth", "90", "--elevation", "30", "--viewing-angle", "15"]
FRAME += ["--distance", "5.464", "--index", "csv", "-j", "0"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("models")
    vertices, faces = nr.cube()
    for number in range(4):
        nr.save_mesh(place / "box" / f"b{number}.ply", vertices * torch.tensor([1.0, 0.5, 0.3 + number / 5]), faces)
    nr.save_mesh(place / "wedge" / "w.obj", vertices[:4] * torch.tensor([1.0, 2.0, 3.0]), faces[:2])
    assert cli.main(["dataset", str(place), "-o", str(place / "shards"), *FRAME]) == 0
    return place


def test_pictures_are_those_of_reconstruct_dataset(folder: Path) -> None:
    split = open_split(folder / "shards", "train")
    assert split.classes == ("box", "wedge") and classes_of(folder / "shards", "val") in ([], ["box"])
    assert len(split) + len(open_split(folder / "shards", "test")) in (4, 5)
    images = make_object(folder / "box" / f"{split.names['box'][0]}.ply", Settings(samples=4))[0].numpy()
    mine = split.images["box"][0]
    assert mine.copy().shape == images.shape
    for view in (0, 5, 17):
        one, other = mine[view][3].astype(float), images[view, 3].astype(float)
        assert mine[view].dtype == np.uint8 and (one > 0).any()
        # 2 × 2 and 4 × 4 samples differ at outlines only, by less than two of four samples.
        assert np.abs(one - other).max() <= 128 and np.array_equal(one == 255, one >= 255)
        assert ((one == 255) & (other == 0)).sum() == 0 and ((one == 0) & (other == 255)).sum() == 0
    assert np.array_equal(split.images["box"][0, 3], mine[3])


def test_batches_from_shards(folder: Path) -> None:
    split = open_split(folder / "shards", "train", ["box"])
    whole, half = Batches(split, SMALL, 0, 0, 3), Batches(split, SMALL, 0, 0, 3, 1, 2)
    for batch, share in zip((whole[i] for i in range(3)), (half[i] for i in range(3)), strict=True):
        assert batch["images"].shape == (SMALL.views, 4, 4, 64, 64)
        assert torch.equal(batch["images"][:, 2:], share["images"])


def test_other_data_sets_are_refused(folder: Path, tmp_path: Path) -> None:
    assert cli.main(["dataset", str(folder / "box"), "-o", str(tmp_path), *FRAME, "--views", "12"]) == 0
    with pytest.raises(ValueError, match=r"expected views of the reconstruction frame, .* got another views"):
        open_split(tmp_path, "train")
    with pytest.raises(FileNotFoundError, match="expected gold in the split train, got none"):
        open_split(folder / "shards", "train", ["gold"])
