"""The visible face of each pixel: the discrete half of rasterisation, without a gradient."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import facing, homogeneous_weights, in_front, pixel_box, pixel_centre
from ..warp.launch import array, launch
from ..warp.layout import MANY_PIXELS, PIXELS_OF_TASK, concurrent, cpu_bands, pixel_tasks, worth_a_thread
from ..warp.registration import operator
from .draw_face import clear_rows, draw_into_keys, draw_into_rows, turn_rows

# Without fused multiply-adds the edge functions of a -> b and b -> a have exactly opposite signs at every pixel:
# adjacent faces leave no gap, and the CPU and CUDA agree to the bit.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

EMPTY = wp.constant(0x7FFFFFFF_FFFFFFFF)


@operator
def coverage(
    faces: Tensor, height: int, width: int, near: float, far: float, two_sided: bool, perspective: bool
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

    Returns:
        [B, height, width] int32, row 0 at the top; -1 where no face is visible.
    """
    batch, count = faces.shape[:2]
    face_index = torch.empty((batch, height, width), dtype=torch.int32, device=faces.device)
    options = [near, far, int(two_sided), int(perspective)]
    if concurrent(faces.device):
        # A few threads share the rows of a face; more threads if faces are few and large.
        key = torch.full((batch, height, width), EMPTY, dtype=torch.int64, device=faces.device)
        pixels = 8 * height * width // max(count, 1)
        lanes = max(1, min(height, 1 << (max(1, pixels) // width).bit_length()))
        launch(_draw, batch * count * lanes, [array(faces, wp.vec3), array(key), lanes, *options], faces.device)
        tasks, each = pixel_tasks(batch * height, width, faces.device)
        launch(_decode, tasks, [array(key), array(face_index), count, each], faces.device)
        return face_index
    # One task per image, or per band of its rows, draws all faces in order.
    bands = min(height, cpu_bands(batch, height * width + 32 * count))
    nearest = torch.empty((batch, height, width), dtype=torch.float32, device=faces.device)
    maps = [array(nearest), array(face_index)]
    least = worth_a_thread(height * width / max(bands, 1) + 32 * count)
    launch(_draw_band, batch * bands, [array(faces, wp.vec3), *maps, bands, *options], faces.device, least)
    return face_index


@operator
def silhouette(face_index: Tensor) -> Tensor:
    """Convert ``face_index`` [B, H, W] int32 to a mask, [B, 1, H, W] float32: 1 where a face is visible, else 0."""
    batch, height, width = face_index.shape
    alpha = torch.empty((batch, 1, height, width), dtype=torch.float32, device=face_index.device)
    tasks, each = pixel_tasks(batch * height, width, face_index.device)
    many = MANY_PIXELS // max(each * width, 1)
    launch(_cover, tasks, [array(face_index), array(alpha), each], face_index.device, many)
    return alpha


@torch.library.register_fake("neural_renderer::silhouette")
def _(face_index):  # type: ignore[no-untyped-def]
    batch, height, width = face_index.shape
    return face_index.new_empty((batch, 1, height, width), dtype=torch.float32)


@torch.library.register_fake("neural_renderer::coverage")
def _(faces, height, width, near, far, two_sided, perspective):  # type: ignore[no-untyped-def]
    return faces.new_empty((faces.shape[0], height, width), dtype=torch.int32)


_EACH_PIXEL = f"""
    const int width = face_index.shape[2], all = face_index.shape[0] * face_index.shape[1];
    {PIXELS_OF_TASK}
    const wp::int64 start = (wp::int64)first * width + left, stop = (wp::int64)(last - 1) * width + right;
    for (wp::int64 i = start; i < stop; ++i) {{ DO }}
"""
_DECODE = """
    const unsigned index = (unsigned)key.data[i];
    face_index.data[i] = key.data[i] == empty ? -1 : (int)(index < (unsigned)count ? index : index - count);
"""


@wp.func_native(_EACH_PIXEL.replace("DO", _DECODE))
def decode(
    key: wp.array3d(dtype=wp.int64),
    face_index: wp.array3d(dtype=wp.int32),
    task: int,
    each: int,
    count: int,
    empty: wp.int64,
):
    """Convert the nearest keys of the pixels of a task to face indices."""
    ...


@wp.func
def crossing_depth(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, i: int, j: int, height: int, width: int) -> float:
    """Compute the depth at a pixel of a face that crosses the camera's plane; 0 outside the face."""
    a = homogeneous_weights(v0, v1, v2, pixel_centre(i, width), pixel_centre(j, height))
    if a[0] >= wp.float64(0.0) and a[1] >= wp.float64(0.0) and a[2] >= wp.float64(0.0):
        return float(wp.float64(1.0) / (a[0] + a[1] + a[2]))
    return 0.0


_NEXT_CANDIDATE = """
    const wp::int64 count = faces.shape[1];
    for (; f < count; ++f) {
        const wp::vec_t<3, float>* v = faces.data + (b * count + f) * 3;
        const float x0 = v[0][0], x1 = v[1][0], x2 = v[2][0], y0 = v[0][1], y1 = v[1][1], y2 = v[2][1];
        const float z0 = v[0][2], z1 = v[1][2], z2 = v[2][2];
        if (perspective && !((z0 > 0.0f) & (z1 > 0.0f) & (z2 > 0.0f))) break;
        const bool below = (y0 < low) & (y1 < low) & (y2 < low), above = (y0 > high) & (y1 > high) & (y2 > high);
        const bool close = (z0 <= near) & (z1 <= near) & (z2 <= near), away = (z0 >= far) & (z1 >= far) & (z2 >= far);
        const float left = (y2 - y0) * (x1 - x0), right = (y1 - y0) * (x2 - x0);
        if (!(below | above | close | away) & (two_sided ? left != right : left > right)) break;
    }
    return f;
"""


@wp.func_native(_NEXT_CANDIDATE)
def next_candidate(
    faces: wp.array3d(dtype=wp.vec3),
    b: int,
    f: int,
    low: float,
    high: float,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
) -> int:
    """Find the first face from f on that may be drawn (see `drawn_face`); return the number of faces if none."""
    ...


@wp.func
def drawn_face(
    faces: wp.array3d(dtype=wp.vec3),
    b: int,
    f: int,
    low: float,
    high: float,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
):
    """Classify a face (see `in_front`; -1 if it is not drawn between two heights) and orient it counter-clockwise.

    Returns the class, the index (plus the number of faces for a back side) and the three corners.
    """
    v0 = faces[b, f, 0]
    v1 = faces[b, f, 1]
    v2 = faces[b, f, 2]
    index = int(f)
    front = in_front(v0, v1, v2, perspective)
    if front == 1:
        # Most faces are skipped here: above, below, too near or too far.
        if wp.max(v0[1], wp.max(v1[1], v2[1])) < low or wp.min(v0[1], wp.min(v1[1], v2[1])) > high:
            front = -1
        if wp.max(v0[2], wp.max(v1[2], v2[2])) <= near or wp.min(v0[2], wp.min(v1[2], v2[2])) >= far:
            front = -1
    if front >= 0:
        side = facing(v0, v1, v2, perspective)
        if side == 0 or (side < 0 and two_sided == 0):
            front = -1
        if side < 0:
            # The first packages append reversed copies after all faces. Ties are decided in the same order here: if a
            # file contains a face twice, once reversed, both have the same depth to the last bit.
            index = f + faces.shape[1]
            v0, v2 = v2, v0
    return front, index, v0, v1, v2


@wp.func
def depth_terms(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, perspective: int):
    """Compute the vectors n and d of the depth (e . n) / (e . d) for edge functions e."""
    n = wp.vec3(v0[2], v1[2], v2[2])
    d = wp.vec3(1.0, 1.0, 1.0)
    if perspective == 1:
        n = wp.vec3(1.0, 1.0, 1.0)
        d = wp.vec3(1.0 / v0[2], 1.0 / v1[2], 1.0 / v2[2])
    return n, d


@wp.kernel
def _draw(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    key: wp.array3d(dtype=wp.int64),
    lanes: int,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
):
    """Draw every n-th row of one face, on CUDA."""
    task = first + wp.tid()
    lane = task % lanes
    b = (task // lanes) // faces.shape[1]
    f = (task // lanes) % faces.shape[1]
    height = key.shape[1]
    width = key.shape[2]
    front, index, v0, v1, v2 = drawn_face(faces, b, f, -1.0, 1.0, near, far, two_sided, perspective)
    if front < 0:
        return
    box = pixel_box(v0, v1, v2, front, height, width)
    if front == 1:
        if box[0] <= box[1]:
            n, d = depth_terms(v0, v1, v2, perspective)
            draw_into_keys(
                key, b, index, v0, v1, v2, n, d, near, far, height, width, box[0], box[1], box[2] + lane, box[3], lanes
            )
        return
    for j in range(box[2] + lane, box[3] + 1, lanes):
        for i in range(width):
            z = crossing_depth(v0, v1, v2, i, j, height, width)
            if z > near and z < far:
                candidate = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(index)
                wp.atomic_min(key, b, height - 1 - j, i, candidate)


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


@wp.kernel
def _decode(first: int, key: wp.array3d(dtype=wp.int64), face_index: wp.array3d(dtype=wp.int32), count: int, each: int):
    decode(key, face_index, first + wp.tid(), each, count, wp.int64(EMPTY))


@wp.func_native(_EACH_PIXEL.replace("DO", "alpha.data[i] = face_index.data[i] >= 0 ? 1.0f : 0.0f;"))
def cover(face_index: wp.array3d(dtype=wp.int32), alpha: wp.array4d(dtype=float), task: int, each: int):
    """Fill the pixels of a task of the mask."""
    ...


@wp.kernel
def _cover(first: int, face_index: wp.array3d(dtype=wp.int32), alpha: wp.array4d(dtype=float), each: int):
    cover(face_index, alpha, first + wp.tid(), each)
