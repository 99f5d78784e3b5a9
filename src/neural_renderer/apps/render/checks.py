"""Checks of the options of `neural-renderer render`. This module does not import torch."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ...base.requirements import existing, require_library
from ..common.checks import UsageError, check_between, check_counts, check_folder, check_inputs

if TYPE_CHECKING:
    from .options import RenderOptions

NUMBER = re.compile(r"%(0?\d?)d")
"""Place of the number of a view in a name."""
_PICTURES, _ANIMATIONS = (".png", ".jpg", ".jpeg"), (".gif", ".mp4")
_VALUES = (".npy", ".exr")
_PICTURES_OF = {"rgb": _PICTURES, "alpha": _PICTURES, "depth": (".png",), "normal": (".png",), "barycentric": (".png",)}
_RIGGED = (".glb", ".gltf")


def check_render(options: RenderOptions) -> None:
    """Raise an error for options that are out of range or do not fit each other, and for files that do not exist."""
    if not options.meshes:
        raise UsageError("MESH: expected at least one mesh file, got none")
    _check_animation(options)
    _check_ranges(options)
    output = options.animate or options.output
    if output is not None and output.suffix and not output.is_dir():
        check_drawing(options)
    _check_saved(options.save)
    for path in options.meshes:
        if not path.is_dir():
            existing(path)
    check_inputs(options.camera, options.environment)
    if isinstance(options.background, Path):
        existing(options.background)
    if output is not None:
        check_folder("--output", output.parent if output.suffix else output)
    for _, path in options.save:
        check_folder("--save", path.parent)


def check_drawing(options: RenderOptions) -> None:
    """Raise ValueError for an output that does not fit the other options. It is a file, not a folder."""
    output = options.animate or options.output
    if output is None and not options.save:
        raise ValueError("--output: expected a picture to write, or --save with outputs and files, got neither")
    suffix = output.suffix.lower() if output is not None else ".png"
    name = output.name if output is not None else ""
    if suffix not in _PICTURES + _ANIMATIONS:
        expected = ", ".join(_PICTURES + _ANIMATIONS)
        raise ValueError(f"--output: expected a name that ends in {expected}, got {name!r}")
    if options.turntable is not None and not is_animation(output):
        raise ValueError(
            f"--output: expected a .gif or .mp4, a folder or numbers such as %03d.png for a turntable, got {name!r}"
        )
    if options.save and is_animation(output):
        raise ValueError(f"--save: expected a picture beside it, got the animation {name!r}")
    if options.animate is not None and not is_animation(output):
        raise ValueError(f"--animate: expected a .gif, a .mp4 or numbers such as %03d.png, got {name!r}")
    if options.background == "transparent" and suffix != ".png":
        raise ValueError(f"--background transparent: expected a .png, got {name!r}")


def is_animation(output: Path | None) -> bool:
    """Return whether the name of an output stands for several pictures: an animation, or numbered files."""
    return output is not None and (output.suffix.lower() in _ANIMATIONS or has_number(output))


def has_number(path: Path | None) -> bool:
    """Return whether a name stands for numbered pictures."""
    return path is not None and NUMBER.search(path.name) is not None


def is_posed(options: RenderOptions) -> bool:
    """Return whether the options ask for one time of an animation of the file, or for all of it."""
    return options.time is not None or options.animate is not None


def _check_animation(options: RenderOptions) -> None:
    """Raise ValueError for options of animations that do not fit the others."""
    if not is_posed(options):
        if options.animation is not None:
            raise ValueError(f"--animation: expected --time or --animate with it, got {options.animation!r} alone")
        return
    name = "--animate" if options.time is None else "--time"
    if options.time is not None and options.animate is not None:
        raise ValueError("--animate: expected --time for one moment or --animate for all, got both")
    if len(options.meshes) != 1 or options.meshes[0].suffix.lower() not in _RIGGED:
        raise ValueError(f"{name}: expected one .glb or .gltf file, got {', '.join(p.name for p in options.meshes)}")
    if options.texture_size is not None:
        raise ValueError(f"{name}: expected the images of the file, without --texture-size")
    if options.animate is not None:
        if options.output is not None or options.save:
            raise ValueError("--animate: expected it in place of --output and --save, got both")
        if options.turntable is not None:
            raise ValueError("--animate: expected one camera, got a turntable")


def _check_ranges(options: RenderOptions) -> None:
    """Raise ValueError for numbers that are out of range, and for options that exclude each other."""
    if options.output is None and options.animate is None and not options.save:
        raise ValueError("--output: expected a picture to write, or --save with outputs and files, got neither")
    check_counts(options, turntable=1, texture_size=1, frame=0, layers=1)
    if options.frame and options.camera is None:
        raise ValueError(f"--frame: expected --camera with it, got frame {options.frame} of no file")
    if options.turntable is not None and options.camera is not None:
        raise ValueError("--turntable: expected a turntable or --camera, got both")
    if options.layers is not None and options.texture_size is not None:
        raise ValueError("--layers: expected the materials of the file, without --texture-size")
    if options.layers is not None and options.mode != "rgb":
        raise ValueError(f"--layers: expected --mode rgb, got {options.mode}")
    check_between("fps", options.fps, 0, math.inf)
    check_between("depth-scale", options.depth_scale, 0, math.inf)
    check_between("viewing-angle", options.viewing_angle, 0, 90)
    check_between("elevation", options.elevation, -90, 90)
    if not math.isfinite(options.azimuth):
        raise ValueError(f"--azimuth: expected a finite number of degrees, got {options.azimuth}")
    if options.distance is not None:
        check_between("distance", options.distance, 0, math.inf)
    if options.background is not None and options.mode in ("silhouettes", "depth"):
        raise ValueError(f"--background: expected --mode rgb or normals, got {options.mode} (always on black)")
    if options.environment is not None and not options.light:
        raise ValueError("--environment: expected it with light, got --no-light")
    if options.background == "environment" and options.environment is None:
        raise ValueError("--background environment: expected --environment with an image, got none")
    if isinstance(options.background, tuple) and not all(0 <= value <= 1 for value in options.background):
        raise ValueError(f"--background: expected three numbers from 0 to 1, got {options.background}")


def _check_saved(save: Sequence[tuple[str, Path]]) -> None:
    """Raise ValueError for files whose suffix does not fit the output, ModuleNotFoundError if a writer is missing."""
    for name, path in save:
        suffixes = (*_PICTURES_OF.get(name, ()), *_VALUES)
        if path.suffix.lower() not in suffixes:
            raise ValueError(f"--save {name}: expected a name that ends in {', '.join(suffixes)}, got {path.name!r}")
        if path.suffix.lower() == ".exr":
            require_library("OpenEXR", f"to write {path}")
