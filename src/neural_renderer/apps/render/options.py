"""Options of `neural-renderer render`. This module does not import torch."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from ...base.requirements import existing, require_library
from ..common.checks import (
    UsageError,
    check_between,
    check_cameras,
    check_counts,
    check_folder,
    check_inputs,
)
from ..common.options import DEPTH_SCALE, AllowOutside, Device, problem_of_size

Saved = Literal["rgb", "alpha", "depth", "normal", "position", "uv", "face_index", "barycentric"]
SAVED = get_args(Saved)


@dataclass(frozen=True)
class RenderOptions:
    """Render mesh files to pictures (.png, .jpg) or animations (.gif, .mp4), or save depth, normals and other values.

    Example: neural-renderer render bunny.obj -o bunny.png --size 512

    Example: neural-renderer render bunny.obj -o bunny.gif --turntable 60

    Example: neural-renderer render models -o pictures --turntable 24

    Example: neural-renderer render chair.glb table.glb -o room.png --camera cameras.json --background room.jpg

    Example: neural-renderer render helmet.glb -o helmet.png --shading pbr --environment studio.hdr

    Example: neural-renderer render bunny.obj --save depth depth.png normal normal.exr position position.npy

    Example: neural-renderer render bunny.obj -o views.png --sheet

    Example: neural-renderer render fox.glb --animate fox.gif --animation Walk
    """

    meshes: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="MESH", name="MESH")]
    """Mesh files: .obj, .ply, .stl, .off, .glb or .gltf, or folders of such. Several meshes form one scene. If the
    output is a folder or contains %s, each gets its own picture."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o", "--out"])] = None
    """Picture to write: .png or .jpg; .gif or .mp4 for an animation; a folder for the pictures of models or of a
    turntable. In a name, %s is the name of a model, and %03d the number of a view: one of a turntable, or of a camera
    in the file. An existing file is replaced, but not a texture of a mesh."""
    save: Annotated[tuple[tuple[Saved, Path], ...], tyro.conf.arg(metavar="OUTPUT FILE …")] = ()
    """Outputs and the files to write: .npy, .exr (extra "exr"), or .png for all but position, uv and
    face_index. rgb and alpha are anti-aliased, the others are those at the pixels' centres; 0 where no face is visible,
    -1 for face_index. Normals (smooth) and positions are in world space; depth is along the viewing axis."""
    depth_scale: float = DEPTH_SCALE
    """Steps of a 16-bit depth .png for one unit of the model (above 0): with 1000, metres are stored in millimetres."""
    camera: Path | None = None
    """Camera file, in place of the angles below: transforms.json, cameras.json or cameras.csv as for `fit`; the
    report.json of `pose`; or JSON with K, R, t, width and height, or with matrices. The page on cameras
    describes all. The model is not normalised. A picture shows one camera, an animation all."""
    frame: int = 0
    """Number of the camera in the file, from 0, for a picture."""
    sheet: bool = False
    """Draw one picture of the front, right, top, back and a corner, without perspective, with the sizes of the model
    in its own units beside it. --size is the side of each view."""
    size: int | tuple[int, int] | None = None
    """Side of the picture, or height and width, in pixels (1 to 32768). By default the size in the camera file, or that
    of the background photograph, or 512."""
    azimuth: float = 150.0
    """Position of the camera around the y axis in degrees: 180 is at +z, in front of most models; 90 at +x; 0 at -z."""
    elevation: float = 20.0
    """Elevation of the camera in degrees (above -90, below 90); positive is above the model."""
    distance: float | None = None
    """Distance of the camera from the origin in units of the model (above 0). By default the whole model is visible."""
    viewing_angle: float = 20.0
    """Half of the vertical field of view in degrees (above 0, below 90)."""
    orthographic: bool = False
    """Use orthographic projection. Distance and viewing angle then do not change sizes."""
    mode: Literal["rgb", "silhouettes", "depth", "normals"] = "rgb"
    """Content of the picture. rgb: colours; silhouettes: white on black; depth: near is bright; normals: in camera
    space, red to the right, green up, blue towards the viewer."""
    turntable: int | None = None
    """Number of pictures of a turntable (at least 1), from the azimuth on. 60 by default for an animation."""
    time: float | None = None
    """Time in seconds of the animation of a .glb or .gltf file; constant beyond its ends. By default the file's pose at
    rest, without joints."""
    animate: Path | None = None
    """Animation (.gif, .mp4, or numbers such as %03d.png) of the model's own motion, in place of the output."""
    animation: str | None = None
    """Name or number of the file's animation, for time and animate. The first by default."""
    fps: float = 20.0
    """Pictures per second of an animation (above 0)."""
    background: Literal["white", "black", "transparent", "environment"] | tuple[float, float, float] | Path | None = (
        None
    )
    """Background of the modes rgb and normals: a name; red, green and blue from 0 to 1; or a photograph, which is
    scaled to the picture. Transparent needs .png, and environment the option of this name. The default is white."""
    light: bool = True
    """Light the model from behind the camera. Without light, colours are drawn unchanged."""
    environment: Path | None = None
    """Environment map (equirectangular: .hdr, .exr, .jpg, …) that lights the model in place of this lamp."""
    shading: Literal["flat", "smooth", "phong", "pbr"] | None = None
    """flat: one normal per face. The others shade each pixel with smooth normals and normal maps: smooth is diffuse,
    phong has highlights, pbr uses metalness and roughness of the file's materials. By default smooth for meshes with
    normals or few creases, else flat."""
    layers: int | None = None
    """Number of faces blended at each pixel (at least 1), for transparent and alpha-masked materials; 4 is enough for
    two objects, one behind the other. By default all faces are opaque."""
    normalize: bool = True
    """Move the model to the origin and scale its longest side to 2 units. Several meshes are moved together."""
    texture_size: int | None = None
    """Bake colours into textures with this number of texels along the edge of a face (at least 1), as `Mesh.load` does.
    By default the images of the file are used directly."""
    allow_outside: AllowOutside = False
    device: Device = "auto"

    def validate(self) -> None:
        """Raise an error for options that are out of range, and for files that do not exist."""
        check_render(self)


