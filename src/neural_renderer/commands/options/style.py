"""Options of `neural-renderer style`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ...tasks.settings import STYLE_LAYERS
from .edit import EditOptions


@dataclass(frozen=True, kw_only=True)
class StyleOptions(EditOptions):
    """Transfer the style of a painting to the texture and the shape of a mesh.

    Images of the mesh from all sides are optimised to have the painting's feature statistics in layers of a VGG. The
    weights of VGG-16 are downloaded once (528 MB); --weights reads others.

    Example: neural-renderer style bunny.obj starry_night.jpg -o out

    Example: neural-renderer style teapot.obj wave.jpg -o out --iterations 400 --size 160 --weights vgg19.safetensors

    Preset paper: 5000 steps, learning rates 2.5e-4 and 0.05, elevations 20 to 40, distance 2.732, light 0.75 and 0.5,
    the mesh's colours. Preset published: 1000 steps, learning rates 5e-4 and 0.05, light 0.5 and 0.5, random colours,
    not seamless.

    Ctrl-C ends the run and writes the current result; --resume continues it.
    """

    painting: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PAINTING")]
    """Picture with the style: PNG, JPEG or any other format that Pillow reads."""
    content: float | None = None
    """Weight of the content loss. It keeps vertices near their initial positions. By default the preset's."""
    palette: float | None = None
    """Weight of the palette loss. It penalises colours outside the painting's palette. By default the preset's."""
    light: tuple[float, float] | None = None
    """Ambient and directional intensity of the light; by default the preset's."""
    painting_scale: float = 1.0
    """Size of the painting relative to the images of the mesh (above 0). 2 makes its strokes twice as large."""
    layers: tuple[str, ...] = STYLE_LAYERS
    """Layers of the network for the comparison of feature statistics."""
