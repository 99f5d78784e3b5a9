"""`neural-renderer dream`: DeepDream on a mesh."""

from __future__ import annotations

from dataclasses import dataclass

from ..tasks.editing import DREAM_LAYER, PUBLISHED_DREAM, Dream, DreamWeights
from .common import output_folder
from .edit import Edit, Preset

_PRESETS = {
    "paper": Preset(1000, 5e-5, 1e-2, 0.0, (-10.0, 30.0), 2.5, None, "mesh", True),
    "published": Preset(1000, 1e-4, 1e-2, 0.0, (-10.0, 30.0), 2.5, None, "random", False),
}


@dataclass(frozen=True, kw_only=True)
class DreamCommand(Edit):
    """Paint a mesh, and bend it, into what a network sees in it.

    The images of the mesh, from all around, excite a layer of GoogLeNet more and more: torchvision's, which is fetched
    once (50 MB), or the network of --weights.

    Example: neural-renderer dream bunny.obj -o out

    Example: neural-renderer dream teapot.obj -o out --layer inception_4d --channel 3 --weights googlenet.safetensors

    Preset paper: 1000 steps, rates 5e-5 and 0.01, elevations -10 to 30, distance 2.5, the mesh's colours.
    Published: rates 1e-4 and 0.01, random colours, faces with texels of their own.

    Ctrl-C ends it and writes what there is; --resume goes on.
    """

    layer: str = DREAM_LAYER
    """Layer of the network that is excited."""
    channel: int | None = None
    """Only this channel of the layer, from 0; all by default."""

    def run(self) -> int:
        """Dream; returns the exit code. Raises ValueError, TypeError or OSError with a sentence."""
        self.checked()
        mesh, coloured = self.loaded()
        output_folder("--output", self.output)  # before a network is fetched and steps are taken
        published = self.preset == "published"
        weights = self.loss_weights(PUBLISHED_DREAM if published else DreamWeights())
        dream = Dream(
            self.network("googlenet"), layer=self.layer, channel=self.channel, weights=weights, relative=not published
        )
        return self.edited(mesh, coloured, dream, _PRESETS[self.preset], weights)
