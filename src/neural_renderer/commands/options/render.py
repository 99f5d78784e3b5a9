"""Options of `neural-renderer render`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class RenderOptions:
    """Draw a mesh file as a picture (.png, .jpg) or as a turntable (.gif, .mp4).

    Example: neural-renderer render bunny.obj -o bunny.png --size 512

    Example: neural-renderer render bunny.obj -o bunny.gif --turntable 60
    """

    mesh: tyro.conf.Positional[Path]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Picture to write: .png or .jpg; .gif or .mp4 for a turntable. It may not be an image of the mesh."""
    size: int | tuple[int, int] = 512
    """Side of the picture, or height and width, in pixels (1 to 32768)."""
    azimuth: float = 150.0
    """Where the camera stands around the y axis, in degrees: 180 on +z, in front of most models, 90 on +x, 0 on -z, in
    front of some."""
    elevation: float = 20.0
    """How high the camera stands, in degrees (above -90, below 90): 0 level with the model, positive above it."""
    distance: float | None = None
    """From the camera to the origin, in the model's units (above 0); by default the whole model is in the picture."""
    viewing_angle: float = 20.0
    """Half of the vertical field of view, in degrees (above 0, below 90)."""
    orthographic: bool = False
    """Draw without perspective; then distance and viewing angle do not change sizes."""
    mode: Literal["rgb", "silhouettes", "depth", "normals"] = "rgb"
    """What to draw: colours; silhouettes, white on black; depth, near bright and far dark; or normals as the camera
    sees them, red to the right, green up, blue towards the viewer."""
    turntable: int | None = None
    """Number of pictures of a turntable that begins at the azimuth (at least 1); 60 for an animation."""
    fps: float = 20.0
    """Pictures per second of an animation (above 0)."""
    background: Literal["white", "black", "transparent"] | tuple[float, float, float] | None = None
    """Colour behind the model, for mode rgb or normals only: a name, or red, green and blue from 0 to 1; transparent is
    for .png. White by default."""
    light: bool = True
    """Light the model from over the viewer's shoulder; without light its colours are drawn as they are."""
    normalize: bool = True
    """Move the model to the origin and scale its longest side to 2 units."""
    texture_size: int | None = None
    """Bake the colours into textures of so many texels along the side of a face (at least 1), as `Mesh.load` does. By
    default the file's images are shown as they are."""
    allow_outside: bool = False
    """Read materials and images outside the mesh's folder too, if its file names such; for files that you trust."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""
