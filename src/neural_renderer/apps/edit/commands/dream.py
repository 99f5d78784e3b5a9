"""`neural-renderer dream`: DeepDream on a mesh."""

from __future__ import annotations

from ...common.command import choose_device, load_network
from .. import PUBLISHED_DREAM, Dream, DreamWeights
from ..options import DreamOptions
from .edit import Preset, load_initial_mesh, loss_weights, run_edit

_PRESETS = {
    "paper": Preset(1000, 5e-5, 1e-2, 0.0, (-10.0, 30.0), 2.5, None, "mesh", True),
    "published": Preset(1000, 1e-4, 1e-2, 0.0, (-10.0, 30.0), 2.5, None, "random", False),
}


def run(options: DreamOptions) -> int:
    """Run DeepDream and write the results; return the exit code."""
    mesh, colored = load_initial_mesh(options)
    published = options.preset == "published"
    weights = loss_weights(options, PUBLISHED_DREAM if published else DreamWeights())
    network = load_network(options.weights or "googlenet", "--weights").to(choose_device(options.device))
    dream = Dream(network, layer=options.layer, channel=options.channel, weights=weights, relative=not published)
    return run_edit(options, mesh, colored, dream, _PRESETS[options.preset], weights)
