"""Checks of the options of `neural-renderer fit`. This module does not import torch."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.requirements import require_library
from ..common.checks import (
    PICTURE_SUFFIXES,
    check_counts,
    check_earlier,
    check_folder,
    check_input_folder,
    check_inputs,
    check_most,
)

if TYPE_CHECKING:
    from .options import FitOptions

_MOST_CELLS = 512
_OTHER_FILES = (".json", ".csv", ".txt", ".bin")  # suffixes of files that may have cameras
_MODEL_FOLDERS = ("sparse", "0")


def check_fit(options: FitOptions) -> None:
    """Raise an error for options that are out of range or do not fit each other, and for what is missing."""
    check_counts(options, cells=8, size=16, steps=1, texture_steps=1, texture_size=3, batch=1, frames=8)
    check_counts(options, camera_steps=1, detail_steps=0, turntable=0, seed=0, unwrap=0)
    check_most(options, cells=_MOST_CELLS)
    if 0 < options.held_out < 2:
        raise ValueError(f"--held-out: expected at least 2, got {options.held_out}")
    if options.up is not None and not 0 < math.hypot(*options.up) < math.inf:
        raise ValueError(f"--up: expected a direction, got {' '.join(map(str, options.up))}")
    _check_target(options)
    if options.recover == "camera":
        return
    _check_paths(options)
    if options.unwrap:
        require_library("xatlas", "to make charts")
    options.watch.validate()
    check_earlier(options.output, options.resume, options.force)
    check_folder("--output", options.output)


def _check_target(options: FitOptions) -> None:
    """Raise ValueError for options that do not suit what is recovered."""
    if options.refine_cameras and options.recover != "shape":
        raise ValueError(f"--refine-cameras: expected --recover shape, got --recover {options.recover}")
    for name, is_given, phases in (
        ("--exposure", options.exposure, ("shape", "texture")),
        ("--light", options.light is not None, ("shape",)),
    ):
        if is_given and options.recover not in phases:
            raise ValueError(f"{name}: expected --recover {' or '.join(phases)}, got --recover {options.recover}")
        if is_given and not options.photos:
            raise ValueError(f"{name}: expected the colours of photos, got --no-photos")
    if options.surface and (options.recover != "shape" or options.mesh or options.masks or not options.photos):
        raise ValueError("--surface: expected photographs alone, got it with --recover, --mesh, --masks or --no-photos")
    if options.surface and options.masks_only:
        raise ValueError("--masks-only: expected photographs of an object, got it with --surface, which has no masks")
    if options.recover != "shape" and options.mesh is None:
        raise ValueError(f"--mesh: expected a mesh for --recover {options.recover}, got none")


def _check_paths(options: FitOptions) -> None:
    """Raise FileNotFoundError for missing inputs, ModuleNotFoundError if cameras cannot be found without pycolmap."""
    images = options.images
    if images.suffix.lower() in PICTURE_SUFFIXES and images.is_file():
        raise ValueError(f"{images}: expected a folder of at least 3 photographs, or a video, got one picture")
    if not images.exists():
        raise FileNotFoundError(
            f"{images}: expected a folder of images or photographs, a camera file or a video, got nothing there"
        )
    check_input_folder("--masks", options.masks)
    check_inputs(options.mesh)
    if options.cameras == "sfm" or (options.cameras is None and _has_no_cameras(images)):
        require_library("pycolmap", "to find the cameras of photographs")


def _has_no_cameras(images: Path) -> bool:
    """Return whether a folder has neither a file nor a folder that may hold cameras."""
    return images.is_dir() and not any(
        path.suffix.lower() in _OTHER_FILES or path.name in _MODEL_FOLDERS for path in images.iterdir()
    )
