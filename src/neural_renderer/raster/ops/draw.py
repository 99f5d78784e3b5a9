"""Drawing all faces: what `coverage` and `peel` share."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import MOST_THREADS, concurrent, cpu_bands, empty_queue, pixel_tasks, queue_of, worth_a_thread
from ..warp.memory import empty
from ..warp.native import Call, Kernels, constant

_NO_FACE = constant("draw.h", "NO_FACE")
_MOST_LANES = constant("draw.h", "MOST_LANES")

# Without fused multiply-adds the edge functions of a -> b and b -> a have exactly opposite signs at every pixel:
# adjacent faces leave no gap, and the CPU and CUDA agree to the bit.
_KERNELS = Kernels(__name__, "draw.h", fused=False)
_Drawing = _KERNELS.struct("Drawing")
_decode_keys = _KERNELS.kernel("decode_keys", _Drawing, only_cuda=True)


class Drawing(NamedTuple):
    """The options of `coverage`, by its names."""

    near: float
    far: float
    two_sided: bool
    perspective: bool
    below: int = 0  # rows of the whole image below and above this strip of it
    above: int = 0


class DrawingKernels:
    """The kernels of a header that draw faces behind the near plane, or behind a depth of each pixel.

    Their names start with ``verb``.
    """

    def __init__(self, kernels: Kernels, verb: str) -> None:
        self._band = kernels.kernel(f"{verb}_band", _Drawing)
        self._or_queue = kernels.kernel(f"{verb}_or_queue_face", _Drawing, only_cuda=True)
        self._queued = kernels.kernel(f"{verb}_queued_faces", _Drawing, only_cuda=True)

    def draw(
        self,
        faces: Tensor,
        face_index: Tensor,
        options: Drawing,
        behind: Tensor | None = None,
        visible: Tensor | None = None,
    ) -> Tensor:
        """Draw faces [B, F, 3, 3] float32 into ``face_index`` [B, H, W] int32.

        ``behind`` is the depth [B, H, W] float32 behind which each pixel is drawn; None for the near plane.
        ``visible``, a mask as from `visible_faces`, is written as well.

        Returns:
            What `depth_of` converts to the depth of each pixel.
        """
        device, (batch, height, width), count = faces.device, face_index.shape, faces.shape[1]
        if concurrent(device):
            tasks, each = pixel_tasks(batch * height, width, device)
            fields = {"face_index": face_index, "visible": visible, "each": each}
            keys, call = self._draw_keys(faces, (batch, height, width), options, behind, **fields)
            launch(_decode_keys, tasks, [call], device)
            return keys
        bands = min(height, cpu_bands(batch, height * width + 32 * count))
        nearest = empty((batch, height, width), device)
        fields = {"face_index": face_index, "visible": visible, "bands": bands, "nearest": nearest}
        call = _drawing(faces, (batch, height, width), options, behind, **fields)
        launch(self._band, batch * bands, [call], device, worth_a_thread(height * width / max(bands, 1) + 32 * count))
        return nearest

    def draw_keys(
        self, faces: Tensor, shape: tuple[int, int, int], options: Drawing, behind: Tensor | None = None
    ) -> Tensor:
        """Draw on CUDA as `draw`, into images of a shape [B, H, W].

        Returns:
            The bits of the depth, then the index of the nearest face, [B, H, W] int64. Without a face the lower 32 bits
            are −1; of a face whose back is visible, they are its index plus F.
        """
        return self._draw_keys(faces, shape, options, behind)[0]

    def _draw_keys(
        self, faces: Tensor, shape: tuple[int, int, int], options: Drawing, behind: Tensor | None, **fields: Any
    ) -> tuple[Tensor, Call]:
        device, (batch, height, width), count = faces.device, shape, faces.shape[1]
        keys = torch.full(shape, _NO_FACE, dtype=torch.int64, device=device)
        threads = min(MOST_THREADS, batch * count * height * min(width, _MOST_LANES))
        queue = queue_of(empty_queue(batch * count, device), threads)
        call = _drawing(faces, shape, options, behind, keys=keys, queue=queue, **fields)
        launch(self._or_queue, batch * count, [call], device)
        launch(self._queued, threads, [call], device)
        return keys, call


def _drawing(
    faces: Tensor, shape: tuple[int, int, int], options: Drawing, behind: Tensor | None, **fields: Any
) -> Call:
    images, height, width = shape
    size = {"images": images, "count": faces.shape[1], "height": height, "width": width}
    return _Drawing(faces=faces, behind=behind, **size, **options._asdict(), **fields)


def depth_of(drawn: Tensor) -> Tensor:
    """Return the depth [B, H, W] float32 of what `DrawingKernels.draw` returned.

    A pixel without a face has the depth far, or NaN on CUDA: nothing lies behind it.
    """
    return drawn if drawn.dtype == torch.float32 else (drawn >> 32).int().view(torch.float32)
