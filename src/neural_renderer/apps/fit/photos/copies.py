"""Photographs of a folder, or frames of a video, as copies that structure from motion and a fit read alike.

Copies have one size, at most 1600 pixels, and stand upright if that leaves them one shape; otherwise the pixels of one
camera stay as its sensor has them, so that one lens fits all. EXIF data keep the focal length.
"""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ExifTags, Image, ImageFilter, ImageOps
from PIL.TiffImagePlugin import IFDRational

from ....camera.files.colmap import MODEL_FOLDERS
from ....io.atomic_write import write_file
from ....io.files import existing, import_library, reason
from ....io.image_formats.pictures import open_picture
from ...common.checks import check_inside
from ...common.masks.rule import PICTURE_SUFFIXES, mask_beside
from ...common.options import LEAST_SIDE
from ...common.views.load import MASK_FOLDERS
from .video import VIDEOS, choose_frames, sharpness, videos_in

SIDE = 1600
"""Most pixels of the longer side of a copy."""
IMAGES, MASKS, MODEL = "images", "masks", "sparse/0"
"""Folders of copies, of their masks, and of the model of their cameras, in one folder."""
_EARLIER = "earlier"  # folder in that of the masks, for masks of photographs that are gone or have changed
_LIST = "photographs.json"  # photographs that the copies are made of
_MOST_REFUSED = 0.5  # share of files that cannot be read
HEIF_SUFFIXES = (".heic", ".heif")
"""Suffixes of photographs by phones that need a library."""
RAW_SUFFIXES = (".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".raf", ".rw2")
"""Suffixes of raw files, which another library develops."""
_NAMED = 4  # folders named in a message
_SMALL = 0.5  # longer side relative to the usual one; smaller pictures would make the copies of all others small
_SHARPNESS_SIDE = 640
_QUALITY = 95  # of copies as JPEG
_SAME_SHAPE = 0.01  # relative difference of two ratios of width to height by rounding
_ORIENTATION, _TURNS = 0x0112, (5, 6, 7, 8)  # values of the tag that exchange height and width

_Copies = Iterator[tuple[str, Path, Image.Image, int]]  # name, the file it is made of, picture, see `turns_of`
Progress = Callable[[str, int, int], None]
"""Receives the name of a phase, the steps done, and all steps."""


@dataclass(frozen=True)
class Photographs:
    """Copies of photographs in a folder."""

    folder: Path  # folder that has the copies in ``images``, and the masks that are known in ``masks``
    sharpness: dict[str, float]  # sharpness of each copy by its name, comparable within a set
    refused: dict[str, str] = field(default_factory=dict)  # reason for each file, by its name, that cannot be used
    sources: dict[str, str] = field(default_factory=dict)  # name of the photograph or video of each copy, by its name

    @property
    def names(self) -> list[str]:
        """Names of the copies, in order."""
        return sorted(self.sharpness)

    def find_mask(self, folder: Path, name: str) -> Path | None:
        """Find the mask of a copy in a folder, named like its photograph or like the copy."""
        source = self.sources.get(name, name)
        # x.jpg and x.png are two photographs here, so that x.png is no mask of x.jpg where both have one.
        exact = folder / source
        return exact if exact.is_file() else mask_beside(folder, name) or mask_beside(folder, source)


def copy_photographs(source: Path, output: Path, frames: int, progress: Progress) -> Photographs:
    """Copy the photographs of a folder, or some frames of a video, to ``output``, unless an earlier call has done so.

    What belongs to copies of other photographs is removed, except masks: those of photographs that are the same stay,
    others move to ``masks/earlier``. ValueError: There are no photographs, or most of them cannot be read.
    """
    check_inside(output, IMAGES, MODEL, MASKS)
    is_video = source.suffix.lower() in VIDEOS
    written = {path.resolve() for path in (output, output / IMAGES, output / MODEL)}
    if written & {(source / name).resolve() for name in (".", IMAGES, *MODEL_FOLDERS)}:  # searched by the next call
        raise ValueError(f"output: expected a folder apart from the photographs, got {output}")
    files = [source] if is_video else photographs_in(source)
    states = [file.stat() for file in files]
    inputs = [[file.name, state.st_size, state.st_mtime_ns] for file, state in zip(files, states, strict=True)]
    identity = {"inputs": inputs, "frames": frames if is_video else 0}
    listed = output / _LIST
    earlier: dict[str, Any] = {}
    if is_ours := listed.is_file():
        known = json.loads(listed.read_text(encoding="utf-8"))
        earlier = known.get(_EARLIER, known)  # the former of an interrupted call
        if known.get("identity") == identity:
            return Photographs(output, known["sharpness"], known["refused"], known.get("sources", {}))
    if not is_ours and any((output / IMAGES).glob("*")):
        raise FileExistsError(f"output: expected a folder without images of others, got {output / IMAGES}")
    write_file(listed, json.dumps({_EARLIER: earlier}) + "\n")  # what is in the folder from here on is ours
    if is_ours:
        for pattern in (f"{IMAGES}/*", f"{MODEL}/*", "database.db*"):
            for file in output.glob(pattern):
                file.unlink()
    refused: dict[str, str] = {}
    sharpness, sources, turns = {}, {}, {}
    images = _frames(source, frames, progress) if is_video else _images(files, refused, progress)
    for name, file, image, turn in images:
        sharpness[name], sources[name] = write_copy(output / IMAGES / name, image), file.name
        if turn:
            turns[name] = turn
    if len(refused) > _MOST_REFUSED * len(files):
        raise ValueError(
            f"{source}: expected photographs, got files that cannot be used: {next(iter(refused.values()))}"
        )
    content = {"identity": identity, "sharpness": sharpness, "refused": refused, "sources": sources, "turns": turns}
    if "sources" in earlier:
        _set_masks_aside(output / MASKS, earlier, content)
    write_file(listed, json.dumps(content, indent=1) + "\n")
    return Photographs(output, sharpness, refused, sources)


def turns_of(folder: Path) -> dict[str, int]:
    """Read which copies in a folder of `copy_photographs` lie on their sides: values of the EXIF tag, by name."""
    listed = folder / _LIST
    if not listed.is_file():
        return {}
    turns: dict[str, int] = json.loads(listed.read_text(encoding="utf-8")).get("turns", {})
    return turns


def photographs_in(folder: Path) -> list[Path]:
    """List the photographs of a folder, or of the only one in it that has some, in order.

    FileNotFoundError, which says what is there: There are none, or several folders have some.
    """
    inside = _inside(folder)
    places = (folder / IMAGES, folder, *(inside if len(inside) == 1 else ()))
    for place in filter(Path.is_dir, places):
        if found := _photographs(place):
            return found
    suffixes = ", ".join((*PICTURE_SUFFIXES, *HEIF_SUFFIXES))
    raise FileNotFoundError(f"{folder}: expected photographs ({suffixes}), got {_what_is_there(folder)}")


def _photographs(folder: Path) -> list[Path]:
    files = sorted(file for file in folder.iterdir() if file.is_file() and not file.name.startswith("."))
    found = [file for file in files if file.suffix.lower() in (*PICTURE_SUFFIXES, *HEIF_SUFFIXES)]
    # A camera may write a picture beside each raw file.
    return found or [file for file in files if file.suffix.lower() in RAW_SUFFIXES and find_spec("rawpy") is not None]


def _inside(folder: Path) -> list[Path]:
    """List the folders in a folder, and in these, that have photographs, and not masks."""
    places = sorted(place for place in (*folder.glob("*"), *folder.glob("*/*")) if place.is_dir())
    return [place for place in places if place.name not in MASK_FOLDERS and _photographs(place)]


def _what_is_there(folder: Path) -> str:
    """Describe the content of a folder without photographs, with advice."""
    if videos := videos_in(folder):
        return f"a video; give its path, {videos[0]}"
    raws = sorted(file for file in folder.iterdir() if file.suffix.lower() in RAW_SUFFIXES)
    if raws:
        remedy = "pip install rawpy, or develop them to .jpg or .tif with equal settings"
        return f"{len(raws)} raw files ({raws[0].suffix}); {remedy}"
    named = [f"{len(_photographs(place))} in {place.relative_to(folder)}" for place in _inside(folder)]
    return f"none here, but {', '.join(named[:_NAMED])}; give one of these folders" if named else "none"


def _open(file: Path) -> Image.Image:
    """Open a photograph; ModuleNotFoundError if its format needs a library that is missing."""
    if file.suffix.lower() in HEIF_SUFFIXES:
        import_library("pillow_heif", f"to read {file.suffix} files").register_heif_opener()
        return open_picture(file, "HEIF")
    if file.suffix.lower() in RAW_SUFFIXES:
        return _develop(file)
    return open_picture(file)


def _develop(file: Path) -> Image.Image:
    """Develop a raw file upright, with the white balance of the camera and the same brightness as others."""
    library = import_library("rawpy", f"to read {file.suffix} files")
    try:
        with library.imread(str(existing(file))) as raw:
            image = Image.fromarray(raw.postprocess(use_camera_wb=True, no_auto_bright=True))
    except Exception as error:  # LibRaw's reasons are bytes
        raise ValueError("expected a raw file, got one that cannot be read") from error
    image.info["exif"] = _lens(file).tobytes()
    return image


def _lens(file: Path) -> Image.Exif:
    """Read the camera and the focal length of a raw file, if it begins as TIFF does, like most of them."""
    lens = Image.Exif()
    with suppress(Exception), open_picture(file) as preview:  # Pillow raises errors of many classes
        exif = preview.getexif()
        inner = exif.get_ifd(ExifTags.IFD.Exif)
        lens.update({tag: exif[tag] for tag in (ExifTags.Base.Make, ExifTags.Base.Model) if tag in exif})
        focal = (ExifTags.Base.FocalLength, ExifTags.Base.FocalLengthIn35mmFilm)
        lens.get_ifd(ExifTags.IFD.Exif).update({tag: inner[tag] for tag in focal if tag in inner})
    return lens


def _set_masks_aside(masks: Path, earlier: dict[str, Any], content: dict[str, Any]) -> None:
    """Move masks away whose photograph, recognised by name and bytes, is not in a new list."""

    def photographs(listed: dict[str, Any]) -> set[tuple[Any, ...]]:
        sizes, frames = {name: size for name, size, _ in listed["identity"]["inputs"]}, listed["identity"]["frames"]
        return {(copy, source, sizes[source], frames) for copy, source in listed["sources"].items()}

    stay = {mask_beside(masks, name) for name, *_ in photographs(earlier) & photographs(content)}
    for file in set(masks.glob("*.png")) - stay:
        (masks / _EARLIER).mkdir(exist_ok=True)
        file.replace(masks / _EARLIER / file.name)


def _named(suffixes: dict[Path, str]) -> dict[Path, str]:
    """Name the copies of files: unique even without case, and without the characters at which COLMAP cuts names."""
    wanted = {file: re.sub(r"[\s#]", "_", file.stem) for file in suffixes}
    names, taken = {}, {""}
    for file in sorted(wanted, key=lambda file: wanted[file] + suffixes[file] != file.name):
        tried = (wanted[file] + (f"_{number}" if number > 1 else "") + suffixes[file] for number in count(1))
        names[file] = next(name for name in tried if name.casefold() not in taken)
        taken.add(names[file].casefold())
    return names


def _frames(source: Path, frames: int, progress: Progress) -> _Copies:
    """Yield sharp frames of a video with names, and the video."""
    progress("frames", 0, 2)
    for number, _, frame in choose_frames(source, frames, SIDE):
        progress("frames", 1, 2)
        yield f"frame_{number:04}.jpg", source, Image.fromarray(frame), 0
    progress("frames", 2, 2)


def _images(files: Sequence[Path], refused: dict[str, str], progress: Progress) -> _Copies:
    """Yield photographs of one size with names and files; collect the reasons for those that cannot be used."""
    suffixes: dict[Path, str] = {}
    sizes: dict[Path, tuple[tuple[int, int], int]] = {}  # width and height as stored, and the tag that turns them, or 0
    for file in files:
        try:
            with _open(file) as opened:
                if min(opened.size) < LEAST_SIDE:
                    raise ValueError(f"expected at least {LEAST_SIDE} pixels a side, got {min(opened.size)}")
                tag = opened.getexif().get(_ORIENTATION)
                sizes[file] = opened.size, tag if tag in _TURNS else 0
                suffixes[file] = ".png" if opened.has_transparency_data or opened.format == "PNG" else ".jpg"
        except ModuleNotFoundError:
            raise
        except Exception as error:  # Pillow raises errors of many classes
            refused[file.name] = reason(error)
    if sizes:
        usual = sorted((size for size, _ in sizes.values()), key=max)[len(sizes) // 2]
        for file in [file for file, (size, _) in sizes.items() if max(size) < _SMALL * min(SIDE, max(usual))]:
            (width, height), _ = sizes.pop(file)
            refused[file.name] = f"{width} × {height} pixels, where others have {usual[0]} × {usual[1]}"
            del suffixes[file]
    names = _named(suffixes)
    upright = {(width > height) != bool(turn) for (width, height), turn in sizes.values()}
    side = min([SIDE, *(max(size) for size, _ in sizes.values())])
    rotates = len(upright) < 2
    fitted = [_fit(size, rotates and bool(turn), side) for size, turn in sizes.values()]
    shape = max((width for width, _ in fitted), default=0), max((height for _, height in fitted), default=0)
    for done, (file, (size, turn)) in enumerate(sizes.items(), 1):
        try:
            image = _load(file, rotates, _fit(size, rotates and bool(turn), side))
        except Exception as error:
            refused[file.name] = reason(error)
            continue
        yield names[file], file, _padded(image, shape), 0 if rotates else turn
        progress("photographs", done, len(sizes))


def _load(file: Path, rotates: bool, size: tuple[int, int]) -> Image.Image:
    """Load a photograph at a size, optionally rotated by its EXIF data, which are kept."""
    with _open(file) as opened:
        stored = opened.size
        opened.draft("RGB", size)
        exif = opened.getexif()
        upright = ImageOps.exif_transpose(opened) if rotates else Image.Image.copy(opened)
        mode = "RGBA" if upright.has_transparency_data else "RGB"
        image = upright.convert(mode).resize(size, Image.Resampling.LANCZOS)
    exif[_ORIENTATION] = 1
    _scale_sensor(exif.get_ifd(ExifTags.IFD.Exif), stored, max(size))
    image.info = {"exif": exif.tobytes()}
    return image


def _scale_sensor(sensor: dict[int, Any], stored: tuple[int, int], side: int) -> None:
    """Scale the pixels per length of a sensor, from which COLMAP computes a focal length, to a longer side of a copy.

    They are those of the whole photograph, which was reduced before if EXIF data have more pixels in the same shape.
    """
    sizes = (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)
    taken, now = sorted(int(sensor.get(tag, 0)) for tag in sizes), sorted(stored)
    is_reduced = abs(taken[0] * now[1] - taken[1] * now[0]) < _SAME_SHAPE * taken[1] * now[0]
    for tag in (ExifTags.Base.FocalPlaneXResolution, ExifTags.Base.FocalPlaneYResolution):
        if tag in sensor:  # as a fraction, because COLMAP does not read floats
            sensor[tag] = IFDRational(float(sensor[tag]) * side / (taken if is_reduced else now)[1])


def _fit(size: tuple[int, int], turned: bool, side: int) -> tuple[int, int]:
    """Scale a width and height to a longer side; exchange them for a rotated picture."""
    width, height = (round(value * side / max(size)) for value in size)
    return (height, width) if turned else (width, height)


def _padded(image: Image.Image, size: tuple[int, ...]) -> Image.Image:
    """Continue the borders of a picture up to a size; its middle stays in the middle, where the lens has its centre."""
    across, down = size[0] - image.width, size[1] - image.height
    if not across and not down:
        return image
    sides = (down // 2, down - down // 2), (across // 2, across - across // 2), (0, 0)
    padded = Image.fromarray(np.pad(np.asarray(image), sides, mode="edge"))
    padded.info = image.info
    return padded


def write_copy(path: Path, image: Image.Image) -> float:
    """Write a copy and return its sharpness."""
    form: dict[str, Any] = {"format": "PNG"} if path.suffix == ".png" else {"format": "JPEG", "quality": _QUALITY}
    file = io.BytesIO()
    image.save(file, exif=image.info.get("exif", b""), **form)
    write_file(path, file.getbuffer())
    return sharpness(np.asarray(image.convert("L").reduce(max(1, max(image.size) // _SHARPNESS_SIDE))))


def smooth(photographs: Photographs, folder: Path, deviation: float, side: int) -> Photographs:
    """Write copies smoothed against noise, in which more features match, and their masks to another folder.

    The standard deviation of the Gaussian is in pixels of copies that are reduced to a longer side.
    """
    for name in photographs.names:
        with open_picture(photographs.folder / IMAGES / name) as image:
            radius = deviation * max(1.0, max(image.size) / side)
            write_copy(folder / IMAGES / name, image.filter(ImageFilter.GaussianBlur(radius)))
    if (photographs.folder / MASKS).is_dir():
        shutil.copytree(photographs.folder / MASKS, folder / MASKS)
    return replace(photographs, folder=folder)
