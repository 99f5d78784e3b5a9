"""`neural-renderer style`: style transfer from a painting to a mesh."""

from __future__ import annotations

from ....io import load_image
from ....io.files import warn
from ...common.command import choose_device, load_network
from .. import PUBLISHED_STYLE, Style, StyleWeights
from ..options import STYLE_PRESETS, StyleOptions
from .edit import load_initial_mesh, loss_weights, run_edit


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
    return run_edit(options, mesh, colored, style, STYLE_PRESETS[options.preset], weights)