def parse(arguments: list[str], prog: str) -> RenderOptions:
    """Parse the options. One sentence says what is wrong with --save or --size: those of the parser are long."""
    if problem := _problem_of_save(arguments) or problem_of_size(arguments):
        raise UsageError(problem)
    return tyro.cli(RenderOptions, prog=prog, args=[word for word in arguments if word != "--debug"])


def _problem_of_save(arguments: list[str]) -> str | None:
    """Expect --save once at most, with known names, each followed by a file."""
    places = [place for place, argument in enumerate(arguments) if argument.partition("=")[0] == "--save"]
    if not places:
        return None
    words = list(itertools.takewhile(lambda word: not word.startswith("-"), arguments[places[0] + 1 :]))
    wrong = [word for word in words[::2] if word not in SAVED]
    if len(places) > 1:
        return f"--save: expected at most once, with all its values, got it {len(places)} times"
    if wrong:
        return f"--save: expected each name to be one of {', '.join(SAVED)}, got {wrong[0]!r}"
    if not words or len(words) % 2:
        first = SAVED[0]
        return f"--save: expected names and files in turn, such as {first} {first}.png, got {' '.join(words)!r}"
    return None


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
    _check_sheet(options)
    output = options.animate or options.output
    if output is not None and output.suffix and not output.is_dir():
        check_drawing(options)
    _check_saved(options.save)
    for path in options.meshes:
        if not path.is_dir():
            existing(path)
    check_cameras(options.camera)
    check_inputs(options.environment)
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
        raise ValueError(f"--save: expected a picture as --output, got the animation {name!r}")
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
    """Return whether the options select a time of an animation of the file, or the whole animation."""
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


def _check_sheet(options: RenderOptions) -> None:
    """Raise ValueError for options that a sheet of views does not have."""
    if not options.sheet:
        return
    others = ("camera", "turntable", "distance", "background", "texture_size", "save", "time", "animate")
    if given := next((name for name in others if getattr(options, name) not in (None, ())), None):
        raise ValueError(f"--sheet: expected it without --{given.replace('_', '-')}, got both")
    if options.mode != "rgb" or isinstance(options.size, tuple):
        raise ValueError(f"--sheet: expected --mode rgb and one side as --size, got {options.mode}, {options.size}")
    if is_animation(options.output):
        raise ValueError(f"--sheet: expected a picture as --output, got {options.output}")


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
