"""Masks of visible faces. All other faces, often more than half, have no gradient and are skipped."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
from typing import cast

import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import Int4, in_front, pixel_box
from ..warp.launch import array, launch, stream_of
from ..warp.layout import MANY_PIXELS, PIXELS_OF_TASK, pixel_tasks
from ..warp.memory import zeros
from ..warp.native import Call, struct

wp.set_module_options({"enable_backward": False})

_ALONG = "along"  # instead of the stream on which a mask was written


_Scene = struct("geometry.h", "Scene")


def scene_of(faces: Tensor, face_index: Tensor, perspective: bool = False) -> Call:
    """Make the `Scene` of kernels: corners [B, F, 3, 3] float32, and the visible face of each pixel [B, H, W] int32."""
    images, height, width = face_index.shape
    return _Scene(
        faces=faces.contiguous(),
        face_index=face_index.contiguous(),
        images=images,
        count=faces.shape[1],
        height=height,
        width=width,
        perspective=int(perspective),
    )


def visible_faces(face_index: Tensor, count: int) -> Tensor:
    """Mark the visible faces. The tensor keeps its mask, which several operators of a backward pass need.

    Args:
        face_index: Visible face of each pixel, [B, H, W] int32, as from `coverage`.
        count: Number of faces F.

    Returns:
        [B, F + 1] int32: 1 for each visible face, else 0. The last entry stands for pixels without a face.
    """
    if face_index.is_inference():
        return _visible_faces(face_index, count)
    stream = stream_of(face_index.device)
    state, made, mask = face_index.__dict__.get("_mask", (None, None, None))
    if mask is not None and state == _state(face_index) and mask.shape[1] == count + 1:
        if made == _ALONG or (made == stream and stream is not None):
            return cast("Tensor", mask)
    mask = _visible_faces(face_index, count)
    if stream is not None:
        face_index.__dict__["_mask"] = (_state(face_index), stream, mask)
    return mask


def keep_mask(face_index: Tensor, mask: Tensor) -> None:
    """Keep a mask that is written together with ``face_index``: where this one can be read, so can the mask."""
    face_index.__dict__["_mask"] = (_state(face_index), _ALONG, mask)


def _state(face_index: Tensor) -> tuple[int, int]:
    """Return what differs if a tensor has been changed in place, or is a copy, which takes the mask along."""
    return face_index.data_ptr(), face_index._version


def _visible_faces(face_index: Tensor, count: int) -> Tensor:
    visible = zeros((len(face_index), count + 1), face_index.device, torch.int32)
    batch, height, width = face_index.shape
    tasks, each = pixel_tasks(batch * height, width, face_index.device)
    many = MANY_PIXELS // max(each * width, 1)
    launch(_mark, tasks, [array(face_index), array(visible), each], face_index.device, many)
    return visible


_MARK = f"""
    const int height = face_index.shape[1], width = face_index.shape[2], all = face_index.shape[0] * height;
    const int entries = visible.shape[1], none = entries - 1;
    {PIXELS_OF_TASK}
    for (int row = first; row < last; ++row) {{
        const int* shown = face_index.data + (wp::int64)row * width;
        int* own = visible.data + (wp::int64)(row / height) * entries;
        // Written without a test: faces of neighbouring pixels differ too often for a predictable branch.
        for (int i = left; i < right; ++i) own[shown[i] < 0 ? none : shown[i]] = 1;
    }}
"""


@wp.func_native(_MARK)
def mark(face_index: wp.array3d(dtype=int), visible: wp.array2d(dtype=int), task: int, each: int):
    """Mark the faces of the pixels of a task. In plain C++ for its speed."""
    ...


@wp.kernel
def _mark(first: int, face_index: wp.array3d(dtype=int), visible: wp.array2d(dtype=int), each: int):
    """Mark the faces of the pixels of a task. Several tasks may write to one place, but all write 1."""
    mark(face_index, visible, first + wp.tid(), each)


_END_OF_RUN = """
    const int* shown = face_index.data + row * face_index.shape[2];
    const int f = shown[i];
    while (i < end && shown[i] == f) ++i;
    return i;
"""


@wp.func_native(_END_OF_RUN)
def end_of_run(face_index: wp.array3d(dtype=int), row: wp.int64, i: int, end: int) -> int:
    """Find the first pixel after i in [i, end) of a row, counted over all images, that shows another face, or end."""
    ...


@wp.func
def pixels_of_run(face_index: wp.array3d(dtype=int), task: int, run: int):
    """Find the pixels of a task of `run_tasks`: the row, counted over all images, and its pixels [first, end)."""
    width = int(face_index.shape[2])
    runs = (width + run - 1) // run
    begin = (task % runs) * run
    return task // runs, begin, wp.min(begin + run, width)


@wp.func
def pixels_of_task(task: int, each: int, width: int):
    """Find the pixels of a task of `pixel_tasks` on CUDA: the row, counted over all images, and its [first, end)."""
    row = task
    left = int(0)
    right = width
    if each == 0:
        row = task // width
        left = task % width
        right = left + 1
    return row, left, right


@wp.func
def box_of_face(
    faces: wp.array3d(dtype=wp.vec3), face_index: wp.array3d(dtype=int), b: int, f: int, perspective: int
) -> Int4:
    """Find the pixels that a face may cover, as `pixel_box`; none if it cannot be drawn."""
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    front = in_front(v0, v1, v2, perspective)
    if front < 0:
        return Int4(0, -1, 0, -1)
    return pixel_box(v0, v1, v2, front, face_index.shape[1], face_index.shape[2])


_NEXT_SHOWN = """
    const int* shown = face_index.data + row * width;
    while (i < end && shown[i] != f) ++i;
    return i;
"""


@wp.func_native(_NEXT_SHOWN)
def next_shown(face_index: wp.array3d(dtype=int), row: wp.int64, width: int, i: int, end: int, f: int) -> int:
    """Find the first pixel in [i, end) of a row, counted over all images, that shows face ``f``; ``end`` if none."""
    ...
