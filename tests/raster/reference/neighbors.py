"""Float64 reference of `neighbors`, and which faces can be drawn."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from neural_renderer.raster.reference.operators import in_camera_space


def neighbors_reference(faces: Tensor, two_sided: bool, perspective: bool, folds: bool = False) -> Tensor:
    """Find the face across each edge, [B, F, 3] int32; see `neighbors`. Any number of faces may meet at an edge."""
    result, way = torch.full(faces.shape[:3], -1, dtype=torch.int32), 1 if folds else -1
    drawn = drawn_faces(faces, two_sided, perspective).tolist()
    for b, image in enumerate(faces.double().tolist()):
        edges = [(f, k) for f in range(len(image)) for k in range(3 if drawn[b][f] else 0)]
        # One direction along an edge for all its faces. (-0.0 equals 0.0, also in a tuple and its hash.)
        ends = [sorted(tuple(image[f][(k + n) % 3]) for n in range(2)) for f, k in edges]
        third = [[p, q, image[f][(k + 2) % 3]] for (p, q), (f, k) in zip(ends, edges, strict=True)]
        side = exact_sides(torch.tensor(third, dtype=torch.float64).view(-1, 3, 3), perspective).tolist()
        meeting: dict[tuple[Any, ...], list[int]] = {}
        for n, (p, q) in enumerate(ends):
            meeting.setdefault((p, q), []).append(n)
        for numbers in meeting.values():
            for n in numbers:
                f, k = edges[n]
                result[b, f, k] = min(
                    (edges[m][0] for m in numbers if m != n and way * side[n] * side[m] > 0), default=-1
                )
    return result.to(faces.device)


def drawn_faces(faces: Tensor, two_sided: bool, perspective: bool) -> Tensor:
    """Test which faces [B, F] can be drawn, whatever near and far are."""
    side, depth = exact_sides(faces, perspective), faces[..., 2]
    result = faces.isfinite().flatten(2).all(-1) & ((side > 0) | ((side < 0) & two_sided))
    if perspective:  # a corner on the camera's plane has no projection
        result = result & (depth > 0).any(-1) & (depth != 0).all(-1)
    return result


def exact_sides(faces: Tensor, perspective: bool) -> Tensor:
    """Compute `sides`, exactly 0 where two corners are equal."""
    faces = faces.double()
    space = in_camera_space(faces) if perspective else torch.cat((faces[..., :2], torch.ones_like(faces[..., 2:])), -1)
    p, q, r = space.unbind(-2)
    return (p * torch.linalg.cross(q - p, r - p)).sum(-1).sign()
