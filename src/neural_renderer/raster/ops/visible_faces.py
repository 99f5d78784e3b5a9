"""Masks of visible faces. Hidden faces, often more than half, have no gradient and are skipped."""

from typing import NamedTuple

import torch
from torch import Tensor

from ...base import private
from ..warp.launch import launch, stream_of
from ..warp.layout import MANY_PIXELS, pixel_tasks
from ..warp.memory import zeros
from ..warp.native import Call, Kernels

_KERNELS = Kernels(__name__, "visible_faces.h")
_Scene, _Mark = _KERNELS.struct("Scene"), _KERNELS.struct("Mark")
_mark_pixels = _KERNELS.kernel("mark_pixels", _Mark)


class _Mask(NamedTuple):
    """The mask of the visible faces of a ``face_index``, which caches it as ``_mask``."""

    address: int  # address and version of the ``face_index``, to detect in-place changes and copied attributes
    version: tuple[int, ...] | None
    stream: int | None  # on which it was written; None if the launch of the ``face_index`` wrote it
    values: Tensor  # [B, F + 1] int32, as from `visible_faces`

    def is_of(self, face_index: Tensor, count: int, stream: int | None) -> bool:
        """Test whether the mask of ``count`` faces is valid for ``face_index`` and can be read on a stream."""
        same = (self.address, self.version) == (face_index.data_ptr(), private.version_of(face_index))
        return same and self.values.shape[1] == count + 1 and (self.stream is None or self.stream == stream)


def scene_of(faces: Tensor, face_index: Tensor, perspective: bool = False, below: int = 0, above: int = 0) -> Call:
    """Make the `Scene` of kernels: corners [B, F, 3, 3] float32, and the visible face of each pixel [B, H, W] int32.

    The image may be a strip of a whole one, with some rows ``below`` and ``above`` it.
    """
    images, height, width = face_index.shape
    return _Scene(
        faces=faces,
        face_index=face_index,
        images=images,
        count=faces.shape[1],
        height=height,
        width=width,
        perspective=perspective,
        below=below,
        above=above,
    )


def visible_faces(face_index: Tensor, count: int) -> Tensor:
    """Mark the visible faces among ``count``, from ``face_index`` [B, H, W] int32: [B, count + 1] int32, 1 or 0.

    The last entry is for pixels without a face. The tensor caches its mask, which several operators need.
    """
    if private.version_of(face_index) is None:
        return _visible_faces(face_index, count)
    stream = stream_of(face_index.device)
    known: _Mask | None = getattr(face_index, "_mask", None)
    if known is not None and known.is_of(face_index, count, stream):
        return known.values
    mask = _visible_faces(face_index, count)
    if stream is not None:
        _keep(face_index, stream, mask)
    return mask


def keep_mask(face_index: Tensor, mask: Tensor) -> None:
    """Attach a mask that the launch of ``face_index`` writes: it is valid on any stream where ``face_index`` is."""
    _keep(face_index, None, mask)


def _keep(face_index: Tensor, stream: int | None, mask: Tensor) -> None:
    face_index._mask = _Mask(face_index.data_ptr(), private.version_of(face_index), stream, mask)  # type: ignore[attr-defined]


def _visible_faces(face_index: Tensor, count: int) -> Tensor:
    batch, height, width = face_index.shape
    visible = zeros((batch, count + 1), face_index.device, torch.int32)
    tasks, each = pixel_tasks(batch * height, width, face_index.device)
    scene = _Scene(face_index=face_index, images=batch, count=count, height=height, width=width)
    many = MANY_PIXELS // max(each * width, 1)
    launch(_mark_pixels, tasks, [_Mark(scene=scene, each=each, visible=visible)], face_index.device, many)
    return visible
