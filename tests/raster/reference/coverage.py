"""Reference of `coverage`: the visible face of each pixel, in float64."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from neural_renderer.raster.reference.operators import (
    FacesAtPixels,
    depth_of,
    hit_faces,
    pixel_centres,
    screen_weights,
    sides,
)


def faces_at_pixels(faces: Tensor, height: int, width: int, perspective: bool) -> FacesAtPixels:
    """Evaluate the faces [F, 3, 3] of one image at all pixel centres; a face behind the camera covers none."""
    faces = faces.double()
    x, y = pixel_centres(height, width, faces.device)
    weights, inside = screen_weights(faces[:, None, None], x, y)
    depth = depth_of(weights.clamp(0, 1) / weights.clamp(0, 1).sum(-1, keepdim=True), faces[:, None, None], perspective)
    if perspective:
        behind = faces[..., 2] <= 0
        crossing = behind.any(-1) & ~behind.all(-1)
        hit = hit_faces(faces[:, None, None], x, y)
        weights = torch.where(crossing[:, None, None, None], hit.weights, weights)
        depth = torch.where(crossing[:, None, None], hit.depth, depth)
        inside = torch.where(crossing[:, None, None], hit.inside, inside & ~behind.all(-1)[:, None, None])
        # A corner on the camera's plane has no projection.
        inside = inside & ~(crossing & (faces[..., 2] == 0).any(-1))[:, None, None]
    drawable = faces.isfinite().flatten(1).all(-1) & (sides(faces, perspective) != 0)
    return FacesAtPixels(inside & drawable[:, None, None], depth, weights)


def coverage_reference(
    faces: Tensor, height: int, width: int, near: float, far: float, two_sided: bool, perspective: bool
) -> Tensor:
    """Find the visible face of each pixel, [B, H, W] int32; see `coverage`."""
    batch, count = faces.shape[:2]
    result = torch.full((batch, height, width), -1, dtype=torch.int32, device=faces.device)
    for b in range(batch if count else 0):
        found = faces_at_pixels(faces[b], height, width, perspective)
        side = sides(faces[b], perspective)[:, None, None]
        drawn = found.inside & (found.depth > near) & (found.depth < far) & ((side > 0) | two_sided)
        # The first face wins at equal depth; back sides come after all front sides. Depths are compared as float32, so
        # that faces in one plane tie.
        depth = torch.where(drawn, found.depth.float(), math.inf)
        both = torch.cat((torch.where(side > 0, depth, math.inf), torch.where(side < 0, depth, math.inf)))
        nearest = both.argmin(0)
        result[b] = torch.where(both.min(0).values < math.inf, nearest % count, -1).int()
    return result
