"""Options of `neural-renderer dream`."""

from __future__ import annotations

from dataclasses import dataclass

from ...tasks.settings import DREAM_LAYER
from .edit import EditOptions


@dataclass(frozen=True, kw_only=True)
class DreamOptions(EditOptions):
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
