"""The visible face of each pixel: the discrete half of rasterisation, without a gradient."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.
import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import MANY_PIXELS, pixel_tasks
from ..warp.memory import empty, zeros
from ..warp.native import Kernels
from ..warp.registration import fake, operator
from .draw import Drawing, DrawingKernels
from .visible_faces import keep_mask

# One module with `downsample`, which every image needs as well: two modules would take longer to compile.
KERNELS = Kernels(__name__, "coverage.h", fused=False)
NEAREST = DrawingKernels(KERNELS, "draw")
_Silhouette = KERNELS.struct("Silhouette")
_cover_pixels = KERNELS.kernel("cover_pixels", _Silhouette)


@operator
def coverage(
    faces: Tensor,
    height: int,
    width: int,
    near: float,
    far: float,
    two_sided: bool,
    perspective: bool,
    marked: bool = False,
    below: int = 0,
    above: int = 0,
) -> Tensor:
    """Find the visible face of each pixel: the nearest one at its centre, or at equal depth the one of lowest index.

    A pixel centre on an edge is inside. Faces with a corner that is not finite or beyond 1e12 are not drawn.

    Args:
        faces: Screen-space corners ``(x, y, z)``, [B, F, 3, 3] float32; see `raster/kernels/geometry.h`.
        near, far: Faces are drawn at pixels where ``near < z < far``, in world units.
        two_sided: Whether faces whose corners run clockwise on the screen are drawn.
        perspective: Whether depth is ``1 / sum(w_k / z_k)``; else ``sum(w_k z_k)``.
        below, above: Rows of the whole image below and above this strip, whose pixels are those of the whole image to
            the bit.
        marked: Whether to compute the mask of `visible_faces` now, because backward will need it.

    Returns:
        [B, height, width] int32, row 0 at the top; -1 where no face is visible.
    """
    batch, count = faces.shape[:2]
    face_index = empty((batch, height, width), faces.device, torch.int32)
    visible = None
    if marked and not face_index.is_inference():
        visible = zeros((batch, count + 1), faces.device, torch.int32)
        keep_mask(face_index, visible)
    NEAREST.draw(faces, face_index, Drawing(near, far, two_sided, perspective, below, above), visible=visible)
    return face_index


@operator
def silhouette(face_index: Tensor, halved: bool = False) -> Tensor:
    """Convert ``face_index`` [B, H, W] int32 to a mask [B, 1, H, W] float32: 1 where a face is visible, else 0.

    If ``halved``, return the means of its blocks of 2 x 2 pixels, [B, 1, H / 2, W / 2].
    """
    batch, height, width = face_index.shape
    scale = 2 if halved else 1
    alpha = empty((batch, 1, height // scale, width // scale), face_index.device)
    rows, columns = batch * alpha.shape[2], alpha.shape[3]
    tasks, each = pixel_tasks(rows, columns, face_index.device)
    call = _Silhouette(face_index=face_index, width=columns, rows=rows, halved=halved, each=each, alpha=alpha)
    launch(_cover_pixels, tasks, [call], face_index.device, MANY_PIXELS // max(each * width, 1))
    return alpha


@fake(silhouette)
def _(face_index: Tensor, halved: bool) -> Tensor:
    batch, height, width = face_index.shape
    scale = 2 if halved else 1
    return face_index.new_empty((batch, 1, height // scale, width // scale), dtype=torch.float32)


@fake(coverage)
def _(faces: Tensor, height: int, width: int) -> Tensor:
    return faces.new_empty((faces.shape[0], height, width), dtype=torch.int32)
