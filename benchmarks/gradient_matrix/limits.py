"""Cells of the matrix that are known to be off, each with its bound and the cause."""

from __future__ import annotations

from typing import NamedTuple


class Limit(NamedTuple):
    """The largest error of a ratio, the largest sine of the angle, and their cause."""

    error: float
    turn: float
    cause: str


USUAL = Limit(0.02, 0.1, "")


def limit(case: str, output: str) -> Limit:
    """Find the limit of the cells of an output of a case."""
    return LIMITS.get((case, output)) or LIMITS.get((case, "")) or USUAL


_SLIVERS = "seams and outlines whose faces, narrow slivers near the outline of a ball, no pixel near them shows"
_CURVED = "colours that curve within a pixel, and normals of faces that no pixel shows"
_NOISE = "not resolved: near the noise, whose own estimate from three or four groups of shifts is rough"
_BORDER = "outlines closer to the border of the image than a pixel, beyond which no pixel shows the other colour"

LIMITS: dict[tuple[str, str], Limit] = {
    ("1 px faces", ""): Limit(0.05, 0.15, _CURVED),
    ("1 px faces", "normal"): Limit(0.16, 0.1, _CURVED),
    ("5 px faces", "normal"): Limit(0.05, 0.1, _NOISE),
    ("seams, large faces", ""): Limit(0.05, 0.13, _NOISE),
    ("seams, 5 px faces", ""): Limit(0.06, 0.1, _NOISE),
    ("seams, 3 px faces", ""): Limit(0.12, 0.2, _SLIVERS),
    ("seams, 1.4 px faces", ""): Limit(0.27, 0.4, _SLIVERS),
    ("seams of a sheet", "rgb"): Limit(0.05, 0.1, _NOISE),
    ("hard texture", "rgb"): Limit(
        0.06, 0.13, "colours that jump within a face: the derivative of their ramps is noisy"
    ),
    ("intersecting bodies", "normal"): Limit(
        0.08, 0.1, "intersections where the visible parts of both faces are short"
    ),
    ("overlap, near moves", ""): Limit(0.04, 0.1, _SLIVERS),
    ("overlap, near moves", "normal"): Limit(0.1, 0.1, _SLIVERS),
    ("overlap, far moves", ""): Limit(0.04, 0.12, _NOISE),
    ("overlap, far moves", "normal"): Limit(0.13, 0.18, _NOISE),
    ("outline over the border", "normal"): Limit(0.06, 0.1, _SLIVERS),
    ("outline along the border", ""): Limit(0.3, 0.2, _BORDER),
}
