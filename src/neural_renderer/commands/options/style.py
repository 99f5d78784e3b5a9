"""Options of `neural-renderer style`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from ...tasks.settings import STYLE_LAYERS
from .edit import EditOptions


@dataclass(frozen=True, kw_only=True)
class StyleOptions(EditOptions):
    """Paint a mesh, and bend it, in the style of a picture.

    The images of the mesh, from all around, come to have the picture's statistics in the layers of a network: VGG-16,
    which is fetched once (528 MB), or the VGG of --weights.

    Example: neural-renderer style bunny.obj starry_night.jpg -o out

    Example: neural-renderer style teapot.obj wave.jpg -o out --iterations 400 --size 160 --weights vgg19.safetensors

    Preset paper: 5000 steps, rates 2.5e-4 and 0.05, elevations 20 to 40, distance 2.732, light 0.75 and 0.5, the mesh's
    colours. Published: 1000 steps, rates 5e-4 and 0.05, light 0.5 and 0.5, random colours, faces with texels of their
    own.

    Ctrl-C ends it and writes what there is; --resume goes on.
    """

    painting: tyro.conf.Positional[Path]
    """Picture whose style the mesh gets: PNG, JPEG or any other that Pillow reads."""
    content: float | None = None
    """Weight of the shape: how much the vertices are held where they were; by default the preset's."""
    palette: float | None = None
    """Weight of the picture's colours: how much others are held back; by default the preset's."""
    light: tuple[float, float] | None = None
    """Ambient and directional intensity of the light; by default the preset's."""
    painting_scale: float = 1.0
    """How large the picture is beside the images of the mesh (above 0): 2 makes its strokes twice as large."""
    layers: tuple[str, ...] = STYLE_LAYERS
    """Layers of the network whose statistics are compared."""
