"""Reference of `nmr_gradient`, the paper's estimator, in float64, edge by edge and pixel by pixel."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from neural_renderer.raster.reference.operators import sides

SHORTEST = 1e-9  # pixels: an edge with a smaller extent across the scan lines has no slope


def nmr_gradient_reference(
    grad: Tensor, image: Tensor, faces: Tensor, face_index: Tensor, eps: float, two_sided: bool
) -> Tensor:
    """Compute the gradient of the paper's estimator to the faces, [B, F, 3, 3] float64; see `nmr_gradient`."""
    result = torch.zeros(faces.shape, dtype=torch.float64)
    corners, side = faces.double().cpu(), sides(faces, True).cpu()
    for b in range(len(faces)):
        # Rows, from the bottom here, give the gradient to x; columns give the gradient to y.
        maps = (grad[b].double().permute(1, 2, 0), image[b].double().permute(1, 2, 0), face_index[b])
        rows = [m.detach().cpu().flip(0) for m in maps]
        columns = [m.transpose(0, 1) for m in rows]
        for f in range(faces.shape[1]):
            if not corners[b, f].isfinite().all() or not (side[b, f] > 0 or (side[b, f] < 0 and two_sided)):
                continue
            order = [0, 1, 2] if side[b, f] > 0 else [2, 1, 0]
            for k in range(3):
                p, q, r = (order[(k + n) % 3] for n in range(3))
                for axis, (pulls, colors, shown) in enumerate((rows, columns)):
                    to_p, to_q = _pull_edge(pulls, colors, shown, f, corners[b, f, [p, q, r]], axis, eps)
                    result[b, f, p, axis] += to_p
                    result[b, f, q, axis] += to_q
    return result.to(faces.device)


def _pull_edge(
    grad: Tensor, image: Tensor, shown: Tensor, f: int, corners: Tensor, axis: int, eps: float
) -> tuple[float, float]:
    """Compute the gradient that an edge p -> q of face f sends to coordinate ``axis`` of p and of q.

    Gradient and image are [lines, pixels of a line, channels], the visible faces [lines, pixels of a line]; lines are
    rows if ``axis`` is 0. Corners [3, 3] are p, q and the third one.
    """
    lines, length = shown.shape
    (pu, pv), (qu, qv), (ru, rv) = (
        ((lines * c[1 - axis] + lines - 1) / 2, (length * c[axis] + length - 1) / 2) for c in corners.tolist()
    )
    to_p = to_q = 0.0
    # An end behind the camera has no projection.
    if abs(pu - qu) < SHORTEST or corners[0, 2] <= 0 or corners[1, 2] <= 0:
        return 0.0, 0.0
    d = (-1 if pu < qu else 1) * (1 if axis == 1 else -1)
    for u in range(max(0, math.ceil(min(pu, qu))), min(lines - 1, math.floor(max(pu, qu))) + 1):
        c = pv + (qv - pv) * (u - pu) / (qu - pu)
        inner = math.floor(c) if d > 0 else math.ceil(c)
        outer = inner + d
        if not (0 <= inner < length and 0 <= outer < length):
            continue
        # Pixels from the outer one to the border pull the edge outward; the face's own pixels pull it inward.
        outward = range(outer, length if d > 0 else -1, d) if shown[u, inner] == f else range(0)
        last = 0 if d > 0 else length - 1
        if corners[2, 2] > 0:  # if the third corner is behind the camera, the face may extend to the border
            last = _leaves(u, (pu, pv), (qu, qv), (ru, rv), length, d)
        inward = [j for j in range(inner, last - d, -d) if shown[u, j] == f]
        for pixels, new, sign in ((list(outward), inner, d), (inward, outer, -d)):
            if not pixels:
                continue
            gain = ((image[u, pixels] - image[u, new]) * grad[u, pixels]).sum(-1).clamp(min=0)
            move = (torch.tensor(pixels, dtype=torch.float64) - c) * 2 / length
            if u != qu:
                to_p -= float((gain / (move * (qu - pu) / (qu - u) + sign * eps)).sum())
            if u != pu:
                to_q -= float((gain / (move * (qu - pu) / (u - pu) + sign * eps)).sum())
    return to_p, to_q


def _leaves(u: int, p: tuple[float, float], q: tuple[float, float], r: tuple[float, float], length: int, d: int) -> int:
    """Find the last pixel of line u before it leaves the face through p-r or q-r, rounded outward, within the image."""
    a = p if min(p[0], r[0]) < u < max(p[0], r[0]) else q
    c = r[1] if a[0] == r[0] else a[1] + (r[1] - a[1]) * (u - a[0]) / (r[0] - a[0])
    return min(max(math.ceil(c) if d > 0 else math.floor(c), 0), length - 1)
