"""Triangulation of polygons: fans for convex ones, ear clipping for concave ones."""

from __future__ import annotations

import itertools
from bisect import bisect_left, bisect_right
from collections import deque

import numpy as np

_FLAT = 1e-6  # a flipped triangle of less than this share of the polygon's area does not make it concave
_OTHER = np.array([[1, 2, 3], [1, 3, 0]])  # a quadrilateral as the fan of its second corner


def triangulate(points: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split polygons, with ``sizes`` [P] ≥ 3 of the ``corners`` [C], into triangles.

    Returns the triangles [F, 3] as indices into ``corners``, in the polygons' order, and the polygon of each triangle.
    A polygon with corners 0, 1, …, n − 1 becomes the fan (0, 1, 2), (0, 2, 3), …. If a triangle of that fan is turned
    over, the polygon is concave and is triangulated by ear clipping.
    """
    counts = sizes - 2
    starts, offsets = np.cumsum(sizes) - sizes, np.cumsum(counts) - counts
    triangles = np.empty((counts.sum(), 3), dtype=np.int64)
    for size in np.flatnonzero(np.bincount(sizes)):  # `np.unique` would import more of NumPy
        chosen = np.flatnonzero(sizes == size)
        steps = np.arange(1, size - 1)
        fan = np.stack([np.zeros_like(steps), steps, steps + 1], axis=1)
        triangles[offsets[chosen][:, None] + np.arange(size - 2)] = starts[chosen][:, None, None] + fan
        if size == 3:
            continue
        outlines = points[corners[starts[chosen][:, None] + np.arange(size)]].astype(np.float64, copy=False)
        turned, normals = _turned_over(outlines)
        if size == 4:  # the other diagonal does for a concave quadrilateral that does not cross itself
            other = np.flatnonzero(turned)
            other = other[~_turned_over(np.roll(outlines[other], -1, axis=1))[0]]
            triangles[offsets[chosen[other]][:, None] + np.arange(2)] = starts[chosen[other]][:, None, None] + _OTHER
            turned[other] = False
        for which in np.flatnonzero(turned):
            polygon = chosen[which]
            ears = _cut_ears(outlines[which], normals[which])
            triangles[offsets[polygon] : offsets[polygon] + size - 2] = starts[polygon] + ears
    return triangles, np.repeat(np.arange(len(sizes)), counts)


def _turned_over(outlines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Test which polygons [n, size, 3] have a flipped triangle in the fan of the first corner; return also normals."""
    flat = np.ascontiguousarray(outlines.transpose(2, 1, 0))  # [3, size, n], which is faster
    spokes = flat[:, 1:] - flat[:, :1]
    (a, b, c), (d, e, f) = spokes[:, :-1], spokes[:, 1:]
    areas = np.stack((b * f - c * e, c * d - a * f, a * e - b * d))
    normals = areas.sum(axis=1)
    along = np.einsum("ktn,kn->tn", areas, normals)
    return along.min(axis=0) < -_FLAT * np.einsum("kn,kn->n", normals, normals), normals.T


def _cut_ears(outline: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Clip the ears of one polygon [n, 3], projected along its normal: [n − 2, 3] indices of its corners."""
    drop = int(np.abs(normal).argmax())
    flat = np.delete(outline, drop, axis=1)
    if (normal[drop] < 0) != (drop == 1):  # dropping y mirrors the plane
        flat = flat * [-1, 1]
    ring = _Ring(flat)
    ears = []
    # A corner is tested again after a neighbour, or the corner inside of its ear, was cut off. It goes to the queue's
    # end, so that ears are cut all around the polygon and stay short.
    queue, pending = deque(range(len(flat))), [1] * len(flat)
    blocked: dict[int, list[int]] = {}
    while queue:
        at = queue.popleft()
        pending[at] -= 1
        if pending[at] or ring.gone[at] or ring.reflex[at]:
            continue
        blocker = ring.blocker(at)
        if blocker is not None:
            blocked.setdefault(blocker, []).append(at)
            continue
        again = [ring.before[at], ring.after[at]]
        ears.append((again[0], at, again[1]))
        if len(ears) == len(flat) - 2:
            break
        for corner in ring.cut(at):
            again += blocked.pop(corner, [])
        for corner in again:
            pending[corner] += 1
        queue.extend(again)
    else:  # no ear is left, because the outline crosses itself or has no area: make a fan
        left = [corner for corner in range(len(flat)) if not ring.gone[corner]]
        ears += [(left[0], *pair) for pair in itertools.pairwise(left[1:])]
    return np.array(ears)


class _Ring:
    """Remaining corners of a polygon [n, 2] during ear clipping, as a linked list, with flags for concave corners."""

    def __init__(self, flat: np.ndarray) -> None:
        count = len(flat)
        self.before, self.after = [count - 1, *range(count - 1)], [*range(1, count), 0]
        self.gone = [False] * count
        self._points: list[list[float]] = flat.tolist()
        self.reflex = np.array([self._turn(corner) <= 0 for corner in range(count)])
        self._flat = flat
        self._orders = [np.argsort(values, kind="stable") for values in flat.T]
        self._sorted = [values[order].tolist() for values, order in zip(flat.T, self._orders, strict=True)]

    def blocker(self, at: int) -> int | None:
        """Find a concave corner inside the ear at the convex corner ``at``, or None."""
        corners = [self.before[at], at, self.after[at]]
        triangle = [self._points[corner] for corner in corners]
        # Candidates lie in the vertical and in the horizontal strip of the triangle; take the strip with fewer.
        strips = []
        for axis, (order, values) in enumerate(zip(self._orders, self._sorted, strict=True)):
            low, high = min(point[axis] for point in triangle), max(point[axis] for point in triangle)
            strips.append(order[bisect_left(values, low) : bisect_right(values, high)])
        strip = min(strips, key=len)
        strip = strip[self.reflex[strip]]
        x, y = self._flat[strip].T
        inside = np.ones(len(strip), dtype=bool)
        for (ax, ay), (bx, by) in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            inside &= (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= 0
            # A corner at the same place as one of the triangle is not inside. Bridges to holes repeat vertices.
            inside &= (x != ax) | (y != ay)
        return int(strip[inside.argmax()]) if inside.any() else None

    def cut(self, at: int) -> list[int]:
        """Remove a corner; return the corners that no longer block an ear."""
        before, after = self.before[at], self.after[at]
        self.after[before], self.before[after] = after, before
        self.gone[at], self.reflex[at] = True, False
        for corner in (before, after):
            self.reflex[corner] = self._turn(corner) <= 0
        return [corner for corner in (before, at, after) if not self.reflex[corner]]

    def _turn(self, at: int) -> float:
        """Return a number > 0 if the outline turns left at this corner."""
        (ax, ay), (bx, by), (cx, cy) = (self._points[corner] for corner in (self.before[at], at, self.after[at]))
        return (bx - ax) * (cy - by) - (by - ay) * (cx - bx)
