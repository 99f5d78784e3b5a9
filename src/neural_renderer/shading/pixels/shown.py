"""Compaction of the pixels that show the mesh, so that shading skips the background."""

from __future__ import annotations

import torch
from torch import Tensor

from ...raster.warp.registration import is_plain
from .planes import planar

_WHOLE = 64  # multiple of SIMD widths, so that a result does not depend on its position
_WORTH = 0.8  # largest fraction of covered pixels for which copying pays off


class ShownPixels:
    """The pixels of B images that show a face, as B images of one row; all pixels where that does not pay off.

    Rows are padded with background pixels to the length of the longest.
    """

    def __init__(self, face_index: Tensor, packs: bool = True) -> None:
        self.shape = face_index.shape
        # The number of pixels must be read, which tracing forbids and which synchronises with a GPU.
        packs = packs and face_index.is_cpu and is_plain((face_index,)) and face_index.numel() > 0
        self.index = _index(face_index.flatten(1)) if packs else None

    def pack(self, values: Tensor) -> Tensor:
        """Gather the shown pixels of values [B, H, W, C]; the result is planar, [B, 1, N, C]."""
        if self.index is None:
            return planar(values)
        rows = values.expand(*self.shape, -1).flatten(0, 2).index_select(0, self.index)
        return planar(rows.view(len(values), 1, -1, values.shape[-1]))

    def spread(self, values: Tensor) -> Tensor:
        """Scatter values [B, 1, N, C] to their pixels: [B, H, W, C], 0 where no face is visible."""
        if self.index is None:
            return values
        rows = values.reshape(-1, values.shape[-1])
        image = rows.new_zeros(self.shape.numel(), rows.shape[1])
        return image.scatter_(0, self.index[:, None].expand_as(rows), rows).view(*self.shape, -1)


def _index(face_index: Tensor) -> Tensor | None:
    """List the shown pixels of each image, padded with a background pixel, [B · N] int64; None if too many."""
    images, pixels = face_index.shape
    shown = face_index >= 0
    counts = shown.sum(1)
    most = -(-max(int(counts.max()), 1) // _WHOLE) * _WHOLE
    if most > _WORTH * pixels:
        return None
    start = torch.arange(images) * pixels
    background = start + shown.byte().argmin(1)  # exists, since N is less than the number of pixels
    index = background[:, None].repeat(1, most).flatten()
    found = shown.flatten().nonzero()[:, 0]
    before = torch.arange(images) * most - (counts.cumsum(0) - counts)
    index[torch.arange(len(found)) + before.repeat_interleave(counts)] = found
    return index
