"""`neural-renderer style`: the style of a painting for a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from ..io import load_image
from ..io.files import warn
from ..tasks.editing import PUBLISHED_STYLE, STYLE_LAYERS, Style, StyleWeights
from .common import chosen_device, output_folder
from .edit import Edit, Preset

_PRESETS = {
    "paper": Preset(5000, 2.5e-4, 5e-2, 0.3, (20.0, 40.0), 2.732, (0.75, 0.5), "mesh", True),
    "published": Preset(1000, 5e-4, 5e-2, 0.0, (20.0, 40.0), 2.732, (0.5, 0.5), "random", False),
}


@dataclass(frozen=True, kw_only=True)
class StyleCommand(Edit):
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

    def run(self) -> int:
        """Transfer the style; returns the exit code. Raises ValueError, TypeError or OSError with a sentence."""
        self.checked()
        device = chosen_device(self.device)
        painting = load_image(self.painting, upright=True).permute(2, 0, 1).to(device)
        mesh, coloured = self.loaded()
        output_folder("--output", self.output)  # before a network is fetched and steps are taken
        published = self.preset == "published"
        weights = self.loss_weights(PUBLISHED_STYLE if published else StyleWeights())
        network = self.network("vgg16-original")
        if published and network.name != "VGG-16":
            warn(f"--preset published: its losses are made for VGG-16, of another scale than those of {network.name}")
        style = Style(
            network,
            painting,
            self.size,
            layers=self.layers,
            weights=weights,
            painting_scale=self.painting_scale,
            relative=not published,
        )
        return self.edited(mesh, coloured, style, _PRESETS[self.preset], weights)
