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
from ...common.checks import check_folder, check_inside
from ...common.command import progress_bars, say
from ...common.masks.rule import mask_beside
from ...common.views.load import MASK_FOLDERS, find_files, find_image, load_photo
from .. import MaskRule
from ..doubts import SECOND
from ..options import FitOptions
from ..photos import copy_photographs, find_cameras, find_masks, write_known_masks
from ..photos.copies import IMAGES, MASKS, photographs_in, turns_of
from ..photos.found import FOUND, found_masks, record_found
from ..photos.geometry.solid import Target
from ..photos.masks.mask_sheet import mask_sheet
from ..photos.masks.object_masks import FoundMasks
from ..photos.missing import BLURRED, SHARP, displaced
from ..photos.video import VIDEOS, videos_in
from ..verdict import doubt_cameras

_NAMED = 12  # most photographs named in a message
_SHEET = "masks.jpg"
_DRAFT = "draft"  # folder next to that of masks, for masks of no closed object, which a fit must not read
_LEAST_LEFT = 8  # images that are enough where others are missing
_TRIED = 3  # images that are looked at for a mask
_LEAST_OBJECT = 0.001  # share of a picture, below which a mask that was found shows no object
_NOTHING = "no object stands out: there is nothing to cut out, or it shines, or has the colours around it"
NO_OBJECT = "no_object"
"""Key of the facts: why an open surface was chosen, where the user did not request one."""
EVIDENCE = "agreeing", "apart", "points", "smoothed"
"""Keys of the facts about cameras that were found: the arguments of `doubt_cameras`."""
ELSEWHERE = "elsewhere"
"""Key of the facts: share of the photographs that are left out, as they show the object elsewhere."""


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
    """Test whether the cameras of the images have to be found first."""
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
        if options.images.is_dir() and (place := photographs_in(options.images)[0].parent) != options.images:
            say(f"the photographs are those in {place}")
        if videos:
            more = f" (nor {len(videos) - 1} more)" if videos[1:] else ""
            say(
                f"{videos[0].name} is not used{more}: a video is given by its path, without other photographs", "yellow"
            )
        mask_folders = [options.images / name for name in MASK_FOLDERS]
        blurred = median(photographs.sharpness.values()) < BLURRED * SHARP
        if options.masks and not any(photographs.find_mask(options.masks, name) for name in photographs.names):
            raise FileNotFoundError(f"--masks: expected masks named like the photographs, got none in {options.masks}")
        if options.force and options.masks is None:
            for file in (folder / MASKS).glob("*.png"):
                file.unlink()
        if not options.surface:
            earlier = folder / MASKS
            if rule != MaskRule() and any(mask_beside(earlier, name) for name in photographs.names):
                say(f"the masks in {earlier} stay, whatever the options for masks; --force makes them anew", "yellow")
            given = [options.masks, earlier] if options.masks else [earlier, *mask_folders]
            origins = write_known_masks(photographs, given, rule, report)
        motion = find_cameras(photographs, report)
    say(f"{len(motion.placed)} of {len(photographs.names)} photographs placed; {motion.points:,} points")
    features = "the whole photographs" if motion.is_whole or not origins else "the object alone"
    if origins:
        around = "moves with it" if motion.is_whole else "does not move with it, or shows nothing"
        say(f"features are those of {features}: what is around the object {around} in the pictures")
    facts: dict[str, Any] = {"photographs": len(photographs.names), "placed": len(motion.placed)}
    facts |= {"points": motion.points, "features": features}
    facts |= {"agreeing": round(motion.agreement.share, 3), "apart": motion.apart, "smoothed": motion.is_smoothed}

    def posed(cameras: CameraFile) -> Posed:
        _name(missing)
        facts.update(masks=origins, surface=is_open, seconds=round(time.monotonic() - start, 1))
        return Posed(cameras, missing, motion.is_exact, is_open, found_masks(folder / MASKS), facts)

    for doubt in doubt_cameras(*(facts[key] for key in EVIDENCE)):
        say(f"{doubt.text}; {doubt.remedy}", "yellow")
    if blurred:
        say("the photographs are blurred, and details will be missing: hold still, or use more light", "yellow")
    cameras = replace(read_camera_file(motion.model / "images.bin"), folders=(folder / IMAGES, folder))
    _name_displaced(cameras, folder / IMAGES)
    missing, is_open, seen = dict[str, str](motion.missing), options.surface, None
    bare = [name for name in motion.placed if mask_beside(folder / MASKS, name) is None]
    if not is_open and bare:
        target = target_of(options.object, [entry.name for entry in cameras.images], size_of_copy(cameras, folder))
        with progress_bars() as report:
            seen = find_masks(cameras, folder, report, target)
        reason = seen.reason
        facts[ELSEWHERE] = round(len(seen.moved) / len(motion.placed), 3)
        _say_found(seen, options)
        if _remove_empty(folder / MASKS, bare) > len(bare) / 2:
            reason = reason or _NOTHING
        is_open = reason is not None and len(bare) == len(motion.placed)
        facts |= {NO_OBJECT: reason} if is_open else {}
        if reason is not None:
            _set_aside(options, [folder / IMAGES / name for name in bare], reason, is_open)
    if is_open:
        return posed(cameras)
    unmasked = [name for name in motion.placed if mask_beside(folder / MASKS, name) is None]
    missing |= _why_unmasked(unmasked, seen)
    images = [entry for entry in cameras.images if entry.name not in unmasked]
    files = [folder / IMAGES / entry.name for entry in images]
    save_image(folder / _SHEET, mask_sheet(files, folder / MASKS, turns_of(folder)))
    if found := len(bare) - len(unmasked):
        origins[FOUND] = origins.get(FOUND, 0) + found
        record_found(folder / MASKS, found_masks(folder / MASKS) | {name for name in bare if name not in unmasked})
    say(f"masks: {', '.join(f'{count} from {origin}' for origin, count in origins.items())}")
    say(f"the masks are in {folder / MASKS}, {folder / _SHEET} shows them; --masks reads them again when corrected")
    return posed(replace(cameras, images=images))


