"""Float64 reference of the gradient where faces intersect; the maths is in `raster/visibility/intersections.py`."""

from __future__ import annotations

import torch
from torch import Tensor

from neural_renderer.raster.reference.operators import degenerate, pixel_centres

LEAST_CHORD = 0.02  # of the probability that a pair of pixels shows an intersection


def intersections_reference(
    grad: Tensor, image: Tensor, face_index: Tensor, corners: Tensor, axis: int, perspective: bool
) -> Tensor:
    """Compute the gradient [F, 3, 3] of one image's lines of equal depth, by their motion along ``axis``."""
    height, width = face_index.shape
    x, y = pixel_centres(height, width)

    def pair(values: Tensor) -> tuple[Tensor, Tensor]:
        """Pair the values [..., H, W] of each pixel with the values of the next pixel to the right, or above."""
        return (values[..., 1:, :], values[..., :-1, :]) if axis else (values[..., :-1], values[..., 1:])

    # Pairs of pixels that show two faces wholly in front. Faces with a common edge meet there and do not intersect.
    f, g = (index.long() for index in pair(face_index))
    equal = (corners[f][..., :, None, :] == corners[g][..., None, :, :]).all(-1)
    one_surface = equal.sum((-2, -1)) >= 2
    front = ((corners[..., 2] > 0).all(-1) | (not perspective)) & ~degenerate(corners)
    chosen = (f >= 0) & (g >= 0) & (f != g) & ~one_surface & front[f] & front[g]
    f, g = f[chosen], g[chosen]
    (x, next_x), (y, next_y) = ((a[chosen], b[chosen]) for a, b in (pair(x), pair(y)))
    own, other = (m[:, chosen] for m in pair(image))
    pulls = [m[:, chosen] for m in pair(grad)]

    leaf = corners.clone().requires_grad_()

    def lead(at_x: Tensor, at_y: Tensor) -> Tensor:
        """Compute the nearness of f minus the nearness of g."""
        return _nearness(leaf[f], at_x, at_y, perspective) - _nearness(leaf[g], at_x, at_y, perspective)

    here, there = lead(x, y).detach(), lead(next_x, next_y).detach()
    # Rows and columns are weighted by the squares of the components of the line's normal, in pixels.
    normal = torch.stack((lead(x + 2 / width, y), lead(x, y + 2 / height))).detach() - here
    share = normal[axis] ** 2 / (normal**2).sum(0)
    t = here / (here - there)
    cut_x, cut_y = x + t * (next_x - x), y + t * (next_y - y)
    # And by the inverse of the probability that a pair of pixels, over sub-pixel shifts, shows both faces.
    sampled = torch.zeros_like(t)
    for k, pixel in enumerate((2 / width, 2 / height)):
        way = torch.where(normal[k] < 0, -pixel, pixel)
        ways = (way, 0 * way) if k == 0 else (0 * way, way)
        seen = [_extent(corners[face], cut_x, cut_y, *(n * w for w in ways)) for face, n in ((f, 1), (g, -1))]
        sampled += normal[k] ** 2 / (normal**2).sum(0) * (seen[0] + seen[1] - 1).clamp(min=0)
    share = share / sampled.clamp(min=LEAST_CHORD)
    gain = ((own - other) * torch.where(t < 0.5, pulls[0], pulls[1])).sum(0)
    # If the lead of f grows, the line moves towards g, by the growth over the decrease of the lead between the pixels.
    amount = share * gain / (here - there)
    place, last = ((cut_y + 1) * height / 2 - 0.5, height - 1) if axis else ((cut_x + 1) * width / 2 - 0.5, width - 1)
    amount = torch.where((place < 0.5) | (place > last - 0.5), 2 * amount, amount)  # border: see `_move_edge`

    # The line of equal depth must lie between the two centres and in both faces. Faces in one plane do not intersect:
    # their leads are rounding errors.
    least = 1e-12 * _nearness(corners[f], x, y, perspective).abs()
    valid = (here > least) & (there < -least)
    f, g = f[valid], g[valid]
    cut_x, cut_y, amount = cut_x[valid], cut_y[valid], amount[valid]
    both = [(_weights(corners[face], cut_x, cut_y) >= 0).all(-1) for face in (f, g)]
    loss = (torch.where(both[0] & both[1], amount, 0.0) * lead(cut_x, cut_y)).sum()
    return torch.autograd.grad(loss, leaf)[0]


def _weights(faces: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Compute the screen-space barycentric weights [N, 3] of (x, y) in the faces [N, 3, 3]."""
    columns = torch.cat((faces[..., :2], torch.ones_like(faces[..., :1])), -1).mT
    return torch.linalg.solve(columns, torch.stack((x, y, torch.ones_like(x)), -1))


def _extent(faces: Tensor, x: Tensor, y: Tensor, way_x: Tensor, way_y: Tensor) -> Tensor:
    """Compute the share of the way from (x, y) that lies in the faces, [N]."""
    here, there = _weights(faces, x, y), _weights(faces, x + way_x, y + way_y)
    return torch.where(there < 0, here / (here - there), 1.0).amin(-1).clamp(0, 1)


def _nearness(faces: Tensor, x: Tensor, y: Tensor, perspective: bool) -> Tensor:
    """Compute the nearness [N] of the faces' planes [N, 3, 3] at (x, y)."""
    depth = faces[..., 2]
    return (_weights(faces, x, y) * (1 / depth if perspective else -depth)).sum(-1)
