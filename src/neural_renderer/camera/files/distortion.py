"""Lens models that `Camera` does not express, and images without their distortion."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ..fisheye import fisheye

_LEAST_RADIUS = 1e-9

Values = dict[str, float]
Point = tuple[Tensor, Tensor]


def _rational(x: Tensor, y: Tensor, v: Values) -> Point:
    """OpenCV's model with a quotient of polynomials, k1 … k6, and tangential distortion."""
    r2 = x * x + y * y
    above = 1 + r2 * (v["k1"] + r2 * (v["k2"] + r2 * v["k3"]))
    below = 1 + r2 * (v["k4"] + r2 * (v["k5"] + r2 * v["k6"]))
    return _tangential(x, y, x * above / below, y * above / below, v)


def _field_of_view(x: Tensor, y: Tensor, v: Values) -> Point:
    """The FOV model of Devernay and Faugeras: the distance from the axis is an angle, and omega the field of view."""
    radius = (x * x + y * y).sqrt().clamp(min=_LEAST_RADIUS)
    omega = torch.tensor(v["omega"], dtype=x.dtype)
    if abs(v["omega"]) < 1e-4:
        return x, y
    scale = torch.atan(2 * radius * torch.tan(omega / 2)) / omega / radius
    return x * scale, y * scale


def _fisheye(x: Tensor, y: Tensor, v: Values) -> Point:
    """Kannala and Brandt's model: the distance from the axis is a polynomial of the angle."""
    coefficients = x.new_tensor([v.get(name, 0.0) for name in ("k1", "k2", "k3", "k4")])
    return fisheye(torch.stack((x, y, torch.ones_like(x)), -1), coefficients)


def _thin_prism_fisheye(x: Tensor, y: Tensor, v: Values) -> Point:
    """Equidistant fisheye, then radial, tangential and thin prism distortion."""
    x, y = _fisheye(x, y, {})
    r2 = x * x + y * y
    radial = 1 + r2 * (v["k1"] + r2 * (v["k2"] + r2 * (v["k3"] + r2 * v["k4"])))
    u, w = _tangential(x, y, x * radial, y * radial, v)
    return u + v["sx1"] * r2, w + v["sy1"] * r2


def _division(x: Tensor, y: Tensor, v: Values) -> Point:
    """Fitzgibbon's division model: the undistorted radius is r / (1 + k1·r²) for a distorted radius r."""
    root = (1 - 4 * v["k1"] * (x * x + y * y)).clamp(min=0).sqrt()
    return 2 * x / (1 + root), 2 * y / (1 + root)


def _unified(x: Tensor, y: Tensor, v: Values) -> Point:
    """The enhanced unified camera model of Khomutenko et al."""
    below = v["alpha"] * (v["beta"] * (x * x + y * y) + 1).sqrt() + 1 - v["alpha"]
    return x / below, y / below


def _tangential(x: Tensor, y: Tensor, u: Tensor, w: Tensor, v: Values) -> Point:
    """Add tangential distortion of the point (x, y) to (u, w)."""
    r2, p1, p2 = x * x + y * y, v["p1"], v["p2"]
    return u + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), w + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


DISTORTIONS: dict[str, Callable[[Tensor, Tensor, Values], Point]] = {
    "FULL_OPENCV": _rational,
    "FOV": _field_of_view,
    "OPENCV_FISHEYE": _fisheye,
    "SIMPLE_RADIAL_FISHEYE": _fisheye,
    "RADIAL_FISHEYE": _fisheye,
    "SIMPLE_FISHEYE": _fisheye,
    "FISHEYE": _fisheye,
    "THIN_PRISM_FISHEYE": _thin_prism_fisheye,
    "SIMPLE_DIVISION": _division,
    "DIVISION": _division,
    "EUCM": _unified,
}
"""By COLMAP's name: moves points (x, y) at depth 1 to where the lens shows them."""


def undistort(image: Tensor, model: str, values: Values, K: list[list[float]]) -> Tensor:
    """Resample an image [C, H, W] as a pinhole lens with the same K would show it; 0 where the image has no pixel.

    The lens is one of `DISTORTIONS`, with coefficients by name; K is in pixels of this image.
    """
    height, width = image.shape[1:]
    (fx, _, cx), (_, fy, cy), _ = K
    v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    x, y = DISTORTIONS[model]((u - cx) / fx, (v - cy) / fy, values)
    place = torch.stack((2 * (x * fx + cx) / width - 1, 2 * (y * fy + cy) / height - 1), -1)
    return F.grid_sample(image[None], place[None].to(image), padding_mode="zeros", align_corners=False)[0]
