"""Options of `neural-renderer dream`."""

from __future__ import annotations

from dataclasses import dataclass

from ...tasks.settings import DREAM_LAYER
from .edit import EditOptions


@dataclass(frozen=True, kw_only=True)
class DreamOptions(EditOptions):
    """Apply DeepDream to the texture and the shape of a mesh.

    Images of the mesh from all sides are optimised for large activations in a layer of GoogLeNet. torchvision's weights
    are downloaded once (50 MB); --weights reads others.

    Example: neural-renderer dream bunny.obj -o out

    Example: neural-renderer dream teapot.obj -o out --layer inception_4d --channel 3 --weights googlenet.safetensors

    Preset paper: 1000 steps, learning rates 5e-5 and 0.01, elevations -10 to 30, distance 2.5, the mesh's colours.
    Preset published: learning rates 1e-4 and 0.01, random colours, not seamless.

    Ctrl-C ends the run and writes the current result; --resume continues it.
    """

    layer: str = DREAM_LAYER
    """Layer of the network; its activations are maximised."""
    channel: int | None = None
    """Channel of the layer, from 0; by default all."""
