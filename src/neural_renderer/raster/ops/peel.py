"""Depth peeling: the nearest faces of each pixel in order of depth (Everitt, "Interactive order-independent
transparency", 2001).

Each layer is drawn as in `coverage`, behind the previous layer. The kernels have their own module, so that drawing one
layer does not compile them.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.
import torch
from torch import Tensor

from ..warp.layout import readable
from ..warp.native import Kernels
from ..warp.registration import fake, operator
from .draw import Drawing, DrawingKernels, depth_of

BEHIND_LAYER = DrawingKernels(Kernels(__name__, "draw.h", fused=False), "peel")

# A layer begins behind the previous layer's depth times this factor, 64 float32 roundings. So a centre on the common
# edge of two faces, whose depths differ by rounding, counts once, and so do coincident faces.
_BEHIND = 1 + 2.0**-17


@operator
def peel(
    faces: Tensor, height: int, width: int, near: float, far: float, two_sided: bool, perspective: bool, layers: int
) -> Tensor:
    """Find the nearest faces of each pixel. Faces nearer to each other than 1e-5 of their depth count as one.

    Returns [layers, B, height, width] int32, from front to back; the first is that of `coverage`, as are the arguments.
    −1 where there is no further face.
    """
    batch = len(faces)
    result = torch.full((layers, batch, height, width), -1, dtype=torch.int32, device=faces.device)
    floor = torch.full((batch, height, width), near, dtype=torch.float32, device=faces.device)
    options = Drawing(near, far, two_sided, perspective)
    for index in result:
        floor = draw_behind(faces, index, options, floor, _BEHIND)
        if readable(faces.device) and not bool((index >= 0).any()):
            break
    return result


def draw_behind(faces: Tensor, face_index: Tensor, options: Drawing, floor: Tensor, step: float) -> Tensor:
    """Draw faces behind a depth of each pixel, and return the depth where the next layer begins.

    Faces and options are as in `coverage`; ``face_index`` and ``floor`` are [B, H, W]. The next layer begins at
    ``step`` times the drawn depth.
    """
    return depth_of(BEHIND_LAYER.draw(faces, face_index, options, floor)) * step


@fake(peel)
def _(faces: Tensor, height: int, width: int, layers: int) -> Tensor:
    return faces.new_empty((layers, faces.shape[0], height, width), dtype=torch.int32)
