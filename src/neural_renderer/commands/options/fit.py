"""Options of `neural-renderer fit`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ...tasks.settings import FitWeights


@dataclass(frozen=True)
class FitOptions:
    """Recover a textured mesh from images with known cameras; or for a known mesh its texture, or an image's camera.

    IMAGES is a folder with a transforms.json (NeRF), a cameras.json or a cameras.csv (file, azimuth, elevation,
    distance), or that file itself. For --recover camera it is one image.

    Example: neural-renderer fit photos -o out

    Example: neural-renderer fit photos -o out --recover texture --mesh bunny.obj

    Example: neural-renderer fit photo.png -o out --recover camera --mesh bunny.obj

    Ctrl-C ends the fit and writes what there is; --resume goes on.
    """

    images: tyro.conf.Positional[Path]
    """Folder of the images, or the file of their cameras; one image for --recover camera."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the results; it is made if missing."""
    recover: Literal["shape", "texture", "camera"] = "shape"
    """What to find: the shape (and then its texture, if there are photos), the texture alone, or the camera."""
    mesh: Path | None = None
    """Mesh to begin with, or whose texture or camera is looked for; in the world of the cameras."""
    start: Literal["hull", "sphere"] = "hull"
    """Without a mesh, begin with the visual hull of the silhouettes, holes and handles included, or with a sphere."""
    cells: int = 64
    """Cells along each side of the grid that the hull is carved from (at least 8): more for thin parts."""
    photos: bool = True
    """Use the colours of the images; without them they are silhouettes."""
    background: tuple[float, float, float] | None = None
    """Red, green and blue (0 to 1) of what is behind the object, for images without transparency or masks."""
    size: int = 256
    """Images are scaled down to at most this many pixels on their longer side (at least 16)."""
    held_out: int = 0
    """Keep every n-th view for the report instead of fitting it (0: none, else at least 2)."""
    steps: int = 150
    """Steps of descent for the shape or the camera (at least 1)."""
    texture_steps: int = 20
    """Steps of conjugate gradients for the texture (at least 1)."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3)."""
    batch: int = 6
    """Views that each step looks at (at least 1)."""
    starts: int = 16
    """Cameras to begin with, side by side, for --recover camera (at least 1)."""
    viewing_angle: float = 30.0
    """Half of the vertical field of view in degrees, for --recover camera (above 0, below 90)."""
    gradient: Literal["edge", "nmr"] = "edge"
    """The renderer's gradient through visibility."""
    color_from: Annotated[float, tyro.conf.arg(aliases=["--colour-from"])] = 1.0
    """The part of the steps (0 to 1) after which colours move the shape too: 0.3 finds some hollows that silhouettes do
    not show, in twice the time."""
    weights: FitWeights = field(default_factory=FitWeights)
    """How much each loss counts."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
    """Seed of the order in which the views are used, and of the cameras to begin with."""
    allow_outside: bool = False
    """Read images and materials outside the folder of the file that names them, too; for files that you trust."""
    resume: bool = False
    """Go on from the checkpoint in the output folder, if there is one. It must be of the same images and options, but
    for the numbers of steps."""
    force: bool = False
    """Replace mesh.mtl and mesh_texture.png in the output folder even if something else wrote them."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""
