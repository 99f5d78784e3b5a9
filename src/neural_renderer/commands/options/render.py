"""Options of `neural-renderer render`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class RenderOptions:
    """Draw a mesh file as a picture (.png, .jpg) or a turntable (.gif, .mp4).

    Example: neural-renderer render bunny.obj -o bunny.png --size 512

    Example: neural-renderer render bunny.obj -o bunny.gif --turntable 60
    """

    mesh: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Picture to write: .png or .jpg; .gif or .mp4 for a turntable. Must not be a texture of the mesh."""
    size: int | tuple[int, int] = 512
    """Side of the picture, or height and width, in pixels (1 to 32768)."""
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
    fps: float = 20.0
    """Pictures per second of an animation (above 0)."""
    background: Literal["white", "black", "transparent"] | tuple[float, float, float] | None = None
    """Background of the modes rgb and normals: a name, or red, green and blue from 0 to 1. Transparent needs .png. The
    default is white."""
    light: bool = True
    """Light the model from over the viewer's shoulder. Without light, colours are drawn unchanged."""
    normalize: bool = True
    """Move the model to the origin and scale its longest side to 2 units."""
    texture_size: int | None = None
    """Bake colours into textures with this number of texels along the edge of a face (at least 1), as `Mesh.load` does.
    By default the images of the file are used directly."""
    allow_outside: bool = False
    """Allow the mesh file to name materials and images outside of its folder. For trusted files only."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Device to compute on; auto is CUDA if available."""
