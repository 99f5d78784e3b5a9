"""Masks of visible faces. All other faces, often more than half, have no gradient and are skipped."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import MANY_PIXELS, array, launch, zeros

wp.set_module_options({"enable_backward": False})


def seen_faces(face_index: Tensor, count: int) -> Tensor:
    """Mark the visible faces.

    Args:
        face_index: Visible face of each pixel, [B, H, W] int32, as from `coverage`.
        count: Number of faces F.

    Returns:
        [B, F + 1] int32: 1 for each visible face, else 0. The last entry stands for pixels without a face.
    """
    seen = zeros((len(face_index), count + 1), face_index.device, torch.int32)
    batch, height, width = face_index.shape
    many_rows = MANY_PIXELS // max(width, 1)
    launch(_mark, batch * height, [array(face_index), array(seen)], face_index.device, many_rows)
    return seen


_MARK_ROW = """
    const int* shown = face_index.data + row * width;
    // Written without a test: faces of neighbouring pixels differ too often for a predictable branch.
    for (int i = 0; i < width; ++i) seen.data[first + (shown[i] < 0 ? none : shown[i])] = 1;
"""


@wp.func_native(_MARK_ROW)
def mark_row(
    face_index: wp.array3d(dtype=int),
    row: wp.int64,
    width: int,
    seen: wp.array2d(dtype=int),
    first: wp.int64,
    none: int,
):
    """Mark the faces in a row of pixels; ``first`` is the offset of its image's entries. In plain C++ for speed."""
    ...


@wp.kernel
def _mark(first: int, face_index: wp.array3d(dtype=int), seen: wp.array2d(dtype=int)):
    """Mark the faces of one row. Several tasks may write to one place, but all write 1."""
    task = first + wp.tid()
    b = task // int(face_index.shape[1])
    entries = int(seen.shape[1])
    first_entry = wp.int64(b) * wp.int64(entries)
    mark_row(face_index, wp.int64(task), face_index.shape[2], seen, first_entry, entries - 1)


_NEXT_SHOWN = """
    const int* shown = face_index.data + row * width;
    while (i < end && shown[i] != f) ++i;
    return i;
"""


@wp.func_native(_NEXT_SHOWN)
def next_shown(face_index: wp.array3d(dtype=int), row: wp.int64, width: int, i: int, end: int, f: int) -> int:
    """Find the first pixel in [i, end) of a row, counted over all images, that shows face ``f``; ``end`` if none."""
    ...
