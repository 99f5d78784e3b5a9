"""Published files as memory-mapped arrays: contents, memory use, broken files."""

from __future__ import annotations

import json
import os
import pickle
import tracemalloc
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from neural_renderer.apps.reconstruct.data.arrays import open_split
from tests.faults import contents, full_disk


def write(folder: Path, name: str = "chair", split: str = "test", count: int = 2, **other: Any) -> np.ndarray:
    generator = np.random.default_rng(count)
    images = generator.integers(0, 255, (count, 24, 4, 64, 64), dtype=np.uint8)
    np.savez_compressed(folder / f"{name}_{split}_images.npz", other.get("images", images))
    voxels = images[:, :8].reshape(count, 32, 32, 32, 4)[..., 0] > 127
    np.savez(folder / f"{name}_{split}_voxels.npz", other.get("voxels", voxels))
    return images


def test_arrays_are_those_of_the_files(tmp_path: Path) -> None:
    chairs, cars = write(tmp_path), write(tmp_path, "car", count=3)
    write(tmp_path, "car", "train")
    split = open_split(tmp_path, "test")
    assert split.classes == ("car", "chair") and len(split) == 5
    assert isinstance(split.images["car"], np.memmap) and not split.images["car"].flags.writeable
    assert np.array_equal(split.images["car"], cars) and np.array_equal(split.images["chair"], chairs)
    assert split.voxels["car"].dtype == bool and split.voxels["car"].shape == (3, 32, 32, 32)
    assert split.names["chair"] == ("chair-0", "chair-1")
    assert open_split(tmp_path, "test", ["chair"]).classes == ("chair",)
    assert len(pickle.dumps(split)) < 1000
    assert np.array_equal(pickle.loads(pickle.dumps(split)).images["car"], cars)


def test_unpacked_once_and_anew_for_another_file(tmp_path: Path) -> None:
    write(tmp_path)
    open_split(tmp_path, "test")
    copy = tmp_path / "chair_test_images.npy"
    before = copy.stat().st_ino
    open_split(tmp_path, "test")
    assert copy.stat().st_ino == before
    images = write(tmp_path, count=3)
    os.utime(tmp_path / "chair_test_images.npz", (1, 1))
    assert np.array_equal(open_split(tmp_path, "test").images["chair"], images)
    copy.write_bytes(copy.read_bytes()[:5000])
    os.utime(copy, (1, 1))
    assert np.array_equal(open_split(tmp_path, "test").images["chair"], images)
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_many_at_once(tmp_path: Path) -> None:
    images = write(tmp_path, count=6)
    with ThreadPoolExecutor(6) as pool:
        for split in pool.map(lambda _: open_split(tmp_path, "test"), range(6)):
            assert np.array_equal(split.images["chair"], images)


def test_elsewhere_if_the_folder_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = tmp_path / "data"
    data.mkdir()
    images = write(data)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(os, "access", lambda path, _: Path(path) != data)
    assert np.array_equal(open_split(data, "test").images["chair"], images)
    assert len(list(data.iterdir())) == 2 and len(list((tmp_path / "cache").rglob("*.npy"))) == 2


