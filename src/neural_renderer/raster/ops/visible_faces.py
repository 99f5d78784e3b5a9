"""Masks of visible faces. All other faces, often more than half, have no gradient and are skipped."""

from typing import cast

import torch
from torch import Tensor

from ..warp.launch import launch, stream_of
from ..warp.layout import MANY_PIXELS, pixel_tasks
from ..warp.memory import zeros
from ..warp.native import Call, Kernels

_KERNELS = Kernels(__name__, "visible_faces.h")
_Scene, _Mark = _KERNELS.struct("Scene"), _KERNELS.struct("Mark")
_mark_pixels = _KERNELS.kernel("mark_pixels", _Mark)

_ALONG = "along"  # instead of the stream on which a mask was written


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
    readable = made == _ALONG or (made == stream and stream is not None)
    if mask is not None and readable and state == _state(face_index) and mask.shape[1] == count + 1:
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
    batch, height, width = face_index.shape
    visible = zeros((batch, count + 1), face_index.device, torch.int32)
    tasks, each = pixel_tasks(batch * height, width, face_index.device)
    scene = _Scene(face_index=face_index.contiguous(), images=batch, count=count, height=height, width=width)
    many = MANY_PIXELS // max(each * width, 1)
    launch(_mark_pixels, tasks, [_Mark(scene=scene, each=each, visible=visible)], face_index.device, many)
    return visible