def size_of_copy(cameras: CameraFile, folder: Path) -> tuple[int, int]:
    """Read the height and width of the copies of photographs."""
    return size_of(folder / IMAGES / cameras.images[0].name)


def target_of(given: tuple[str, ...], names: Sequence[str], size: tuple[int, int]) -> Target | None:
    """Read where the object is: X Y, or corners X Y X Y, in the first photograph, or PHOTOGRAPH:X,Y in another one.

    Numbers are pixels, or shares of width and height if all are below 1. Returns the number of the photograph, and the
    region in it, an empty one for X Y.
    """
    if not given:
        return None
    text = ",".join(given)
    name, _, place = text.rpartition(":")
    rows = [row for row, other in enumerate(names) if name in ("", other, Path(other).name, Path(other).stem)]
    if not rows:
        raise ValueError(f"--object: expected a photograph with a camera, such as {names[0]}, got {name}")
    try:
        values = [float(value) for value in place.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 4):
        raise ValueError(f"--object: expected X Y, X Y X Y or PHOTOGRAPH:X,Y, got {' '.join(given)}")
    width, height = (1, 1) if max(values) < 1 else (size[1], size[0])
    across, down = sorted(values[::2]), sorted(values[1::2])
    if not (0 <= across[0] <= across[-1] < width and 0 <= down[0] <= down[-1] < height):
        got = " ".join(f"{value:g}" for value in values)
        raise ValueError(f"--object: expected a place in the {size[1]} x {size[0]} pixels of the copy, got {got}")
    return rows[0], (across[0] / width, down[0] / height, across[-1] / width, down[-1] / height)


def _say_found(seen: FoundMasks, options: FitOptions) -> None:
    """Say how masks were found, if that makes them doubtful."""
    if seen.reason is not None:
        return
    if not seen.is_known:
        say("only colours separate the object: there is too little texture for depth", "yellow")
    if seen.second > SECOND and not options.object:
        say("another object stands there: --object X Y points at the one that is meant", "yellow")


def without_missing(options: FitOptions, cameras: CameraFile) -> CameraFile:
    """Leave out images that a camera file names and that are not there, if enough of the others are."""
    gone = []
    for entry in cameras.images:
        try:
            find_image(cameras, entry.name, options.allow_outside)
        except FileNotFoundError:
            gone.append(entry.name)
        except ValueError:  # a name that leads out of the folder is said later
            continue
    left = len(cameras.images) - len(gone)
    if not gone or left < _LEAST_LEFT:
        return cameras
    say(f"{cameras.path.name} names {len(gone)} images that are not there ({gone[0]}, …): {left} are left", "yellow")
    return replace(cameras, images=[entry for entry in cameras.images if entry.name not in gone])


