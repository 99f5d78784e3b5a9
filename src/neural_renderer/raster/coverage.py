"""Which face is seen at each pixel: the discrete half of rasterisation (no gradient of its own)."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from .geometry import crossing_depth, edges, facing, in_front, pixel_box, pixel_centre, row_span
from .launch import array, cpu_bands, launch

# Without fused multiply-adds an edge a -> b and its twin b -> a have exactly opposite signs at every pixel, so neighbours
# leave no gap between them, and the CPU and CUDA agree to the bit.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_EMPTY = 0x7FFFFFFF_FFFFFFFF


@torch.library.custom_op("neural_renderer::coverage", mutates_args=())
def coverage(
    faces: Tensor, height: int, width: int, near: float, far: float, two_sided: bool, perspective: bool
) -> Tensor:
    """The face seen at each pixel centre: the nearest one, of those at equal depth the one of lowest index.

    faces: [B, F, 3, 3] float32 corners ``(x, y, z)`` in screen space (see `geometry`).
    near, far: only what has ``near < z < far`` at the pixel is seen.
    two_sided: also draw faces whose corners run clockwise on the screen.
    perspective: depth between the corners is ``1 / sum(w_k / z_k)``; linear in the weights otherwise.

    Returns [B, height, width] int32, row 0 at the top, -1 where nothing is seen. A pixel centre on an edge is inside.
    A face with a non-finite corner is not drawn.
    """
    batch, count = faces.shape[:2]
    key = torch.full((batch, height, width), _EMPTY, dtype=torch.int64, device=faces.device)
    face_index = torch.empty((batch, height, width), dtype=torch.int32, device=faces.device)
    on_cuda = faces.device.type == "cuda"
    # CUDA: one task per face, its rows shared by a few threads, more of them where faces are few and large.
    # CPU: one task per image, or band of rows of it, which runs through all faces.
    lanes = max(1, min(height, 1 << (max(1, 8 * height * width // max(count, 1)) // width).bit_length())) if on_cuda else 1
    groups = count if on_cuda else 1
    bands = 1 if on_cuda else min(height, cpu_bands(batch))
    if batch * height * width and count:
        corners = array(faces.contiguous(), wp.vec3)
        arguments = [corners, array(key), groups, bands, lanes, near, far, int(two_sided), int(perspective)]
        launch(_draw, batch * groups * bands * lanes, arguments, faces.device)
    launch(_decode, batch * height, [array(key), array(face_index), count], faces.device)
    return face_index


@coverage.register_fake
def _(faces, height, width, near, far, two_sided, perspective):  # type: ignore[no-untyped-def]
    return faces.new_empty((faces.shape[0], height, width), dtype=torch.int32)


@wp.kernel
def _draw(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    key: wp.array3d(dtype=wp.int64),
    groups: int,
    bands: int,
    lanes: int,
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
):
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
        side = facing(v0, v1, v2)
        if side == 0 or (side < 0 and two_sided == 0):
            continue
        index = f
        if side < 0:
            # The first packages append the reversed copies after all faces; ties go to the lower index there.
            index = f + count
            v1, v2 = v2, v1
        # The depth is (e . n) / (e . d) for the pixel's edge functions e.
        n = wp.vec3(v0[2], v1[2], v2[2])
        d = wp.vec3(1.0, 1.0, 1.0)
        if perspective == 1:
            n = wp.vec3(1.0, 1.0, 1.0)
            d = wp.vec3(1.0 / v0[2], 1.0 / v1[2], 1.0 / v2[2])
        box = pixel_box(v0, v1, v2, front, height, width)
        for j in range(wp.max(box[2], bottom) + lane, wp.min(box[3], top) + 1, lanes):
            y = pixel_centre(j, height)
            span = wp.vec2i(box[0], box[1])
            if front == 1:
                span = row_span(v0, v1, v2, y, width, span)
            for i in range(span[0], span[1] + 1):
                x = pixel_centre(i, width)
                z = float(0.0)
                if front == 1:
                    e = edges(v0, v1, v2, x, y)
                    if wp.min(e[0], wp.min(e[1], e[2])) < 0.0:
                        continue
                    z = wp.dot(e, n) / wp.dot(e, d)
                else:
                    z = crossing_depth(v0, v1, v2, x, y)
                if z > near and z < far:
                    # Positive floats order as their bits do: one minimum picks the nearest, then the lowest index.
                    candidate = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(index)
                    row = height - 1 - j
                    if candidate < key[b, row, i]:
                        wp.atomic_min(key, b, row, i, candidate)


@wp.kernel
def _decode(first: int, key: wp.array3d(dtype=wp.int64), face_index: wp.array3d(dtype=wp.int32), count: int):
    task = first + wp.tid()
    b = task // key.shape[1]
    row = task % key.shape[1]
    for i in range(key.shape[2]):
        k = key[b, row, i]
        index = int(-1)
        if k != wp.int64(0x7FFFFFFFFFFFFFFF):
            index = int(k & wp.int64(0xFFFFFFFF))
            if index >= count:
                index -= count
        face_index[b, row, i] = index
