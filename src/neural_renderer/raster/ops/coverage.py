"""Which face is seen at each pixel: the discrete half of rasterisation (no gradient of its own)."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import facing, homogeneous_weights, in_front, pixel_box, pixel_centre
from ..warp.launch import MANY_PIXELS, array, concurrent, cpu_bands, launch
from ..warp.registration import operator

# Without fused multiply-adds an edge a -> b and its twin b -> a have exactly opposite signs at every pixel, so
# neighbours leave no gap between them, and the CPU and CUDA agree to the bit.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

EMPTY = wp.constant(wp.int64(0x7FFFFFFF_FFFFFFFF))


@operator
def coverage(
    faces: Tensor, height: int, width: int, near: float, far: float, two_sided: bool, perspective: bool
) -> Tensor:
    """The face seen at each pixel centre: the nearest one, of those at equal depth the one of lowest index.

    faces: [B, F, 3, 3] float32 corners ``(x, y, z)`` in screen space (see `geometry`).
    near, far: only what has ``near < z < far`` at the pixel is seen.
    two_sided: also draw faces whose corners run clockwise on the screen.
    perspective: depth between the corners is ``1 / sum(w_k / z_k)``; linear in the weights otherwise.

    Returns [B, height, width] int32, row 0 at the top, -1 where nothing is seen. A pixel centre on an edge is inside.
    A face with a corner that is not finite, or beyond 1e12, is not drawn.
    """
    batch, count = faces.shape[:2]
    face_index = torch.empty((batch, height, width), dtype=torch.int32, device=faces.device)
    key = torch.empty((batch, height, width), dtype=torch.int64, device=faces.device)
    all_at_once = concurrent(faces.device)
    if all_at_once:
        # One task per face, its rows shared by a few threads, more of them where faces are few and large.
        key.fill_(torch.iinfo(torch.int64).max)
        pixels = 8 * height * width // max(count, 1)
        lanes = max(1, min(height, 1 << (max(1, pixels) // width).bit_length()))
        groups, bands = count, 1
    else:
        # One task per image, or band of rows of it, which runs through all faces from first to last.
        lanes, groups, bands = 1, 1, min(height, cpu_bands(batch))
    options = [groups, bands, lanes, near, far, int(two_sided), int(perspective), int(not all_at_once)]
    maps = [array(key), array(face_index)]
    launch(_draw, batch * groups * bands * lanes, [array(faces, wp.vec3), *maps, *options], faces.device)
    if all_at_once:
        launch(_decode, batch * height, [*maps, count], faces.device)
    return face_index


@operator
def silhouette(face_index: Tensor) -> Tensor:
    """1 where a face is seen, 0 elsewhere: [B, 1, H, W] float32 of ``face_index`` [B, H, W] int32."""
    batch, height, width = face_index.shape
    many_rows = MANY_PIXELS // max(width, 1)
    alpha = torch.empty((batch, 1, height, width), dtype=torch.float32, device=face_index.device)
    launch(_cover, batch * height, [array(face_index), array(alpha)], face_index.device, many_rows)
    return alpha


@torch.library.register_fake("neural_renderer::silhouette")
def _(face_index):  # type: ignore[no-untyped-def]
    batch, height, width = face_index.shape
    return face_index.new_empty((batch, 1, height, width), dtype=torch.float32)


@torch.library.register_fake("neural_renderer::coverage")
def _(faces, height, width, near, far, two_sided, perspective):  # type: ignore[no-untyped-def]
    return faces.new_empty((faces.shape[0], height, width), dtype=torch.int32)


# Plain C++ loops are what compilers turn into vector instructions: Warp's own minimum and maximum order NaNs, pixel by
# pixel.
_DRAW_FACE = """
    const float x0 = v0[0], x1 = v1[0], x2 = v2[0], w = (float)width, h = (float)height;
    const float slope0 = v1[1] - v2[1], slope1 = v2[1] - v0[1], slope2 = v0[1] - v1[1];
    for (int j = bottom; j <= top; j += step) {
        const float y = (float)(2 * j + 1 - height) / h;
        const float y0 = v0[1] - y, y1 = v1[1] - y, y2 = v2[1] - y;
        // Where the row crosses the edges, less what rounding leaves in doubt.
        float low = -2.0f, high = 2.0f;
        const float p[3] = {x1 * y2, x2 * y0, x0 * y1}, q[3] = {x2 * y1, x0 * y2, x1 * y0};
        const float slope[3] = {slope0, slope1, slope2};
        for (int k = 0; k < 3; ++k) {
            const float steep = slope[k] < 0.0f ? -slope[k] : slope[k];
            if (steep > 1e-6f) {
                const float at = (q[k] - p[k]) / slope[k];
                const float size = (p[k] < 0.0f ? -p[k] : p[k]) + (q[k] < 0.0f ? -q[k] : q[k]);
                const float doubt = 1e-6f * size / steep;
                if (slope[k] > 0.0f) low = at - doubt > low ? at - doubt : low;
                else high = at + doubt < high ? at + doubt : high;
            }
        }
        if (!(low <= high)) continue;
        const float begin = 0.5f * (w * low + w - 1.0f) - 0.01f, end = 0.5f * (w * high + w - 1.0f) + 0.01f;
        const int first = begin > (float)left ? (int)begin + 1 : left, last = end < (float)right ? (int)end : right;
        wp::int64* row = key.data + ((wp::int64)b * height + height - 1 - j) * width;
        for (int i = first; i <= last; ++i) {
            const float x = (float)(2 * i + 1 - width) / w;
            const float e0 = (x1 - x) * y2 - y1 * (x2 - x);
            const float e1 = (x2 - x) * y0 - y2 * (x0 - x);
            const float e2 = (x0 - x) * y1 - y0 * (x1 - x);
            const float z = (e0 * n[0] + e1 * n[1] + e2 * n[2]) / (e0 * d[0] + e1 * d[1] + e2 * d[2]);
            const bool seen = (e0 >= 0.0f) & (e1 >= 0.0f) & (e2 >= 0.0f) & (z > near) & (z < far);
            union { float value; int bits; } depth;
            depth.value = z;
            // Positive floats order as their bits do: one minimum picks the nearest, then the lowest index.
            const wp::int64 candidate = seen ? ((wp::int64)depth.bits << 32) | index : 0x7fffffffffffffff;
        #if defined(__CUDA_ARCH__)
            if (candidate < row[i]) atomicMin((long long*)row + i, (long long)candidate);
        #else
            row[i] = candidate < row[i] ? candidate : row[i];
        #endif
        }
    }
