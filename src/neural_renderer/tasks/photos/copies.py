"""Photographs of a folder, or frames of a video, as copies that structure from motion and a fit read alike.

Copies have one size, at most 1600 pixels, and stand upright if that leaves them one shape; otherwise the pixels of one
camera stay as its sensor has them, so that one lens fits all. EXIF data keep the focal length.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from ...io.atomic_write import write_file
from ...io.files import reason
from .sharpness import sharpness
from .video import VIDEOS, choose_frames, read_frames

SIDE = 1600
"""Most pixels of the longer side of a copy."""
IMAGES, MASKS = "images", "masks"
"""Folders of copies and their masks, beside ``sparse/0``."""
_LIST = "photographs.json"  # photographs that the copies are made of
_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")
_MOST_REFUSED = 0.5  # share of files that cannot be read
_SHARPNESS_SIDE = 640
_ORIENTATION, _TURNS = 0x0112, (5, 6, 7, 8)  # values of the tag that exchange height and width

Progress = Callable[[str, int, int], None]
"""Receives the name of a phase, the steps done, and all steps."""


@dataclass(frozen=True)
class Photographs:
    """Copies of photographs in a folder."""

    folder: Path  # folder that has the copies in ``images``, and the masks that are known in ``masks``
    sharpness: dict[str, float]  # sharpness of each copy by its name, comparable within a set
    refused: dict[str, str] = field(default_factory=dict)  # reason for each file, by its name, that cannot be read

    @property
    def names(self) -> list[str]:
        """Names of the copies, in order."""
        return sorted(self.sharpness)

    def remove_masks(self) -> None:
        """Remove the masks of an earlier run."""
        for file in (self.folder / MASKS).glob("*.png"):
            file.unlink()


def copy_photographs(source: Path, folder: Path, frames: int, progress: Progress) -> Photographs:
    """Copy the photographs of a folder, or some frames of a video, unless an earlier call has done so.

    What belongs to copies of other photographs is removed from the folder. ValueError: There are no photographs, or
    most of them cannot be read.
    """
    is_video = source.suffix.lower() in VIDEOS
    files = [source] if is_video else photographs_in(source)
    states = [file.stat() for file in files]
    inputs = [[file.name, state.st_size, state.st_mtime_ns] for file, state in zip(files, states, strict=True)]
    identity = {"inputs": inputs, "frames": frames if is_video else 0}
    listed = folder / _LIST
    if listed.is_file():
        known = json.loads(listed.read_text(encoding="utf-8"))
        if known.pop("identity", None) == identity:  # otherwise of others, or interrupted
            return Photographs(folder, **known)
    if any(file.parent.resolve() == (folder / IMAGES).resolve() for file in files):
        raise ValueError(f"--output: expected another folder than that of the photographs, got {folder}")
    if not listed.is_file() and any((folder / IMAGES).glob("*")):
        raise FileExistsError(f"--output: expected a folder without images of others, got {folder / IMAGES}")
    _remove_earlier(folder)
    write_file(listed, "{}\n")  # what is in the folder from here on is ours
    refused: dict[str, str] = {}
    images = _frames(source, frames, progress) if is_video else _images(files, refused, progress)
    sharpness = {name: _write(folder / IMAGES / name, image) for name, image in images}
    if len(refused) > _MOST_REFUSED * len(files):
        raise ValueError(
            f"{source}: expected photographs, got files that cannot be read: {next(iter(refused.values()))}"
        )
    content = {"identity": identity, "sharpness": sharpness, "refused": refused}
    write_file(listed, json.dumps(content, indent=1) + "\n")
    return Photographs(folder, sharpness, refused)


def photographs_in(folder: Path) -> list[Path]:
    """List the photographs of a folder, in order; FileNotFoundError if there are none."""
    places = (folder / IMAGES, folder) if (folder / IMAGES).is_dir() else (folder,)
    for place in places:
        found = sorted(file for file in place.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file())
        if found:
            return found
    raise FileNotFoundError(f"{folder}: expected photographs ({', '.join(_SUFFIXES)}), got none")


def _remove_earlier(folder: Path) -> None:
    """Remove the copies and the model of other photographs, if a list says that they are ours."""
    if not (folder / _LIST).is_file():
        return
    (folder / _LIST).unlink()
    for pattern in (f"{IMAGES}/*", "sparse/0/*", f"{MASKS}/*.png", "database.db*"):
        for file in folder.glob(pattern):
            file.unlink()


def _frames(source: Path, count: int, progress: Progress) -> Iterator[tuple[str, Image.Image]]:
    """Yield sharp frames of a video with names."""
    progress("frames", 0, 2)
    chosen, rate = choose_frames(source, count)
    progress("frames", 1, 2)
    for number, frame in read_frames(source, rate, SIDE, chosen):
        yield f"frame_{number:04}.jpg", Image.fromarray(frame)
    progress("frames", 2, 2)


def _images(files: Sequence[Path], refused: dict[str, str], progress: Progress) -> Iterator[tuple[str, Image.Image]]:
    """Yield photographs of one size with their names, and collect the reasons for those that cannot be read."""
    sizes: dict[Path, tuple[tuple[int, int], bool]] = {}  # width and height as stored, and whether EXIF turns them
    for file in files:
        try:
            with Image.open(file) as opened:
                sizes[file] = opened.size, opened.getexif().get(_ORIENTATION) in _TURNS
        except Exception as error:  # Pillow raises errors of many classes
            refused[file.name] = reason(error)
    upright = {(width > height) != turned for (width, height), turned in sizes.values()}
    side = min([SIDE, *(max(size) for size, _ in sizes.values())])
    turns = len(upright) < 2
    fitted = [_fit(size, turned and turns, side) for size, turned in sizes.values()]
    shape = max((width for width, _ in fitted), default=0), max((height for _, height in fitted), default=0)
    for done, (file, (size, turned)) in enumerate(sizes.items(), 1):
        try:
            image = _load(file, turns, _fit(size, turned and turns, side))
        except Exception as error:
            refused[file.name] = reason(error)
            continue
        name = file.name if image.mode == "RGBA" or file.suffix.lower() == ".png" else f"{file.stem}.jpg"
        yield name, _padded(image, shape)
        progress("photographs", done, len(files))


def _load(file: Path, turns: bool, size: tuple[int, int]) -> Image.Image:
    """Load a photograph at a size, turned by its EXIF data if asked for, which it keeps."""
    with Image.open(file) as opened:
        opened.draft("RGB", size)
        exif = opened.getexif()
        upright = ImageOps.exif_transpose(opened) if turns else Image.Image.copy(opened)
        mode = "RGBA" if upright.has_transparency_data else "RGB"
        image = upright.convert(mode).resize(size, Image.Resampling.LANCZOS)
    exif[_ORIENTATION] = 1
    image.info = {"exif": exif.tobytes()}
    return image


def _fit(size: tuple[int, int], turned: bool, side: int) -> tuple[int, int]:
    """Scale a width and height to a longer side, exchanged for a turned picture."""
    width, height = (round(value * side / max(size)) for value in size)
    return (height, width) if turned else (width, height)


def _padded(image: Image.Image, size: tuple[int, ...]) -> Image.Image:
    """Continue the right and lower border of a picture up to a size."""
    across, down = size[0] - image.width, size[1] - image.height
    if not across and not down:
        return image
    padded = Image.fromarray(np.pad(np.asarray(image), ((0, down), (0, across), (0, 0)), mode="edge"))
    padded.info = image.info
    return padded


def _write(path: Path, image: Image.Image) -> float:
    """Write a copy and return its sharpness."""
    form: dict[str, Any] = {"format": "PNG"} if path.suffix.lower() == ".png" else {"format": "JPEG", "quality": 95}
    file = io.BytesIO()
    image.save(file, exif=image.info.get("exif", b""), **form)
    write_file(path, file.getbuffer())
    return sharpness(np.asarray(image.convert("L").reduce(max(1, max(image.size) // _SHARPNESS_SIDE))))
