"""Charts: pieces of a surface laid out flat in one image, by the library xatlas."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor


def load_xatlas() -> Any:
    """Import xatlas; raise ModuleNotFoundError with the command that installs it."""
    try:
        import xatlas
    except ModuleNotFoundError:
        install = "pip install 'neural-renderer[unwrap]'"
        raise ModuleNotFoundError(f"expected xatlas to be installed to make charts ({install})") from None
    return xatlas


def chart_coordinates(vertices: Tensor, faces: Tensor, size: int, gutter: int) -> Tensor:
    """Cut a surface into charts and pack them into a square.

    Args:
        vertices: [V, 3] floating.
        faces: [F, 3] integer.
        size: Side of the image in pixels, for which the gutters are chosen.
        gutter: Least pixels between two charts.

    Returns:
        Texture coordinates [F, 3, 2] float32 of the faces' corners, in [0, 1].

    Raises:
        ModuleNotFoundError: xatlas is not installed.
    """
    xatlas = load_xatlas()
    atlas = xatlas.Atlas()
    positions = vertices.detach().cpu().double().numpy()
    low = positions.min(0)
    longest = max(float((positions.max(0) - low).max()), 1e-30)
    # Scaled to a fixed size: the library takes tiny faces for degenerate.
    atlas.add_mesh(((positions - low) / longest * 100).astype(np.float32), faces.cpu().numpy().astype(np.uint32))
    options = xatlas.PackOptions()
    options.resolution, options.padding = size, gutter
    atlas.generate(xatlas.ChartOptions(), options)
    if atlas.atlas_count != 1:  # charts that do not fit went to a second image: pack again, with any side
        options.resolution, options.texels_per_unit = 0, 0.9 * atlas.texels_per_unit
        atlas.generate(xatlas.ChartOptions(), options)
    _, corners, uv = atlas[0]
    side = max(atlas.width, atlas.height)  # the image is square
    scaled = uv * np.array([atlas.width / side, atlas.height / side], dtype=np.float32)
    return torch.from_numpy(scaled[corners.astype(np.int64)]).float().to(vertices.device)
