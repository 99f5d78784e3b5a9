"""The visible face of each pixel: the discrete half of rasterisation, without a gradient."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import pixel_box, pixel_centre
from ..warp.launch import array, launch, no_array
from ..warp.layout import MANY_PIXELS, PIXELS_OF_TASK, concurrent, cpu_bands, pixel_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.registration import operator
from .draw_concurrently import draw_concurrently
from .draw_face import clear_rows, draw_into_rows, mark_rows, turn_rows
from .drawn_faces import crossing_depth, depth_terms, drawn_face, next_candidate
from .visible_faces import keep_mask

# Without fused multiply-adds the edge functions of a -> b and b -> a have exactly opposite signs at every pixel:
# adjacent faces leave no gap, and the CPU and CUDA agree to the bit.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


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
) -> Tensor:
    """Find the visible face of each pixel: the nearest one at its centre, or at equal depth the one of lowest index.

    A pixel centre on an edge is inside. Faces with a corner that is not finite or beyond 1e12 are not drawn.

    Args:
        faces: Screen-space corners ``(x, y, z)``, [B, F, 3, 3] float32; see `raster/warp/geometry.py`.
        height: Rows of the result.
        width: Columns of the result.
        near: Faces are drawn at pixels where ``near < z < far``, in world units.
        far: See ``near``.
        two_sided: Whether faces whose corners run clockwise on the screen are drawn.
        perspective: Whether depth is ``1 / sum(w_k / z_k)``; else ``sum(w_k z_k)``.
        marked: Whether the result keeps its mask from the start, as `visible_faces` will ask for it in backward.

    Returns:
        [B, height, width] int32, row 0 at the top; -1 where no face is visible.
    """
    batch, count = faces.shape[:2]
    face_index = empty((batch, height, width), faces.device, torch.int32)
    options = [near, far, int(two_sided), int(perspective)]
    visible = no_array(2, faces.device)
    if marked and not face_index.is_inference():
        mask = zeros((batch, count + 1), faces.device, torch.int32)
        keep_mask(face_index, mask)
        visible = array(mask)
    if concurrent(faces.device):
        draw_concurrently(faces, face_index, visible, options)
        return face_index
    # One task per image, or per band of its rows, draws all faces in order.
    bands = min(height, cpu_bands(batch, height * width + 32 * count))
    nearest = empty((batch, height, width), faces.device)
    maps = [array(nearest), array(face_index)]
    least = worth_a_thread(height * width / max(bands, 1) + 32 * count)
    launch(_draw_band, batch * bands, [array(faces, wp.vec3), *maps, visible, bands, *options], faces.device, least)
    return face_index


@operator
def silhouette(face_index: Tensor, halved: bool = False) -> Tensor:
    """Convert ``face_index`` [B, H, W] int32 to a mask: 1 where a face is visible, else 0.

    Returns:
        [B, 1, H, W] float32; if ``halved``, the means of its blocks of 2 x 2 pixels, [B, 1, H / 2, W / 2].
    """
    batch, height, width = face_index.shape
    scale = 2 if halved else 1
    alpha = empty((batch, 1, height // scale, width // scale), face_index.device)
    tasks, each = pixel_tasks(batch * alpha.shape[2], alpha.shape[3], face_index.device)
    many = MANY_PIXELS // max(each * width, 1)
    launch(_cover, tasks, [array(face_index), array(alpha), int(halved), each], face_index.device, many)
    return alpha


@torch.library.register_fake("neural_renderer::silhouette")
def _(face_index, halved=False):
    batch, height, width = face_index.shape
    scale = 2 if halved else 1
    return face_index.new_empty((batch, 1, height // scale, width // scale), dtype=torch.float32)


@torch.library.register_fake("neural_renderer::coverage")
def _(faces, height, width, near, far, two_sided, perspective, marked=False):
    return faces.new_empty((faces.shape[0], height, width), dtype=torch.int32)


@wp.func
def draw_crossing_rows(
    nearest: wp.array3d(dtype=float),
    face_index: wp.array3d(dtype=int),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    near: float,
    bottom: int,
    top: int,
):
    """Draw a face that crosses the camera's plane into rows of an image, counted from the bottom, on the CPU."""
    height = face_index.shape[1]
    width = face_index.shape[2]
    for j in range(bottom, top + 1):
        row = height - 1 - j
        for i in range(width):
            z = crossing_depth(v0, v1, v2, i, j, height, width)
            closest = nearest[b, row, i]
            if z > near and (z < closest or (z == closest and index < face_index[b, row, i])):
                nearest[b, row, i] = z
                face_index[b, row, i] = index


