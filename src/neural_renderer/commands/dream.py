"""`neural-renderer dream`: DeepDream on a mesh."""

from __future__ import annotations

from dataclasses import dataclass

from ..tasks import editing
from .common import output_folder
from .edit import Edit, Preset
from .options.dream import DreamOptions

_PRESETS = {
    "paper": Preset(1000, 5e-5, 1e-2, 0.0, (-10.0, 30.0), 2.5, None, "mesh", True),
    "published": Preset(1000, 1e-4, 1e-2, 0.0, (-10.0, 30.0), 2.5, None, "random", False),
}


@dataclass(frozen=True, kw_only=True)
class Dream(DreamOptions, Edit):
    """Dreams, as the options say."""

    def run(self) -> int:
        """Dream; returns the exit code. Raises ValueError, TypeError or OSError with a sentence."""
        self.checked()
        mesh, coloured = self.loaded()
        output_folder("--output", self.output)  # before a network is fetched and steps are taken
        published = self.preset == "published"
        weights = self.loss_weights(editing.PUBLISHED_DREAM if published else editing.DreamWeights())
        dream = editing.Dream(
            self.network("googlenet"), layer=self.layer, channel=self.channel, weights=weights, relative=not published
        )
        return self.edited(mesh, coloured, dream, _PRESETS[self.preset], weights)
