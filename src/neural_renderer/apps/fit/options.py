"""Options of `neural-renderer fit`. This module does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

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
from ..common.options import (
    DEPTH_SCALE,
    LEAST_SIDE,
    AllowOutside,
    Device,
    Mask,
    MaskOptions,
    Output,
    Steps,
    Watch,
    WatchOptions,
)
from .settings import (
    RECOVER,
    START,
    CameraSettings,
    DescentSettings,
    DetailSettings,
    Gradient,
    Light,
    ShapeSettings,
    TextureSettings,
)
from .weights import DetailWeights, FitWeights

_MOST_CELLS = 512
_OTHER_FILES = (".json", ".csv", ".txt", ".bin")  # suffixes of files that may have cameras
_MODEL_FOLDERS = ("sparse", "0")


@dataclass(frozen=True)
class FitOptions:
    """Recover a textured mesh from photographs, the texture of a known mesh, or the camera of one image.

    IMAGES is a folder of photographs, or a video; their cameras are found first (extra "fit"). Or it is a
    folder with cameras, or their file: transforms.json (NeRF, Blender, nerfstudio, instant-ngp), cameras.json (K, R, t,
    or distances and angles), cameras.csv, a model of COLMAP (sparse/0), cameras.npz (IDR, NeuS), scene_camera.json
    (BOP), *_par.txt (Middlebury). For --recover camera it is one image.

    Example: neural-renderer fit photos -o out

    Example: neural-renderer fit wall -o out --surface

    Example: neural-renderer fit photos -o out --recover texture --mesh bunny.obj

    Example: neural-renderer fit photo.png -o out --recover camera --mesh bunny.obj

    Ctrl-C ends the fit and writes the current result; --resume continues it.
    """

    images: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="IMAGES")]
    """Folder of the images, their camera file, or a video; one image for --recover camera."""
    output: Output
    """Folder for the results; it is made if missing."""
    cameras: Literal["sfm", "file"] | None = None
    """Source of the cameras. sfm: structure from motion, which writes images, masks and sparse/0 into the output; file:
    the camera file. By default the file, and sfm if there is none."""
    frames: int = 60
    """Frames of a video to use (at least 8): sharp ones, spaced by the change of the picture."""
    surface: bool = False
    """Make an open surface of everything in the photographs, for scenes without an outline: a wall, a relief, a room.
    Needs points from structure from motion. Set automatically for photographs without cameras and without an object."""
    recover: Literal["shape", "texture", "camera"] = RECOVER
    """Target of the fit. shape: the shape, then the texture if there are photos; texture: the texture of a known mesh;
    camera: the camera of one image, as `pose` does."""
    mesh: Path | None = None
    """Initial mesh, or the known mesh for --recover texture or camera, in the world of the cameras."""
    start: Literal["hull", "sphere"] = START
    """Initial shape without --mesh: the visual hull of the silhouettes, with its holes and handles, or a sphere."""
    cells: int | None = ShapeSettings.cells
    """Grid cells along each axis for the visual hull (at least 8). More cells open narrower holes and gaps, and make
    more faces; by default 64, and 96 or 128 where that opens holes or gaps that several masks show."""
    photos: bool = True
    """Use the colours of the images. Without photos, images are silhouettes."""
    masks: Path | None = None
    """Folder of masks, white on black, named like the images; by default their sibling folder masks, if there is
    one. Images without transparency or mask are cut out by the options for masks, else from a plain background."""
    object: Annotated[tuple[str, ...], tyro.conf.arg(metavar="X Y")] = ()
    """Position of the object in the first photograph, or in another one as PHOTOGRAPH:X,Y, for automatic masks: in
    pixels of the copy in the folder images, or as fractions (below 1) of width and height. Four numbers X Y X Y are
    opposite corners of a box around all of the object: what touches it is cut off by its colours."""
    masks_only: bool = False
    """End when the masks of photographs without cameras are found. masks.jpg shows them; correct those in the folder
    masks of the output, and read them with --masks. If there are none, that is an error."""
    mask: Mask = field(default_factory=MaskOptions)
    box: tuple[float, float, float, float, float, float] | None = None
    """Opposite corners (x y z x y z) of a box around the object, in the world of the cameras. What is outside is
    background."""
    maps: bool = True
    """Use the maps in the folders normals and depth next to the images, if there are any: a .png or .npy per image,
    as render --save writes them. They show details and concavities that outlines do not."""
    normals_in: Literal["world", "camera"] = "world"
    """Space of the normal maps. camera: x right, y up, z towards the viewer."""
    depth_scale: float = DEPTH_SCALE
    """Steps of a 16-bit depth .png for one unit of the world (above 0); 0 in the .png is no depth."""
    skip_bad: bool = False
    """Leave out images that cannot be used, such as damaged or missing ones, as long as at least half of them remain.
    They are named, also in report.json. By default the first one ends the fit."""
    check: bool = True
    """Check first whether masks and cameras agree, and end with an error if they do not."""
    up: tuple[float, float, float] | None = None
    """Up direction in the world of the cameras, for the turntable; by default it is estimated from the cameras."""
    size: int | None = None
    """Scale larger images down to this longer side in pixels (at least 16); by default 256, and 800 for a surface."""
    held_out: int = 0
    """Hold out every n-th view for the report (at least 2; 0: none)."""
    steps: Annotated[int, Steps] = ShapeSettings.steps
    """Steps of gradient descent for the shape (at least 1)."""
    detail_steps: int | None = DetailSettings.steps
    """Steps for normals, depth or colours, after those for the shape, which remesh it (at least 0); by default 200 if
    there are such maps or photos, and 260 for more than 24 photos with known masks."""
    light: Light | None = DetailSettings.light
    """Light for the details that follow the colours of photos. fitted: one that was the same in all photos, which is
    fitted along; none: no light, for photos whose light moved, and for objects with a pattern. By default fitted,
    unless there are maps or --no-photos."""
    texture_steps: int = TextureSettings.steps
    """Steps of conjugate gradients for the texture (at least 1)."""
    texture_size: int = TextureSettings.size
    """Texels along the edge of a face's texture (at least 3)."""
    batch: int = DescentSettings.batch
    """Views per step (at least 1)."""
    viewing_angle: float = 30.0
    """Half of the vertical field of view in degrees, for --recover camera (above 0, below 90)."""
    gradient: Gradient = DescentSettings.gradient
    """Gradient estimator of the renderer."""
    refine_cameras: bool = CameraSettings.refine
    """Fit the poses of the cameras and their focal length, too, for cameras that are not exact: about 1° and 1% off.
    The result has a file cameras.json. Cameras from structure from motion with few points are always refined."""
    camera_steps: int = CameraSettings.steps
    """Steps for the cameras before those for the shape (at least 1), for up to 24 views; more views take more."""
    exposure: bool = False
    """Fit the exposure and white balance of each photo, too, for photos that a camera exposed automatically. The report
    has the factors of red, green and blue."""
    color_from: Annotated[float | None, tyro.conf.arg(aliases=["--colour-from"])] = ShapeSettings.color_from
    """After this fraction of the steps (0 to 1), colours move the shape, too. Silhouettes do not show hollows; 0.3
    recovers some of them, in twice the time. By default 1, which is never, and 0.4 with --refine-cameras."""
    weights: FitWeights = field(default_factory=FitWeights)
    """Weights of the losses."""
    detail_weights: DetailWeights = field(default_factory=DetailWeights)
    """Weights of the losses of the steps for normals and depth."""
    unwrap: int = 0
    """Side in pixels of one texture image with large charts (16 to 8192; needs the extra "fit"); 0: the
    image has a small tile for each face."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = DescentSettings.seed
    """Seed of the order of the views."""
    allow_outside: AllowOutside = False
    resume: bool = False
    """Resume from the checkpoint in the output folder, if there is one. Images and options must be the same, except for
    numbers of steps."""
    force: bool = False
    """Replace what is in the output folder: the results of an earlier run, and mesh.mtl and mesh_texture.png even if
    another program wrote them."""
    device: Device = "auto"
    watch: Watch = field(default_factory=WatchOptions)

    def validate(self) -> None:
        """Raise an error for options that are out of range or do not fit each other, and for what is missing."""
        check_fit(self)


def check_fit(options: FitOptions) -> None:
    """Raise an error for options that are out of range or do not fit each other, and for what is missing."""
    check_counts(options, cells=8, size=LEAST_SIDE, steps=1, texture_steps=1, texture_size=3, batch=1, frames=8)
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
    if options.surface and (options.detail_steps or options.light):
        raise ValueError("--surface: expected no steps for details, got --detail-steps or --light")
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
            f"{images}: expected a folder of images or a camera file, or a video, got nothing there"
        )
    check_input_folder(options.masks, "a folder of masks")
    check_inputs(options.mesh)
    if options.cameras == "sfm" or (options.cameras is None and _has_no_cameras(images)):
        require_library("pycolmap", "to find the cameras of photographs")


def _has_no_cameras(images: Path) -> bool:
    """Return whether a folder has neither a file nor a folder that may hold cameras."""
    return images.is_dir() and not any(
        path.suffix.lower() in _OTHER_FILES or path.name in _MODEL_FOLDERS for path in images.iterdir()
    )
