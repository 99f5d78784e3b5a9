"""Cameras and masks of photographs that have none, for `neural-renderer fit`."""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from ....camera.files import CameraFile, find_camera_file, read_camera_file
from ....io import load_image, save_image
from ....io.files import import_library
from ....io.images import size_of
from ...common.checks import check_folder
from ...common.command import progress_bars, say
from ...common.masks.rule import mask_beside
from ...common.views.load import MASK_FOLDERS
from .. import MaskRule
from ..options import FitOptions
from ..photos import copy_photographs, find_cameras, find_masks, write_known_masks
from ..photos.copies import IMAGES, MASKS, photographs_in
from ..photos.found import FOUND, found_masks, record_found
from ..photos.mask_sheet import mask_sheet
from ..photos.missing import BLURRED, SHARP, displaced
from ..photos.video import VIDEOS, videos_in

_NAMED = 12  # most photographs named in a message
_SHEET = "masks.jpg"
_DRAFT = "draft"  # folder beside the masks for those of no closed object, so that a fit does not read them as masks
_LEAST_OBJECT = 0.001  # share of a picture, below which a mask that was found shows no object
_NOTHING = "no object stands out: there is nothing to cut out, or it shines, or has the colours around it"
_FEW_POINTS = 100  # points of all photographs, below which cameras may be wrong though they agree


@dataclass(frozen=True)
class Posed:
    """Photographs with cameras that were found."""

    cameras: CameraFile
    missing: dict[str, str]  # reason for each photograph, by its name, that has no camera or mask
    is_exact: bool  # the cameras are too good to be refined with the shape
    is_open: bool  # there is no object with an outline, but a surface
    found: set[str]  # names of the photographs whose mask was found, and not corrected
    facts: dict[str, Any]  # for the report: numbers of photographs and points, and the origins of features and masks


def lacks_cameras(options: FitOptions) -> bool:
    """Tell whether the cameras of the images have to be found first."""
    if options.cameras is not None:
        return options.cameras == "sfm"
    if options.images.is_dir():
        try:
            find_camera_file(options.images)
        except FileNotFoundError:
            return True
    return options.images.suffix.lower() in VIDEOS and options.images.is_file()


def photographs_beside(images: Path, cameras: CameraFile) -> list[str]:
    """List the names of photographs in a folder of images that have no camera."""
    try:
        files = photographs_in(images) if images.is_dir() else []
    except FileNotFoundError:
        return []
    known = {Path(entry.name).stem for entry in cameras.images}
    return [file.name for file in files if file.stem not in known]


