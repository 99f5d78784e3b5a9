"""Images of lenses that `Camera` does not have, resampled as a pinhole lens would show them."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ....camera.distortion import Point, fisheye

Values = dict[str, float]  # coefficients by their names in a camera file

_LEAST_RADIUS = 1e-9  # least distance from the optical axis in a division
_LEAST_OMEGA = 1e-4  # field of view in radians below which the model is no distortion, as in COLMAP


def undistort(image: Tensor, model: str, values: Values, K: list[list[float]]) -> Tensor:
    """Resample an image [C, H, W] as a pinhole lens with the same K would show it; 0 where the image has no pixel.

    The lens is one of `DISTORTIONS`, with coefficients by name; K is in pixels of this image.
    """
    height, width = image.shape[1:]
    (fx, _, cx), (_, fy, cy), _ = K
    v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    x, y = DISTORTIONS[model]((u - cx) / fx, (v - cy) / fy, values)
    grid = torch.stack((2 * (x * fx + cx) / width - 1, 2 * (y * fy + cy) / height - 1), -1)
    return F.grid_sample(image[None], grid[None].to(image), padding_mode="zeros", align_corners=False)[0]


# Models of camera files: functions of x and y at depth 1 and of coefficients by name.


def rational(x: Tensor, y: Tensor, v: Values) -> Point:
    """Apply OpenCV's model with a quotient of polynomials, k1 … k6, and tangential distortion."""
    r2 = x * x + y * y
    above = 1 + r2 * (v["k1"] + r2 * (v["k2"] + r2 * v["k3"]))
    below = 1 + r2 * (v["k4"] + r2 * (v["k5"] + r2 * v["k6"]))
    return _tangential(x, y, x * above / below, y * above / below, v)


def field_of_view(x: Tensor, y: Tensor, v: Values) -> Point:
    """Apply the FOV model, where ω is the field of view of an ideal fisheye lens.

    Devernay and Faugeras, "Straight lines have to be straight" (2001).
    """
    radius = (x * x + y * y).sqrt().clamp(min=_LEAST_RADIUS)
    omega = torch.tensor(v["omega"], dtype=x.dtype)
    if abs(v["omega"]) < _LEAST_OMEGA:
        return x, y
    scale = torch.atan(2 * radius * torch.tan(omega / 2)) / omega / radius
    return x * scale, y * scale


def equidistant(x: Tensor, y: Tensor, v: Values) -> Point:
    """Apply Kannala and Brandt's model with up to four coefficients; missing ones are 0."""
    coefficients = x.new_tensor([v.get(name, 0.0) for name in ("k1", "k2", "k3", "k4")])
    return fisheye(torch.stack((x, y, torch.ones_like(x)), -1), coefficients)


def thin_prism_fisheye(x: Tensor, y: Tensor, v: Values) -> Point:
    """Apply an equidistant fisheye, then radial, tangential and thin prism distortion, as COLMAP does."""
    x, y = equidistant(x, y, {})
    r2 = x * x + y * y
    radial = 1 + r2 * (v["k1"] + r2 * (v["k2"] + r2 * (v["k3"] + r2 * v["k4"])))
    u, w = _tangential(x, y, x * radial, y * radial, v)
    return u + v["sx1"] * r2, w + v["sy1"] * r2


def division(x: Tensor, y: Tensor, v: Values) -> Point:
    """Apply the division model: the undistorted radius is r / (1 + k1·r²) for a distorted radius r.

    Fitzgibbon, "Simultaneous linear estimation of multiple view geometry and lens distortion" (2001).
    """
    root = (1 - 4 * v["k1"] * (x * x + y * y)).clamp(min=0).sqrt()
    return 2 * x / (1 + root), 2 * y / (1 + root)


def unified(x: Tensor, y: Tensor, v: Values) -> Point:
    """Apply the enhanced unified camera model (Khomutenko, Garcia and Martinet, 2016)."""
    below = v["alpha"] * (v["beta"] * (x * x + y * y) + 1).sqrt() + 1 - v["alpha"]
    return x / below, y / below


def _tangential(x: Tensor, y: Tensor, u: Tensor, w: Tensor, v: Values) -> Point:
    """Add tangential distortion of the point (x, y) to (u, w)."""
    r2, p1, p2 = x * x + y * y, v["p1"], v["p2"]
    return u + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), w + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


DISTORTIONS: dict[str, Callable[[Tensor, Tensor, Values], Point]] = {
    "FULL_OPENCV": rational,
    "FOV": field_of_view,
    "OPENCV_FISHEYE": equidistant,
    "SIMPLE_RADIAL_FISHEYE": equidistant,
    "RADIAL_FISHEYE": equidistant,
    "SIMPLE_FISHEYE": equidistant,
    "FISHEYE": equidistant,
    "THIN_PRISM_FISHEYE": thin_prism_fisheye,
    "SIMPLE_DIVISION": division,
    "DIVISION": division,
    "EUCM": unified,
}
"""Models that `Camera.projection` does not have: functions from (x, y) at depth 1 to where the lens shows the point."""
