"""Depth peeling: the nearest faces of each pixel in order of depth (Everitt, "Interactive order-independent
transparency", 2001).

Each layer is drawn as in `coverage`, with only what lies behind the layer before. A module of its own, so that nothing
of it is compiled for those who draw one layer.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import pixel_box, pixel_centre
from ..warp.launch import array, launch, module_for_cuda, no_array
from ..warp.layout import concurrent, cpu_bands, face_lanes, pixel_tasks, readable, worth_a_thread
from ..warp.registration import operator
from .draw_concurrently import EMPTY, decode_keys
from .draw_face import clear_rows, draw_behind_keys, draw_behind_rows, turn_rows
from .drawn_faces import crossing_depth, depth_terms, drawn_face, next_candidate

# As in `coverage`, so that the first layer agrees with it to the bit.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# A layer begins behind this multiple of the depth of the one before, 64 roundings of float32. So a centre on the edge
# of two adjacent faces, whose depths differ by rounding, counts once; and so do two faces in the same place.
_BEHIND = 1 + 2.0**-17


@operator
def peel(
    faces: Tensor, height: int, width: int, near: float, far: float, two_sided: bool, perspective: bool, layers: int
) -> Tensor:
    """Find the nearest faces of each pixel. Faces nearer to each other than 1e-5 of their depth count as one.

    Args:
        faces, height, width, near, far, two_sided, perspective: As in `coverage`.
        layers: Number of layers.

    Returns:
        [layers, B, height, width] int32, from front to back; the first is that of `coverage`. −1 where there is no
        further face.
    """
    batch = len(faces)
    result = torch.full((layers, batch, height, width), -1, dtype=torch.int32, device=faces.device)
    floor = torch.full((batch, height, width), near, dtype=torch.float32, device=faces.device)
    for index in result:
        floor = _draw_behind(faces, index, floor, near, far, [int(two_sided), int(perspective)]) * _BEHIND
        if readable(faces.device) and not bool((index >= 0).any()):
            break
    return result


@torch.library.register_fake("neural_renderer::peel")
def _(faces, height, width, near, far, two_sided, perspective, layers):
    return faces.new_empty((layers, faces.shape[0], height, width), dtype=torch.int32)


def _draw_behind(faces: Tensor, index: Tensor, floor: Tensor, near: float, far: float, sides: list[int]) -> Tensor:
    """Draw the nearest faces behind the depths ``floor`` into ``index`` [B, H, W]; return their depths.

    A pixel without a face has the depth far, or NaN on CUDA: nothing lies behind it.
    """
    batch, height, width = index.shape
    count = faces.shape[1]
    corners = array(faces, wp.vec3)
    if concurrent(faces.device):
        key = torch.full(index.shape, int(EMPTY), dtype=torch.int64, device=faces.device)
        lanes = face_lanes(faces, height * width)
        arguments = [corners, array(key), array(floor), near, far, *sides, lanes]
        launch(_peel_face, batch * count * lanes, arguments, faces.device)
        tasks, each = pixel_tasks(batch * height, width, faces.device)
        launch(decode_keys, tasks, [array(key), array(index), no_array(2, faces.device), count, each], faces.device)
        return (key >> 32).int().view(torch.float32)
    bands = min(height, cpu_bands(batch, height * width + 32 * count))
    nearest = torch.empty_like(floor)
    least = worth_a_thread(height * width / max(bands, 1) + 32 * count)
    arguments = [corners, array(nearest), array(index), array(floor), bands, near, far, *sides]
    launch(_peel_band, batch * bands, arguments, faces.device, least)
    return nearest


@wp.kernel
def _peel_band(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    nearest: wp.array3d(dtype=float),
    face_index: wp.array3d(dtype=int),
    floor_depth: wp.array3d(dtype=float),
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
                for j in range(from_row, to_row + 1):
                    row = height - 1 - j
                    for i in range(width):
                        z = crossing_depth(v0, v1, v2, i, j, height, width)
                        closest = nearest[b, row, i]
                        wins = z < closest or (z == closest and index < face_index[b, row, i])
                        if z > floor_depth[b, row, i] and wins:
                            nearest[b, row, i] = z
                            face_index[b, row, i] = index
            elif box[0] <= box[1]:
                n, d = depth_terms(v0, v1, v2, perspective)
                draw_behind_rows(
                    nearest, face_index, floor_depth, b, index, v0, v1, v2, n, d, height, width, box[0], box[1],
                    from_row, to_row,
                )  # fmt: skip
        f = next_candidate(faces, b, f + 1, low, high, near, far, two_sided, perspective)
    if two_sided == 1:
        turn_rows(face_index, b, height - 1 - top, height - bottom, faces.shape[1])


@wp.kernel(module=module_for_cuda(__name__))
def _peel_face(
    first: int,
    faces: wp.array3d(dtype=wp.vec3),
    key: wp.array3d(dtype=wp.int64),
    floor_depth: wp.array3d(dtype=float),
    near: float,
    far: float,
    two_sided: int,
    perspective: int,
    lanes: int,
):
    """Draw one face of one image, or with several lanes every n-th row of it, on CUDA."""
    task = first + wp.tid()
    lane = task % lanes
    b = (task // lanes) // faces.shape[1]
    f = (task // lanes) % faces.shape[1]
    front, index, v0, v1, v2 = drawn_face(faces, b, f, -1.0, 1.0, near, far, two_sided, perspective)
    if front < 0:
        return
    height = key.shape[1]
    width = key.shape[2]
    box = pixel_box(v0, v1, v2, front, height, width)
    n, d = depth_terms(v0, v1, v2, perspective)
    for j in range(box[2] + lane, box[3] + 1, lanes):
        if front == 1:
            draw_behind_keys(key, floor_depth, b, index, v0, v1, v2, n, d, far, height, width, box[0], box[1], j, j)
        else:
            for i in range(box[0], box[1] + 1):
                z = crossing_depth(v0, v1, v2, i, j, height, width)
                if z > floor_depth[b, height - 1 - j, i] and z < far:
                    candidate = (wp.int64(wp.cast(z, wp.int32)) << wp.int64(32)) | wp.int64(index)
                    wp.atomic_min(key, b, height - 1 - j, i, candidate)
