"""Options of `neural-renderer fit`. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..common.options import AllowOutside, Device, Mask, MaskOptions, Output, Steps, Watch, WatchOptions
from .checks import check_fit
from .weights import DetailWeights, FitWeights


@dataclass(frozen=True)
class FitOptions:
    """Recover a textured mesh from photographs, the texture of a known mesh, or the camera of one image.

    IMAGES is a folder of photographs, or a video; their cameras are found first (pip install pycolmap). Or it is a
    folder with cameras, or their file: transforms.json (NeRF, Blender, nerfstudio), cameras.json (K, R, t, or distances
    and angles), cameras.csv, a model of COLMAP (sparse/0), *_par.txt (Middlebury). For --recover camera it is one
    image.

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
    """Frames of a video to use (at least 8): sharp ones, spaced by how much the picture changes."""
    surface: bool = False
    """Make an open mesh of all that the photographs show, for what has no outline: a wall, a relief, a room. Needs
    points of structure from motion. Photographs without cameras in which no object stands out need no such hint."""
    recover: Literal["shape", "texture", "camera"] = "shape"
    """Target of the fit. shape: the shape, then the texture if there are photos; texture: the texture of a known mesh;
    camera: the camera of one image, as `pose` does."""
    mesh: Path | None = None
    """Initial mesh, or the known mesh for --recover texture or camera, in the world of the cameras."""
    start: Literal["hull", "sphere"] = "hull"
    """Initial shape without --mesh: the visual hull of the silhouettes, with its holes and handles, or a sphere."""
    cells: int | None = None
    """Grid cells along each axis for the visual hull (at least 8). More cells open narrower holes and gaps, and make
    more faces; by default 64, and 96 or 128 where that opens holes or gaps that several masks show."""
    photos: bool = True
    """Use the colours of the images. Without photos, images are silhouettes."""
    masks: Path | None = None
    """Folder of masks, white on black, named like the images; by default the folder masks beside them, if there is
    one. Images without transparency or mask are cut out by the options for masks, else from a plain background."""
    object: Annotated[tuple[str, ...], tyro.conf.arg(metavar="X Y")] = ()
    """Place of the object in the first photograph, or in another one as PHOTOGRAPH:X,Y, for masks that are found: in
    pixels of the copy in the folder images, or as shares of width and height below 1."""
    masks_only: bool = False
    """End when the masks of photographs without cameras are found. masks.jpg shows them; correct those in the folder
    masks of the output, and read them with --masks. If there are none, that is an error."""
    mask: Mask = field(default_factory=MaskOptions)
    box: tuple[float, float, float, float, float, float] | None = None
    """Opposite corners (x y z x y z) of a box around the object, in the world of the cameras. What is outside is
    background."""
    maps: bool = True
    """Use the maps in the folders normals and depth beside the images, if there are such: a .png or .npy for each
    image, as render --save writes them. They show details and hollows that outlines do not show."""
    normals_in: Literal["world", "camera"] = "world"
    """Space of the normal maps. camera: x right, y up, z towards the viewer."""
    depth_scale: float = 1000.0
    """Steps of a 16-bit depth .png for one unit of the world (above 0); 0 in the .png is no depth."""
    skip_bad: bool = False
    """Leave out images that cannot be used, such as damaged or missing ones, as long as at least half of them remain.
    They are named, also in report.json. By default the first one ends the fit."""
    check: bool = True
    """Check first whether masks and cameras agree, and end with an error if they do not."""
    up: tuple[float, float, float] | None = None
    """Direction that is up in the world of the cameras, for the turntable; by default it is told from the cameras."""
    size: int | None = None
    """Scale larger images down to this longer side in pixels (at least 16); by default 256, and 800 for a surface."""
    held_out: int = 0
    """Hold out every n-th view for the report (at least 2; 0: none)."""
    steps: Annotated[int, Steps] = 150
    """Steps of gradient descent for the shape (at least 1)."""
    detail_steps: int | None = None
    """Steps for normals, depth and, with --light, colours, after those for the shape, which remesh it (at least 0); by
    default 200 if there are such maps or --light."""
    light: Literal["fitted", "none"] | None = None
    """Let details follow the colours of the photos, too. fitted: with a light that was the same in all photos, which is
    fitted along; none: without one, for photos whose light moved, and for objects with a pattern."""
    texture_steps: int = 20
    """Steps of conjugate gradients for the texture (at least 1)."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3)."""
    batch: int = 6
    """Views per step (at least 1)."""
    viewing_angle: float = 30.0
    """Half of the vertical field of view in degrees, for --recover camera (above 0, below 90)."""
    gradient: Literal["edge", "nmr"] = "edge"
    """Gradient estimator of the renderer."""
    refine_cameras: bool = False
    """Fit the poses of the cameras and their focal length, too, for cameras that are not exact: about 1° and 1% off.
    The result has a file cameras.json. Cameras from structure from motion with few points are always refined."""
    camera_steps: int = 150
    """Steps for the cameras before those for the shape (at least 1), for up to 24 views; more views take more."""
    exposure: bool = False
    """Fit the exposure and white balance of each photo, too, for photos that a camera exposed automatically. The report
    has the factors of red, green and blue."""
    color_from: Annotated[float | None, tyro.conf.arg(aliases=["--colour-from"])] = None
    """After this fraction of the steps (0 to 1), colours move the shape, too. Silhouettes do not show hollows; 0.3
    recovers some of them, in twice the time. By default 1, which is never, and 0.4 with --refine-cameras."""
    weights: FitWeights = field(default_factory=FitWeights)
    """Weights of the losses."""
    detail_weights: DetailWeights = field(default_factory=DetailWeights)
    """Weights of the losses of the steps for normals and depth."""
    unwrap: int = 0
    """Side in pixels of one texture image with large charts (16 to 8192; needs xatlas: pip install xatlas); 0: the
    image has a small tile for each face."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
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