def test_memory_stays_small(tmp_path: Path) -> None:
    count = 100  # 39 MB of images
    with (
        zipfile.ZipFile(tmp_path / "chair_test_images.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("arr_0.npy", "w", force_zip64=True) as member,
    ):
        header = {"descr": "|u1", "fortran_order": False, "shape": (count, 24, 4, 64, 64)}
        np.lib.format.write_array_header_1_0(member, header)
        for index in range(count):
            member.write(bytes([index + 1]) * (24 * 4 * 64 * 64))
    tracemalloc.start()
    try:
        images = open_split(tmp_path, "test").images["chair"]
        assert int(images[99, 0, 0, 0, 0]) == 100 and tracemalloc.get_traced_memory()[1] < 16_000_000
    finally:
        tracemalloc.stop()


def cut(path: Path, share: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


@pytest.mark.parametrize(
    ("spoil", "name", "sentence"),
    [
        (lambda f: cut(f / "chair_test_images.npz", 0.5), "images.npz", "broken or truncated"),
        (lambda f: (f / "chair_test_images.npz").write_text("text"), "images.npz", "broken or truncated"),
        (lambda f: (f / "chair_test_images.npz").write_bytes(b""), "images.npz", "broken or truncated"),
        (lambda f: np.savez(f / "chair_test_images.npz"), "images.npz", "broken or truncated"),
        (lambda f: write(f, images=np.zeros((2, 24, 3, 64, 64), np.uint8)), "images.npz", r"\(N, 24, 4, 64, 64\), got"),
        (lambda f: write(f, images=np.zeros((2, 24, 4, 64, 64))), "images.npz", "got float64"),
        (lambda f: write(f, images=np.array({}, dtype=object)), "images.npz", "got object"),
        (lambda f: write(f, count=0), "images.npz", "at least one object, got none"),
        (lambda f: write(f, voxels=np.zeros((3, 32, 32, 32), bool)), "voxels.npz", "expected 2 objects like"),
        (lambda f: write(f, voxels=np.zeros((2, 32, 32), bool)), "voxels.npz", r"got bool \(2, 32, 32\)"),
        (lambda f: (f / "dataset.json").write_text("{"), "dataset.json", "expected JSON"),
        (lambda f: (f / "dataset.json").write_text("[]"), "dataset.json", "expected JSON"),
        (
            lambda f: (f / "dataset.json").write_text('{"names": {"test": {"chair": ["a"]}}}'),
            "json",
            "expected 2 names",
        ),
    ],
)
def test_broken_files_are_named(tmp_path: Path, spoil: Any, name: str, sentence: str) -> None:
    write(tmp_path)
    spoil(tmp_path)
    with pytest.raises(ValueError, match=rf"{name}: .*{sentence}"):
        open_split(tmp_path, "test")
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_damaged_byte_is_found(tmp_path: Path) -> None:
    write(tmp_path)
    path = tmp_path / "chair_test_images.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"images\.npz: .*broken or truncated"):
        open_split(tmp_path, "test")


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere: expected a folder .*, got nothing there"):
        open_split(tmp_path / "nowhere", "test")
    with pytest.raises(FileNotFoundError, match=r"expected files \{class\}_test_images\.npz, got none"):
        open_split(tmp_path, "test")
    write(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"lamp_test_images\.npz: .*the classes are chair"):
        open_split(tmp_path, "test", ["lamp"])
    with pytest.raises(ValueError, match="split: expected one of train, val, test, got 'all'"):
        open_split(tmp_path, "all")
    (tmp_path / "chair_test_voxels.npz").unlink()
    assert open_split(tmp_path, "test").voxels == {}


def packed(path: Path, header: bytes, numbers: int) -> None:
    """Write an npz of zeros with a given header."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        magic = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little")
        archive.writestr("arr_0.npy", magic + header + bytes(numbers))


ONE = b"{'descr': '|u1', 'fortran_order': False, 'shape': (1, 24, 4, 64, 64), }\n"


@pytest.mark.parametrize(
    ("header", "numbers", "sentence"),
    [
        (ONE, 1 << 25, "expected 393216 numbers according to its header, got 33554432"),
        (ONE, 100, "expected 393216 numbers according to its header, got 100"),
        (ONE.replace(b"(1,", b"(-1,"), 393216, "expected -393216 numbers"),
        (ONE[:-4], 393216, r"expected uint8 \(N, 24, 4, 64, 64\), got no array"),
        (b"(" * 500, 393216, r"expected uint8 \(N, 24, 4, 64, 64\), got no array"),
        (ONE.replace(b"(1,", b"(1, " + b"1, " * 500), 393216, r"got uint8 \(1, 1.*\.\.\."),
    ],
)
def test_nothing_is_unpacked_that_the_header_does_not_tell_of(
    tmp_path: Path, header: bytes, numbers: int, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path)
    packed(tmp_path / "chair_test_images.npz", header, numbers)
    monkeypatch.setattr(zipfile.ZipExtFile, "read", bounded(zipfile.ZipExtFile.read))
    with pytest.raises(ValueError, match=rf"images\.npz: .*{sentence}"):
        open_split(tmp_path, "test")


def bounded(read: Any) -> Any:
    """Wrap a function that may read headers only."""

    def checked(member: Any, count: int = -1) -> bytes:
        data = read(member, count)
        assert member.tell() < 10_000
        return data

    return checked


@pytest.mark.parametrize("array", [np.zeros((3, 5)), np.zeros((2, 24, 4, 64, 64), np.int8), np.array({}, object)])
def test_a_wrong_copy_is_made_anew(tmp_path: Path, array: np.ndarray) -> None:
    images = write(tmp_path)
    open_split(tmp_path, "test")
    copy = tmp_path / "chair_test_images.npy"
    stamp = copy.stat().st_mtime_ns
    np.save(copy, array)
    os.utime(copy, ns=(stamp, stamp))
    assert np.array_equal(open_split(tmp_path, "test").images["chair"], images)


def test_names(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "dataset.json").write_text(json.dumps({"names": {"test": {"chair": ["a", "b"]}}}))
    assert open_split(tmp_path, "test").names["chair"] == ("a", "b")


def test_a_full_disk_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path)
    before = contents(tmp_path)
    full = r"chair_test_images\.npy: expected to write it, got: "
    with full_disk(10_000), pytest.raises(OSError, match=full + "File too large"):
        open_split(tmp_path, "test")
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(OSError, match=full + "No space left on device"):
        open_split(tmp_path, "test")
    assert contents(tmp_path) == before


def test_images_without_objects(tmp_path: Path) -> None:
    write(tmp_path)
    with np.load(tmp_path / "chair_test_images.npz") as arrays:
        images = arrays["arr_0"].copy()
    images[:, :, 3] = 0
    np.savez(tmp_path / "chair_test_images.npz", images)
    with pytest.raises(ValueError, match=r"chair_test_images.npz: expected images of objects, got"):
        open_split(tmp_path, "test")