def pose_photographs(options: FitOptions, rule: MaskRule) -> Posed:
    """Find cameras and masks of photographs.

    The folder of the results receives ``images``, ``masks``, ``sparse/0``, and a picture of the masks.
    """
    folder, start = options.output, time.monotonic()
    import_library("pycolmap", "to find the cameras of photographs")  # before time is spent
    signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))  # pycolmap would answer it with a stack trace
    check_folder("--output", folder)
    if not options.images.exists():
        raise FileNotFoundError(f"{options.images}: expected a folder of photographs or a video, got nothing there")
    origins: dict[str, int] = {}
    videos = videos_in(options.images) if options.images.is_dir() else []
    with progress_bars() as report:
        photographs = copy_photographs(options.images, folder, options.frames, report)
        if videos:
            more = f" (nor {len(videos) - 1} more)" if videos[1:] else ""
            say(f"{videos[0].name} is not used{more}: a video is used alone, by its path", "yellow")
        beside = [options.images / name for name in MASK_FOLDERS]
        blurred = median(photographs.sharpness.values()) < BLURRED * SHARP
        if options.masks and not any(photographs.find_mask(options.masks, name) for name in photographs.names):
            raise FileNotFoundError(f"--masks: expected masks named like the photographs, got none in {options.masks}")
        if options.force and options.masks is None:
            for file in (folder / MASKS).glob("*.png"):
                file.unlink()
        if not options.surface:
            own = folder / MASKS
            if rule != MaskRule() and any(mask_beside(own, name) for name in photographs.names):
                say(f"the masks in {own} stay, whatever the options for masks; --force makes them anew", "yellow")
            given = [options.masks, own] if options.masks else [own, *beside]
            origins = write_known_masks(photographs, given, rule, report)
        motion = find_cameras(photographs, report)
    say(f"{len(motion.placed)} of {len(photographs.names)} photographs placed; {motion.points:,} points")
    features = "the whole photographs" if motion.is_whole or not origins else "the object alone"
    if origins:
        around = "moves with it" if motion.is_whole else "does not move with it, or shows nothing"
        say(f"features are those of {features}: what is around the object {around} in the pictures")
    facts: dict[str, Any] = {"photographs": len(photographs.names), "placed": len(motion.placed)}
    facts |= {"points": motion.points, "features": features}

    def posed(cameras: CameraFile) -> Posed:
        _name(missing)
        facts.update(masks=origins, surface=is_open, seconds=round(time.monotonic() - start, 1))
        return Posed(cameras, missing, motion.is_exact, is_open, found_masks(folder / MASKS), facts)

    if motion.points < _FEW_POINTS:
        say("so few points make the cameras doubtful: take more photographs, or show more texture", "yellow")
    if blurred:
        say("the photographs are blurred, and details will be missing: hold still, or use more light", "yellow")
    cameras = replace(read_camera_file(motion.model / "images.bin"), folders=(folder / IMAGES, folder))
    _name_displaced(cameras, folder / IMAGES)
    missing, is_open = dict(motion.missing), options.surface
    bare = [name for name in motion.placed if mask_beside(folder / MASKS, name) is None]
    if not is_open and bare:
        with progress_bars() as report:
            reason, has_second = find_masks(cameras, folder, report)
        if _remove_empty(folder / MASKS, bare) > len(bare) / 2:
            reason = reason or _NOTHING
        is_open = reason is not None and len(bare) == len(motion.placed)
        if reason is not None:
            _set_aside(options, bare, reason, is_open)
        if has_second and not is_open:
            say("two objects stand there, of which the masks show the larger one: take the other away", "yellow")
    if is_open:
        return posed(cameras)
    unmasked = [name for name in motion.placed if mask_beside(folder / MASKS, name) is None]
    missing |= dict.fromkeys(unmasked, "the object does not stand out from its background; give it a mask")
    images = [entry for entry in cameras.images if entry.name not in unmasked]
    files = [folder / IMAGES / entry.name for entry in images]
    save_image(folder / _SHEET, mask_sheet(files, folder / MASKS))
    if found := len(bare) - len(unmasked):
        origins[FOUND] = origins.get(FOUND, 0) + found
        record_found(folder / MASKS, found_masks(folder / MASKS) | {name for name in bare if name not in unmasked})
    say(f"masks: {', '.join(f'{count} from {origin}' for origin, count in origins.items())}")
    say(f"the masks are in {folder / MASKS}, {folder / _SHEET} shows them; --masks reads them again when corrected")
    return posed(replace(cameras, images=images))


def _remove_empty(masks: Path, names: Sequence[str]) -> int:
    """Remove masks that show nearly nothing; return how many."""
    files = [file for name in names if (file := masks / f"{name}.png").is_file()]
    empty = [file for file in files if float(load_image(file).mean()) < _LEAST_OBJECT]
    for file in empty:
        file.unlink()
    return len(empty)


def _set_aside(options: FitOptions, names: list[str], why: str, is_open: bool) -> None:
    """Keep the masks found of no closed object as a draft; say what follows if the photographs have no other masks."""
    masks = options.output / MASKS
    draft, found = masks / _DRAFT, [file for name in names if (file := masks / f"{name}.png").is_file()]
    if is_open and found:
        save_image(options.output / _SHEET, mask_sheet([options.output / IMAGES / name for name in names], masks))
    for file in found:
        draft.mkdir(exist_ok=True)
        file.replace(draft / file.name)
    if not is_open:
        return
    advice = (
        "For an object, take photographs from all around it, with this one object whole in the middle of each, or "
        + (f"correct the masks found ({options.output / _SHEET}) and give --masks {draft}" if found else "give --masks")
    )
    if not options.masks_only:
        say(f"{why}: all that is seen becomes an open surface (--surface). {advice}", "yellow")
    elif found:
        say(f"{why}. {advice}", "yellow")
    else:
        raise ValueError(f"{options.images}: expected an object with an outline, got none: {why}. {advice}")


def _name_displaced(cameras: CameraFile, images: Path) -> None:
    files = [images / entry.name for entry in cameras.images]
    if wrong := displaced(cameras.cameras(size_of(files[0])), files):
        more = f" and {len(wrong) - _NAMED} more" if len(wrong) > _NAMED else ""
        say(
            f"{', '.join(wrong[:_NAMED])}{more} got the places of others, though they show something else: a pattern "
            "that repeats itself around the object, such as wallpaper, misleads. Hang a cloth there, or give masks",
            "yellow",
        )


def _name(missing: dict[str, str]) -> None:
    for name, why in list(missing.items())[:_NAMED]:
        say(f"{name} is left out: {why}", "yellow")
    if len(missing) > _NAMED:
        say(f"… and {len(missing) - _NAMED} more; report.json names them", "yellow")
