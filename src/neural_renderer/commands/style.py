"""`neural-renderer style`: the style of a painting for a mesh."""

from __future__ import annotations

from dataclasses import dataclass

from ..io import load_image
from ..io.files import warn
from ..tasks import editing
from .common import chosen_device, output_folder
from .edit import Edit, Preset
from .options.style import StyleOptions

_PRESETS = {
    "paper": Preset(5000, 2.5e-4, 5e-2, 0.3, (20.0, 40.0), 2.732, (0.75, 0.5), "mesh", True),
    "published": Preset(1000, 5e-4, 5e-2, 0.0, (20.0, 40.0), 2.732, (0.5, 0.5), "random", False),
}


@dataclass(frozen=True, kw_only=True)
class Style(StyleOptions, Edit):
    """Transfers a style, as the options say."""

    def run(self) -> int:
        """Transfer the style; returns the exit code. Raises ValueError, TypeError or OSError with a sentence."""
        self.checked()
        device = chosen_device(self.device)
        painting = load_image(self.painting, upright=True).permute(2, 0, 1).to(device)
        mesh, coloured = self.loaded()
        output_folder("--output", self.output)  # before a network is fetched and steps are taken
        published = self.preset == "published"
        weights = self.loss_weights(editing.PUBLISHED_STYLE if published else editing.StyleWeights())
        network = self.network("vgg16-original")
        if published and network.name != "VGG-16":
            warn(f"--preset published: its losses are made for VGG-16, of another scale than those of {network.name}")
        style = editing.Style(
            network,
            painting,
            self.size,
            layers=self.layers,
            weights=weights,
            painting_scale=self.painting_scale,
            relative=not published,
        )
        return self.edited(mesh, coloured, style, _PRESETS[self.preset], weights)
