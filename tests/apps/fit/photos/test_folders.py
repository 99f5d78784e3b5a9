"""Folders of photographs by phones and cameras: what is read, and what is named."""

from __future__ import annotations

import contextlib
import sys
import warnings
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image, TiffImagePlugin

import neural_renderer as nr
from neural_renderer.apps.fit.photos.copies import copy_photographs, photographs_in


def quiet(phase: str, done: int, total: int) -> None:
    """Ignore the progress."""


def test_photographs_in_one_folder_inside_are_found_and_those_in_several_are_named(tmp_path: Path) -> None:
    for name in ("day1/a.jpg", "day1/b.jpg", "day1/.hidden.jpg", "masks/a.jpg"):
        nr.save_image(tmp_path / name, torch.zeros(3, 16, 16))
    assert photographs_in(tmp_path) == [tmp_path / "day1/a.jpg", tmp_path / "day1/b.jpg"]
    nr.save_image(tmp_path / "DCIM/100/a.jpg", torch.zeros(3, 16, 16))
    assert photographs_in(tmp_path / "DCIM") == [tmp_path / "DCIM/100/a.jpg"]
    (tmp_path / "DCIM/100/a.jpg").unlink()
    nr.save_image(tmp_path / "day2/c.jpg", torch.zeros(3, 16, 16))
    with pytest.raises(FileNotFoundError, match="got none here, but 2 in day1, 1 in day2; give one of these folders"):
        photographs_in(tmp_path)


def test_raw_files_are_named_with_what_to_do(tmp_path: Path) -> None:
    for name in ("a.CR2", "b.CR2"):
        (tmp_path / name).write_bytes(b"raw")
    if find_spec("rawpy") is None:
        with pytest.raises(FileNotFoundError, match=r"got 2 raw files \(.CR2\); pip install rawpy, or develop them"):
            photographs_in(tmp_path)


def test_raw_files_are_developed_where_a_library_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Raw(contextlib.AbstractContextManager[Any]):
        def __exit__(self, *_: object) -> None: ...

        def postprocess(self, **options: bool) -> np.ndarray:
            assert options == {"use_camera_wb": True, "no_auto_bright": True}
            return np.full((48, 64, 3), (200, 40, 20), np.uint8)

    rawpy = ModuleType("rawpy")
    rawpy.__spec__ = ModuleSpec("rawpy", None)
    rawpy.imread = lambda name: Raw() if "b" not in Path(name).name else 1 / 0  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "rawpy", rawpy)
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[271], tags[274], tags[0x8769] = "Nikon", 6, {0x920A: 35.0}
    tags.tagtype[0x8769] = 4
    for name in ("a.NEF", "c.NEF"):
        Image.new("RGB", (16, 12)).save(tmp_path / name, "TIFF", tiffinfo=tags)
    (tmp_path / "b.DNG").write_bytes(b"damaged")
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert copies.names == ["a.jpg", "c.jpg"]
    assert copies.refused == {"b.DNG": "expected a raw file, got one that cannot be read"}
    with Image.open(tmp_path / "out" / "images" / "a.jpg") as image:
        assert image.size == (64, 48)
        found = image.getexif()
        assert found[271] == "Nikon" and found.get_ifd(0x8769)[0x920A] == 35 and found.get(274) == 1
    nr.save_image(tmp_path / "b.jpg", torch.zeros(3, 16, 16))
    assert photographs_in(tmp_path) == [tmp_path / "b.jpg"], "a camera writes a picture beside each raw file"


def test_photographs_have_a_limit_of_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice that of other pictures: phones have cameras of 108 million pixels."""
    for name, side in (("a", 16), ("b", 20), ("c", 24)):
        Image.new("RGB", (side, 20)).save(tmp_path / f"{name}.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 200)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert copies.names == ["a.png", "b.png"] and list(copies.refused) == ["c.png"]


def test_heif_files_are_read(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif")
    heif.register_heif_opener()
    for name in ("a.HEIC", "b.heic"):
        Image.new("RGB", (64, 48), (200, 40, 20)).save(tmp_path / name, format="HEIF")
    copies = copy_photographs(tmp_path, tmp_path / "out", 60, quiet)
    assert copies.names == ["a.jpg", "b.jpg"]
    with Image.open(tmp_path / "out" / "images" / "a.jpg") as image:
        assert image.size == (64, 48)
        assert max(abs(value - true) for value, true in zip(image.getpixel((30, 20)), (200, 40, 20), strict=True)) < 12


def test_a_missing_library_for_heif_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    (tmp_path / "a.heic").write_bytes(b"")
    with pytest.raises(ModuleNotFoundError, match=r"expected pillow_heif to be installed to read .heic files"):
        copy_photographs(tmp_path, tmp_path / "out", 60, quiet)


@pytest.mark.parametrize("name", ["images", "sparse", "masks"])
def test_a_run_deletes_nothing_through_links(name: str, tmp_path: Path) -> None:
    """The folder of the results may come from others, and name the photographs of its user."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "mine")
    with pytest.raises(ValueError, match=rf"output: expected folders of its own, got the link .*{name}"):
        copy_photographs(tmp_path / "mine", tmp_path / "out", 1, quiet)
