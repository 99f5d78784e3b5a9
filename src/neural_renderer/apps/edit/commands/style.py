"""`neural-renderer style`: style transfer from a painting to a mesh."""

from __future__ import annotations

from ....io import load_image
from ....io.files import warn
from ...common.command import choose_device, load_network
from .. import PUBLISHED_STYLE, Style, StyleWeights
from ..options import StyleOptions
from .edit import Preset, load_initial_mesh, loss_weights, run_edit

_PRESETS = {
    "paper": Preset(5000, 2.5e-4, 5e-2, 0.3, (20.0, 40.0), 2.732, (0.75, 0.5), "mesh", True),
    "published": Preset(1000, 5e-4, 5e-2, 0.0, (20.0, 40.0), 2.732, (0.5, 0.5), "random", False),
}


def run(options: StyleOptions) -> int:
    """Transfer a style and write the results; return the exit code."""
    device = choose_device(options.device)
    painting = load_image(options.painting, upright=True).permute(2, 0, 1).to(device)
    mesh, colored = load_initial_mesh(options)
    published = options.preset == "published"
    weights = loss_weights(options, PUBLISHED_STYLE if published else StyleWeights())
    network = load_network(options.weights or "vgg16-original", "--weights").to(device)
    if published and network.name != "VGG-16":
        warn(f"--preset published: its loss weights suit the features of VGG-16, not those of {network.name}")
    style = Style(
        network,
        painting,
        options.size,
        layers=options.layers,
        weights=weights,
        painting_scale=options.painting_scale,
        relative=not published,
    )
    return run_edit(options, mesh, colored, style, _PRESETS[options.preset], weights)
