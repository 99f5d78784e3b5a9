"""The gradient through visibility where faces intersect: the motion of the line at which their depths are equal.

The maths is told in `raster/kernels/intersections.h`.

Pitfalls. Where the visible parts of both faces together are shorter than a pixel, along the row and along the column,
the gradient is lost. Faces in one plane are skipped, because
their leads are rounding errors. So are faces that share two corners: they meet, but do not intersect. Faces that cross
the camera's plane and degenerate faces have no gradient here.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..ops.visible_faces import scene_of
from ..warp.launch import launch
from ..warp.layout import concurrent, face_tasks, in_any_order, pixel_tasks, worth_a_thread
from ..warp.memory import zeros
from ..warp.native import Call, Kernels, struct

_Pictures = struct("crossings.h", "Pictures")
_KERNELS = Kernels(__name__, "intersections.h")
_FORWARD = Kernels(__name__ + ".forward", "intersections.h")
_Intersections, _IntersectionsForward = _KERNELS.struct("Intersections"), _KERNELS.struct("IntersectionsForward")
_find_candidates = _KERNELS.kernel("find_candidates", _Intersections)
_intersect_face = _KERNELS.kernel("intersect_face", _Intersections, launch_bounds=(256, 2))
_intersect_pairs = _KERNELS.kernel("intersect_pairs", _Intersections, only_cuda=True, launch_bounds=(256, 2))
_push_pairs = _FORWARD.kernel("push_pairs", _IntersectionsForward, launch_bounds=(256, 2))


def pictures_of(image: Tensor | None, grad: Tensor, width: int) -> Call:
    """Make the `Pictures` of kernels: images ``width`` pixels wide, and the gradient to these or to halved images."""
    image = None if image is None else image.contiguous()
    grad = grad.contiguous()
    return _Pictures(image=image, grad=grad, channels=grad.shape[1], halved=int(grad.shape[3] < width))


def add_intersections(
    result: Tensor,
    grad: Tensor,
    image: Tensor,
    faces: Tensor,
    face_index: Tensor,
    adjacent: Tensor,
    perspective: bool,
    below: int = 0,
    above: int = 0,
) -> None:
    """Add the gradient of the intersections of faces to ``result``; arguments as in `edge_gradient_backward`."""
    batch, count = faces.shape[:2]
    height, width = face_index.shape[1:]
    tasks, fields = _fields(grad, image, faces, face_index, adjacent, perspective, below, above)
    fields["to_faces"] = result
    if in_any_order(faces.device):
        launch(_intersect_pairs, tasks, [_Intersections(**fields)], faces.device)
        return
    # Most faces have no neighbour that they may intersect. A cheap first pass excludes them.
    call = _Intersections(candidates=zeros((batch, count), faces.device, torch.int32), **fields)
    launch(_find_candidates, tasks, [call], faces.device, worth_a_thread(fields["each"] * width))
    launch(_intersect_face, batch * count, [call], faces.device, face_tasks(faces, height * width))


def push_intersections(
    result: Tensor,
    motion: Tensor,
    image: Tensor,
    faces: Tensor,
    face_index: Tensor,
    adjacent: Tensor,
    perspective: bool,
    below: int = 0,
    above: int = 0,
) -> None:
    """Add the change of images by motions [T, B, F, 3, 3] to ``result``; arguments as in `edge_gradient_forward`."""
    tasks, fields = _fields(result[0], image, faces, face_index, adjacent, perspective, below, above)
    shared = in_any_order(faces.device)
    if concurrent(faces.device) and not shared:  # both rows of a block of pixels in one task
        tasks, fields["each"] = -(-face_index[..., 0].numel() // 2), 2
    call = _IntersectionsForward(
        intersections=_Intersections(**fields),
        motion=motion,
        directions=len(motion),
        shared=int(shared),
        images=result,
    )
    launch(_push_pairs, tasks, [call], faces.device, worth_a_thread(fields["each"] * face_index.shape[2]))


def _fields(
    grad: Tensor,
    image: Tensor,
    faces: Tensor,
    face_index: Tensor,
    adjacent: Tensor,
    perspective: bool,
    below: int,
    above: int,
) -> tuple[int, dict[str, Any]]:
    """Return the number of tasks of pixels, and fields of `Intersections`."""
    batch, height, width = face_index.shape
    tasks, each = pixel_tasks(batch * height, width, faces.device)
    scene, pictures = scene_of(faces, face_index, perspective, below, above), pictures_of(image, grad, width)
    return tasks, {"scene": scene, "pictures": pictures, "adjacent": adjacent, "each": each}
