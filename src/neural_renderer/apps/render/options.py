"""Options of `neural-renderer render`. This module does not import torch."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from ..common.checks import UsageError
from ..common.options import AllowOutside, Device
from .checks import check_render

Saved = Literal["rgb", "alpha", "depth", "normal", "position", "uv", "face_index", "barycentric"]
SAVED = get_args(Saved)


@dataclass(frozen=True)
class RenderOptions:
    """Draw mesh files as pictures (.png, .jpg) or animations (.gif, .mp4), or save what the pixels show.

    Example: neural-renderer render bunny.obj -o bunny.png --size 512

    Example: neural-renderer render bunny.obj -o bunny.gif --turntable 60

    Example: neural-renderer render models -o pictures --turntable 24

    Example: neural-renderer render chair.glb table.glb -o room.png --camera cameras.json --background room.jpg

    Example: neural-renderer render helmet.glb -o helmet.png --shading pbr --environment studio.hdr

    Example: neural-renderer render bunny.obj --save depth depth.png normal normal.exr position position.npy

    Example: neural-renderer render fox.glb --animate fox.gif --animation Walk
    """

    meshes: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="MESH", name="MESH")]
    """Mesh files: .obj, .ply, .stl, .off, .glb or .gltf, or folders of such. Several are drawn as one scene, or, if the
    output is a folder or has %s in its name, each for itself."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Picture to write: .png or .jpg; .gif or .mp4 for an animation; a folder for the pictures of models or of a
    turntable. In a name, %s is the name of a model, and %03d the number of a view: one of a turntable, or of a camera
    in the file. An existing file is replaced, but not a texture of a mesh."""
    save: Annotated[tuple[tuple[Saved, Path], ...], tyro.conf.arg(metavar="OUTPUT FILE …")] = ()
    """Outputs and the files to write: .npy, .exr (pip install OpenEXR), or .png for all but position, uv and
    face_index. rgb and alpha are anti-aliased, the others are those at the pixels' centres; 0 where no face is visible,
    -1 for face_index. Normals (smooth) and positions are in world space; depth is along the viewing axis."""
    depth_scale: float = 1000.0
    """Steps of a 16-bit depth .png for one unit of the model (above 0): with 1000, metres are stored in millimetres."""
    camera: Path | None = None
    """Camera file, in place of the angles below: transforms.json, cameras.json or cameras.csv as for `fit`; the
    report.json of `pose`; or JSON with K, R, t, width and height, or with matrices. The page on cameras
    describes all. The model is not normalised. A picture shows one camera, an animation all."""
    frame: int = 0
    """Number of the camera in the file, from 0, for a picture."""
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
    """Light the model from over the viewer's shoulder. Without light, colours are drawn unchanged."""
    environment: Path | None = None
    """Image of the surroundings (equirectangular: .hdr, .exr, .jpg, …) that lights the model in place of this lamp."""
    shading: Literal["flat", "smooth", "phong", "pbr"] | None = None
    """Light on faces as a whole (flat), or on each pixel, with smooth normals and normal maps: matt (smooth), with
    highlights (phong), or with metal and roughness of the file's materials (pbr). By default smooth for meshes with
    normals and for those that have hardly any creases, else flat."""
    layers: int | None = None
    """Number of faces that are blended at each pixel (at least 1), for transparent and cut-out materials; 4 is enough
    for two bodies, one behind the other. By default all faces are opaque."""
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
    if problem := _problem_of_save(arguments) or _problem_of_size(arguments):
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


def _problem_of_size(arguments: list[str]) -> str | None:
    """Expect a number as the first value of --size."""
    for place, argument in enumerate(arguments):
        option, equals, value = argument.partition("=")
        value = value if equals else "".join(arguments[place + 1 : place + 2])
        if option == "--size" and not re.fullmatch(r"[+-]?\d+", value):
            return f"--size: expected a side, or height and width such as --size 480 640, in pixels, got {value!r}"
    return None
