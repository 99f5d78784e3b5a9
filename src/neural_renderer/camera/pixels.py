"""Screen coordinates to pixels, and pixels with a depth back to camera coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from .. import validate
from ..constants import on_device
from .fisheye import undo_fisheye
from .lens import distorted, image_size, viewing_angle
from .parameters import as_tensor, scalar

if TYPE_CHECKING:
    from .model import CameraModel

_STEPS = 10  # of Newton's method; it doubles the correct digits in each


def pixel_size(size: Any, camera: CameraModel) -> tuple[float, float]:
    """Convert a side or (height, width) to (height, width); by default the size that the camera's K describes."""
    size = camera.orig_size if size is None else size
    if size is None:
        raise ValueError("size: expected the side or (height, width) of the image in pixels, got None")
    with validate.called(orig_size="size"):
        return image_size(size)


def pixels_of(screen: Tensor, size: tuple[float, float]) -> Tensor:
    """Convert x and y of screen coordinates [..., 3] to pixels [..., 2]: x right, y down, (0, 0) upper left."""
    height, width = size
    return torch.stack(((screen[..., 0] + 1) * (width / 2), (1 - screen[..., 1]) * (height / 2)), -1)


def camera_points(camera: CameraModel, pixels: Tensor, depth: Tensor, size: tuple[float, float]) -> Tensor:
    """Compute the points [B, V, 3], relative to the camera's axes, that pixels [B, V, 2] at depths [B, V] show."""
    height, width = size
    x, y = pixels.unbind(-1)
    if camera.K is not None and camera.orig_size is not None:
        rows, columns = camera.orig_size
        x, y = _undo_intrinsics(x * (columns / width), y * (rows / height), on_device(camera.K, pixels))
        if camera.dist_coeffs is not None:
            undo = undo_fisheye if camera.is_fisheye else _undistorted
            x, y = undo(x, y, on_device(camera.dist_coeffs, pixels))
        return torch.stack(torch.broadcast_tensors(x * depth, y * depth, depth), -1)
    x, y = (2 * x / width - 1) * (width / height), 1 - 2 * y / height
    if camera.viewing_angle is None:
        scale = as_tensor("scale", scalar("scale", camera.scale, pixels.dtype, pixels.device), pixels.dtype)
        scale = scale[..., None] if scale.ndim else scale
        return torch.stack(torch.broadcast_tensors(x / scale, y / scale, depth), -1)
    angle = viewing_angle("viewing_angle", camera.viewing_angle, pixels.dtype, pixels.device)
    across = torch.tan(torch.deg2rad(as_tensor("viewing_angle", angle, pixels.dtype)))
    across = (across[..., None] if across.ndim else across) * depth
    return torch.stack(torch.broadcast_tensors(x * across, y * across, depth), -1)


def _undo_intrinsics(u: Tensor, v: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
    """Solve (u, v) = K (x, y, 1) for x and y [B, V]; K [B, 3, 3] has the third row (0, 0, 1)."""
    a, b, c, d = (K[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)))
    u, v = u - K[:, 0, 2, None], v - K[:, 1, 2, None]
    area = a * d - b * c
    return (d * u - b * v) / area, (a * v - c * u) / area


def _undistorted(u: Tensor, v: Tensor, dist_coeffs: Tensor) -> tuple[Tensor, Tensor]:
    """Find the x and y [B, V] that `distorted` moves to u and v, by Newton's method."""
    k1, k2, p1, p2, k3 = dist_coeffs.detach()[..., None].unbind(-2)
    x, y = torch.broadcast_tensors(u.detach(), v.detach() + 0 * k1)
    for step in range(_STEPS):
        r2 = x * x + y * y
        radial, slope = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + 3 * r2 * k3)
        across = 2 * (x * y * slope + p1 * x + p2 * y)  # the Jacobian is symmetric
        along_x = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        along_y = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        area = along_x * along_y - across * across
        # The last step carries the gradients: x and y are a solution, so that one step differentiates it exactly.
        is_last = step == _STEPS - 1
        target_u, target_v = (u, v) if is_last else (u.detach(), v.detach())
        found_u, found_v = distorted(x, y, dist_coeffs if is_last else dist_coeffs.detach())
        off_u, off_v = found_u - target_u, found_v - target_v
        x = x - (along_y * off_u - across * off_v) / area
        y = y - (along_x * off_v - across * off_u) / area
    return x, y