"""


@wp.func_native(_DRAW_FACE)
def draw_face(
    key: wp.array3d(dtype=wp.int64),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    n: wp.vec3,
    d: wp.vec3,
    near: float,
    far: float,
    height: int,
    width: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
    step: int,
):
    """Draw a counter-clockwise face in front of the camera into some rows of its box.

    Its depth at a pixel with the edge functions e is (e . n) / (e . d).
    """
    ...


@wp.func
def empty_row(key: wp.array3d(dtype=wp.int64), b: int, row: int):
    for i in range(key.shape[2]):
        key[b, row, i] = EMPTY


_DECODE_ROW = """
    const wp::int64 first = ((wp::int64)b * key.shape[1] + row) * key.shape[2];
    const wp::int64* keys = key.data + first;
    int* shown = face_index.data + first;
    for (int i = 0; i < key.shape[2]; ++i) {
        const unsigned index = (unsigned)keys[i];
        shown[i] = keys[i] == empty ? -1 : (int)(index < (unsigned)count ? index : index - count);
    }
"""


@wp.func_native(_DECODE_ROW)
def decode_row(
    key: wp.array3d(dtype=wp.int64),
    face_index: wp.array3d(dtype=wp.int32),
    b: int,
    row: int,
    count: int,
    empty: wp.int64,
):
    """From the nearest keys of a row of pixels to the faces they show."""
    ...


@wp.func
def draw_crossing_face(
    key: wp.array3d(dtype=wp.int64),
    b: int,
    index: int,
    v0: wp.vec3,
    v1: wp.vec3,
    v2: wp.vec3,
    near: float,
    far: float,
    height: int,
    width: int,
    bottom: int,
    top: int,
    step: int,
):
    """The same for a face that crosses the camera's plane, over the whole width."""
    for j in range(bottom, top + 1, step):
        for i in range(width):
            a = homogeneous_weights(v0, v1, v2, pixel_centre(i, width), pixel_centre(j, height))
            if a[0] >= wp.float64(0.0) and a[1] >= wp.float64(0.0) and a[2] >= wp.float64(0.0):
                z = float(wp.float64(1.0) / (a[0] + a[1] + a[2]))
                if z > near and z < far:
                    candidate = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(index)
                    wp.atomic_min(key, b, height - 1 - j, i, candidate)