@wp.kernel
def _draw_band(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    nearest: wp.array3d(dtype=float),
    face_index: wp.array3d(dtype=int),
    visible: wp.array2d(dtype=int),
    bands: int,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
):
    """Draw all faces into a band of rows of one image, on the CPU."""
    task = first + wp.tid()
    band = task % bands
    b = task // bands
    height = face_index.shape[1]
    width = face_index.shape[2]
    bottom = (band * height) // bands
    top = ((band + 1) * height) // bands - 1
    clear_rows(nearest, face_index, b, height - 1 - top, height - bottom, far)
    low = pixel_centre(bottom, height)
    high = pixel_centre(top, height)
    f = next_candidate(faces, b, 0, low, high, near, far, two_sided, perspective)
    while f < faces.shape[1]:
        front, index, v0, v1, v2 = drawn_face(faces, b, f, low, high, near, far, two_sided, perspective)
        if front >= 0:
            box = pixel_box(v0, v1, v2, front, height, width)
            from_row = wp.max(box[2], bottom)
            to_row = wp.min(box[3], top)
            if front == 0:
                draw_crossing_rows(nearest, face_index, b, index, v0, v1, v2, near, from_row, to_row)
            elif box[0] <= box[1]:
                n, d = depth_terms(v0, v1, v2, perspective)
                draw_into_rows(
                    nearest, face_index, b, index, v0, v1, v2, n, d, near, height, width, box[0], box[1], from_row,
                    to_row,
                )  # fmt: skip
        f = next_candidate(faces, b, f + 1, low, high, near, far, two_sided, perspective)
    if two_sided == 1:
        turn_rows(face_index, b, height - 1 - top, height - bottom, faces.shape[1])
    if visible.shape[0] > 0:  # several bands of an image may write to one place, but all write 1
        mark_rows(face_index, visible, b, height - 1 - top, height - bottom)


_COVER = f"""
    const int width = alpha.shape[3], all = alpha.shape[0] * alpha.shape[2];
    {PIXELS_OF_TASK}
    for (int row = first; row < last; ++row) {{
        float* __restrict__ to = alpha.data + (wp::int64)row * width;
        const int* __restrict__ shown = face_index.data + (wp::int64)row * width * (halved ? 4 : 1);
        const int* __restrict__ below = shown + 2 * width;
        if (!halved) {{
            for (int i = left; i < right; ++i) to[i] = shown[i] >= 0 ? 1.0f : 0.0f;
            continue;
        }}
        for (int i = left; i < right; ++i) {{
            const int first_two = (shown[2 * i] >= 0) + (shown[2 * i + 1] >= 0);
            to[i] = 0.25f * (float)(first_two + (below[2 * i] >= 0) + (below[2 * i + 1] >= 0));
        }}
    }}
"""


@wp.func_native(_COVER)
def cover(face_index: wp.array3d(dtype=wp.int32), alpha: wp.array4d(dtype=float), halved: int, task: int, each: int):
    """Fill the pixels of a task of the mask."""
    ...


@wp.kernel
def _cover(first: int, face_index: wp.array3d(dtype=wp.int32), alpha: wp.array4d(dtype=float), halved: int, each: int):
    cover(face_index, alpha, halved, first + wp.tid(), each)
