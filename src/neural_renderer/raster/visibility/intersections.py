"""The gradient through visibility where faces intersect: the motion of the line at which their depths are equal.

`raster/kernels/intersections.h` describes the maths.

Pitfalls. Where the visible parts of both faces together are shorter than a pixel, along the row and along the column,
the gradient is lost. Coplanar faces are skipped, because their leads are rounding errors, and so are faces that share
two corners: they meet, but do not intersect. Faces that cross the camera's plane and degenerate faces have no gradient
here.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import concurrent, face_tasks, in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import contiguous, zeros
from ..warp.native import Call, Kernels, struct

_Pictures = struct("crossings.h", "Pictures")
_KERNELS = Kernels(__name__, "intersections.h")
_FORWARD = Kernels(__name__ + ".forward", "intersections.h")
_Intersections, _IntersectionsForward = _KERNELS.struct("Intersections"), _KERNELS.struct("IntersectionsForward")
_find_candidates = _KERNELS.kernel("find_candidates", _Intersections)
_intersect_face = _KERNELS.kernel("intersect_face", _Intersections, launch_bounds=(256, 2))
_intersect_pairs = _KERNELS.kernel("intersect_pairs", _Intersections, only_cuda=True, launch_bounds=(256, 2))
_pairs_forward = _FORWARD.kernel("pairs_forward", _IntersectionsForward, launch_bounds=(256, 2))


def pictures_of(image: Tensor | None, grad: Tensor, width: int, corner_values: Tensor | None = None) -> Call:
    """Make the `Pictures` of kernels: images ``width`` pixels wide, and the gradient to these or to halved images.

    ``corner_values``, [1 or B, F, 3, K] float32, are those of the last K channels.
    """
    image = None if image is None else contiguous(image)
    grad = contiguous(grad)
    fields = {"image": image, "grad": grad, "channels": grad.shape[1], "halved": int(grad.shape[3] < width)}
    if corner_values is not None and corner_values.numel():
        owners, known = corner_values.shape[0], corner_values.shape[3]
        fields |= {"corner_values": contiguous(corner_values), "owners": owners, "known": known}
    return _Pictures(**fields)


def add_intersections(to_faces: Tensor, scene: Call, pictures: Call, adjacent: Tensor) -> None:
    """Add the gradient of the intersections of faces, [B, F, 3, 3] float32.

    ``scene`` is as from `scene_of`, ``pictures`` as from `pictures_of`, and ``adjacent`` as from `neighbors`.
    """
    device, width = to_faces.device, scene.width
    tasks, each = pixel_tasks(scene.images * scene.height, width, device)
    fields = {"scene": scene, "pictures": pictures, "adjacent": adjacent, "each": each, "to_faces": to_faces}
    if in_any_order(device):
        launch(_intersect_pairs, tasks, [_Intersections(**fields)], device)
        return
    # Most faces cannot intersect a neighbour. A cheap first pass excludes them.
    call = _Intersections(candidates=zeros(to_faces.shape[:2], device, torch.int32), **fields)
    launch(_find_candidates, tasks, [call], device, worth_a_thread(each * width))
    launch(_intersect_face, to_faces.shape[:2].numel(), [call], device, face_tasks(to_faces, scene.height * width))


def intersections_forward(images: Tensor, motion: Tensor, scene: Call, pictures: Call, adjacent: Tensor) -> None:
    """Add the change to images [T, B, C, H, W] float32, or halved ones, for motions [T, B, F, 3, 3] of corners."""
    device, rows = images.device, scene.images * scene.height
    tasks, each = pixel_tasks(rows, scene.width, device)
    atomic = in_any_order(device)
    if concurrent(device) and not atomic:  # both rows of a block of pixels in one task
        tasks, each = -(-rows // 2), 2
    call = _IntersectionsForward(
        intersections=_Intersections(scene=scene, pictures=pictures, adjacent=adjacent, each=each),
        motion=motion,
        directions=len(motion),
        atomic=int(atomic),
        images=images,
    )
    launch(_pairs_forward, tasks, [call], device, worth_a_thread(each * scene.width))
