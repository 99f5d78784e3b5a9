"""Cells of the matrix that are known to be off, each with the formula or the experiment that bounds them."""

from __future__ import annotations

from typing import NamedTuple


class Limit(NamedTuple):
    """The expected ratio, the largest error of it, the largest sine of the angle, and the cause."""

    size: float
    error: float
    turn: float
    cause: str


USUAL = Limit(1.0, 0.02, 0.1, "")


def limit(case: str, output: str, anti_aliased: bool = False) -> Limit:
    """Find the limit of a cell."""
    if case == "outline along the border":
        return _BORDER_SMOOTH if anti_aliased else _BORDER
    return LIMITS.get((case, output), LIMITS.get((case, ""), USUAL))


_ALONG_BORDER = (
    "no pixel shows the colour beyond the border: an outline p pixels inside it is seen if p is above a half, and "
    "counts twice up to one. At p = 0.4 + s, over shifts s within half a pixel, the mean is 2 x 0.4; with twice the "
    "pixels it is (1 + 0.8) / 2. Colours inside faces have their whole gradient, so the sum of both is turned"
)
_BORDER, _BORDER_SMOOTH = Limit(0.8, 0.02, 0.2, _ALONG_BORDER), Limit(0.9, 0.02, 0.2, _ALONG_BORDER)

LIMITS: dict[tuple[str, str], Limit] = {
    ("crossing planes", ""): Limit(
        1.0,
        0.08,
        0.1,
        "the top and bottom outlines of the planes cross, and the gaps beside these points widen by c = 0.16 and 0.38 "
        "pixels a column. Where a gap is narrower than a pixel, the nearer outline has the gradient of the farther "
        "one: of 1 / (2 c), 3.2 + 1.3 of the 109 columns that both outlines cross, 4 %. Where the outlines move "
        "against each other, twice that is wrong. With these outlines apart, sizes are 0.997",
    ),
}