@wp.kernel
def _draw(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    key: wp.array3d(dtype=wp.int64),
    face_index: wp.array3d(dtype=wp.int32),
    groups: int,
    bands: int,
    lanes: int,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
    alone: int,
):
    """Some faces into some rows of one image; ``alone`` if nobody else draws there."""
    task = first + wp.tid()
    lane = task % lanes
    band = (task // lanes) % bands
    group = (task // (lanes * bands)) % groups
    b = task // (lanes * bands * groups)
    count = faces.shape[1]
    height = key.shape[1]
    width = key.shape[2]
    bottom = (band * height) // bands
    top = ((band + 1) * height) // bands - 1
    first_face = group
    last_face = group + 1
    if groups == 1:
        first_face = 0
        last_face = count
    low = pixel_centre(bottom, height)
    high = pixel_centre(top, height)
    if alone == 1:
        for row in range(height - 1 - top, height - bottom):
            empty_row(key, b, row)
    for f in range(first_face, last_face):
        v0 = faces[b, f, 0]
        v1 = faces[b, f, 1]
        v2 = faces[b, f, 2]
        front = in_front(v0, v1, v2, perspective)
        if front < 0:
            continue
        if front == 1:
            # Most faces end here: above or below the band, or too near or far.
            if wp.max(v0[1], wp.max(v1[1], v2[1])) < low or wp.min(v0[1], wp.min(v1[1], v2[1])) > high:
                continue
            if wp.max(v0[2], wp.max(v1[2], v2[2])) <= near or wp.min(v0[2], wp.min(v1[2], v2[2])) >= far:
                continue
        side = facing(v0, v1, v2, perspective)
        if side == 0 or (side < 0 and two_sided == 0):
            continue
        index = f
        if side < 0:
            # As the first packages do it, who append copies in reversed order after all faces: a face that a file holds
            # twice, once turned over, has the depth of its copy to the last bit, and ties go to the lower index.
            index = f + count
            v0, v2 = v2, v0
        # The depth is (e . n) / (e . d) for the pixel's edge functions e.
        n = wp.vec3(v0[2], v1[2], v2[2])
        d = wp.vec3(1.0, 1.0, 1.0)
        if perspective == 1:
            n = wp.vec3(1.0, 1.0, 1.0)
            d = wp.vec3(1.0 / v0[2], 1.0 / v1[2], 1.0 / v2[2])
        box = pixel_box(v0, v1, v2, front, height, width)
        from_row = wp.max(box[2], bottom) + lane
        to_row = wp.min(box[3], top)
        if front == 1:
            if box[0] <= box[1]:
                draw_face(
                    key, b, index, v0, v1, v2, n, d, near, far, height, width, box[0], box[1], from_row, to_row, lanes
                )
        else:
            draw_crossing_face(key, b, index, v0, v1, v2, near, far, height, width, from_row, to_row, lanes)
    if alone == 1:
        for row in range(height - 1 - top, height - bottom):
            decode_row(key, face_index, b, row, count, EMPTY)


@wp.kernel
def _decode(first: int, key: wp.array3d(dtype=wp.int64), face_index: wp.array3d(dtype=wp.int32), count: int):
    task = first + wp.tid()
    decode_row(key, face_index, task // key.shape[1], task % key.shape[1], count, EMPTY)


_COVER_ROW = """
    const int* shown = face_index.data + row * width;
    float* covered = alpha.data + row * width;
    for (int i = 0; i < width; ++i) covered[i] = shown[i] >= 0 ? 1.0f : 0.0f;
"""


@wp.func_native(_COVER_ROW)
def cover_row(face_index: wp.array3d(dtype=wp.int32), alpha: wp.array4d(dtype=float), row: wp.int64, width: int):
    """Of all rows of all images, this one."""
    ...


@wp.kernel
def _cover(first: int, face_index: wp.array3d(dtype=wp.int32), alpha: wp.array4d(dtype=float)):
    cover_row(face_index, alpha, wp.int64(first + wp.tid()), face_index.shape[2])
