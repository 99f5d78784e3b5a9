"""Record of masks that were found in photographs and not corrected since, and how a fit uses them."""

from __future__ import annotations

import json
import zlib
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from ....io.atomic_write import write_file
from ...common.views.views import Views
from .masks.background import gain, predict_background
from .place import find_place

FOUND = "what stands out in all photographs together"
"""Origin of masks that were found."""
_RECORD = "found.json"
_RIM = 1 / 64  # pixels on each side of an outline that may be the other's, relative to the longer side
_WINDOW = 1 / 16  # side of the windows in which a background is compared with its photograph, in the same unit
_MOST_ERROR = 0.08  # above this mean difference in a window a background counts as unknown


def record_found(masks: Path, names: Iterable[str]) -> None:
    """Record which photographs have a mask in a folder that was found, and its checksum."""
    files = {name: masks / f"{name}.png" for name in names}
    sums = {name: zlib.crc32(file.read_bytes()) for name, file in files.items() if file.is_file()}
    write_file(masks / _RECORD, json.dumps(sums, indent=1) + "\n")


def found_masks(masks: Path) -> set[str]:
    """Read the names of the photographs whose mask in a folder is as it was found; those corrected by hand are not."""
    record = masks / _RECORD
    if not record.is_file():
        return set()
    try:
        sums = json.loads(record.read_text(encoding="utf-8"))
        files = {name: masks / f"{name}.png" for name in sums}
        return {name for name, file in files.items() if file.is_file() and zlib.crc32(file.read_bytes()) == sums[name]}
    except (ValueError, TypeError, AttributeError):
        return set()


@torch.no_grad()
def with_backgrounds(views: Views, points: Tensor, rows: Collection[int], ground: np.ndarray | None = None) -> Views:
    """Add the backgrounds of views with scenes, as the other views show them.

    A background is unknown where it differs much from its photograph beside the mask, and in views that are not among
    the ``rows``: their masks count. Points [P, 3] are those of the scene; its plane [4] is searched if it is not given.
    """
    if views.scenes is None:
        raise ValueError("views: expected scenes, got none")
    place = find_place(views.camera, points, views.size, ground)
    scenes, inside = views.scenes.movedim(1, 3).cpu().numpy(), (views.masks > 0.5).cpu().numpy()
    side = max(views.size)
    hidden = np.stack([ndimage.binary_erosion(one, iterations=_pixels(_RIM, side)) for one in inside])
    colors = predict_background(scenes, views.camera.to("cpu"), place, hidden)
    outside = ~np.stack([ndimage.binary_dilation(one, iterations=_pixels(_RIM, side)) for one in inside])
    for row, (color, scene) in enumerate(zip(colors, scenes, strict=True)):
        known = outside[row] & np.isfinite(color).all(2)
        color *= gain(color[known], scene[known])
        error = np.where(known, np.abs(color - scene).mean(2), 0.0)
        total, count = (ndimage.uniform_filter(part, _pixels(_WINDOW, side)) for part in (error, known.astype(float)))
        color[total > _MOST_ERROR * count] = np.nan
        if row not in rows:
            color[:] = np.nan
    return replace(views, backgrounds=torch.from_numpy(colors).movedim(3, 1).to(views.scenes))


def _pixels(share: float, side: int) -> int:
    return max(1, round(share * side))