def lacks_masks(options: FitOptions, cameras: CameraFile, rule: MaskRule) -> bool:
    """Test whether nothing separates the object in images with cameras: no mask, transparency or plain background."""
    is_given = options.masks or options.box or options.mesh or options.surface or not options.photos
    names = {Path(entry.name).name for entry in cameras.images}  # those of masks
    if is_given or options.recover != "shape" or rule != MaskRule() or len(names) < len(cameras.images):
        return False
    for entry in cameras.images[:: max(1, len(cameras.images) // _TRIED)][:_TRIED]:
        try:
            file, mask = find_files(cameras, entry, None, options.allow_outside)
            if mask is not None:
                return False
            load_photo(file)
        except ValueError:
            continue
        except OSError:
            return False
        return False
    return True


def mask_photographs(options: FitOptions, cameras: CameraFile) -> Posed:
    """Find the masks of images with cameras; the folder of the results receives ``masks`` and a picture of them."""
    folder, start = options.output, time.monotonic()
    check_folder("--output", folder)
    check_inside(folder, MASKS)
    files = [find_files(cameras, entry, None, options.allow_outside)[0] for entry in cameras.images]
    names = [entry.name for entry in cameras.images]
    if options.force:
        for file in (folder / MASKS).glob("*.png"):
            file.unlink()
    plain = [Path(name).name for name in names]
    bare = [name for name in plain if mask_beside(folder / MASKS, name) is None]
    target = target_of(options.object, names, size_of(files[0]))
    with progress_bars() as report:
        seen = find_masks(cameras, folder, report, target, files)
    _say_found(seen, options)
    reason = seen.reason
    if _remove_empty(folder / MASKS, bare) > len(plain) / 2:
        reason = reason or _NOTHING
    points = seen.cloud.double() if cameras.points is None else cameras.points
    cameras, missing, found = replace(cameras, points=points), dict[str, str](), set[str]()
    if reason is not None:
        _set_aside(options, files, reason, True)
    else:
        unmasked = [name for name in names if mask_beside(folder / MASKS, Path(name).name) is None]
        missing = _why_unmasked(unmasked, seen)
        _name(missing)
        save_image(folder / _SHEET, mask_sheet(files, folder / MASKS, turns_of(folder)))
        record_found(folder / MASKS, found_masks(folder / MASKS) | set(bare))
        say(f"the masks are in {folder / MASKS}, {folder / _SHEET} shows them; --masks reads them again when corrected")
        known = found_masks(folder / MASKS)
        found = {name for name in names if Path(name).name in known}
        cameras = replace(cameras, images=[entry for entry in cameras.images if entry.name not in missing])
    facts: dict[str, Any] = {
        "photographs": len(names),
        "surface": reason is not None,
        "seconds": round(time.monotonic() - start, 1),
    }
    facts |= {NO_OBJECT: reason} if reason is not None else {}
    return Posed(cameras, missing, True, reason is not None, found, facts)


def _why_unmasked(names: Sequence[str], seen: FoundMasks | None) -> dict[str, str]:
    """Say why photographs got no mask, by their names."""
    hidden = (
        "the object was moved or turned before, something hides it there, or the camera found is wrong; give masks, or "
        "fit the photographs before and after apart"
    )
    plain = "the object does not stand out from its background; give masks"
    return {name: hidden if seen is not None and name in seen.moved else plain for name in names}


def _remove_empty(masks: Path, names: Sequence[str]) -> int:
    """Remove masks that show nearly nothing; return how many."""
    files = [file for name in names if (file := masks / f"{name}.png").is_file()]
    empty = [file for file in files if float(load_image(file).mean()) < _LEAST_OBJECT]
    for file in empty:
        file.unlink()
    return len(empty)


def _set_aside(options: FitOptions, files: Sequence[Path], why: str, is_open: bool) -> None:
    """Keep the masks found of no closed object as a draft; say what follows if the photographs have no other masks."""
    masks = options.output / MASKS
    draft, found = masks / _DRAFT, [mask for file in files if (mask := masks / f"{file.name}.png").is_file()]
    if is_open and found:
        save_image(options.output / _SHEET, mask_sheet(files, masks, turns_of(options.output)))
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
    """Say which photographs are left out, those with one reason together."""
    groups: dict[str, list[str]] = {}
    for name, why in missing.items():
        groups.setdefault(why, []).append(name)
    for why, names in list(groups.items())[:_NAMED]:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        say(f"{', '.join(names[:_NAMED])}{more} {'are' if names[1:] else 'is'} left out: {why}", "yellow")
    if len(groups) > _NAMED:
        rest = sum(len(names) for names in list(groups.values())[_NAMED:])
        say(f"… and {rest} more; report.json names them", "yellow")
