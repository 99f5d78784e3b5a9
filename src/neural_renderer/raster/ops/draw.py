"""Drawing all faces: what `coverage` and `peel` share."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import MOST_THREADS, concurrent, cpu_bands, empty_queue, pixel_tasks, queue_of, worth_a_thread
from ..warp.memory import empty
from ..warp.native import Kernels, constant

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
    ) -> Callable[[], Tensor]:
        """Draw faces [B, F, 3, 3] float32 into ``face_index`` [B, H, W] int32.

        ``behind`` is the depth [B, H, W] float32 behind which each pixel is drawn; None for the near plane.
        ``visible``, a mask as from `visible_faces`, is written as well.

        Returns:
            Function that gives the depth [B, H, W] float32. A pixel without a face has the depth far, or NaN on CUDA:
            nothing lies behind it.
        """
        device, (batch, height, width), count = faces.device, face_index.shape, faces.shape[1]
        call = {
            "faces": faces,
            "behind": behind,
            "images": batch,
            "count": count,
            "height": height,
            "width": width,
            **options._asdict(),
            "face_index": face_index,
            "visible": visible,
        }
        if concurrent(device):
            keys = torch.full((batch, height, width), _NO_FACE, dtype=torch.int64, device=device)
            threads = min(MOST_THREADS, batch * count * height * min(width, _MOST_LANES))
            queue = queue_of(empty_queue(batch * count, device), threads)
            tasks, each = pixel_tasks(batch * height, width, device)
            drawing = _Drawing(**call, keys=keys, queue=queue, each=each)
            launch(self._or_queue, batch * count, [drawing], device)
            launch(self._queued, threads, [drawing], device)
            launch(_decode_keys, tasks, [drawing], device)
            return lambda: (keys >> 32).int().view(torch.float32)
        bands = min(height, cpu_bands(batch, height * width + 32 * count))
        nearest = empty((batch, height, width), device)
        least = worth_a_thread(height * width / max(bands, 1) + 32 * count)
        launch(self._band, batch * bands, [_Drawing(**call, bands=bands, nearest=nearest)], device, least)
        return lambda: nearest
