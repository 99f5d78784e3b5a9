"""Projection: camera coordinates to screen coordinates (x right, y up, in [-1, 1] over the image; z is the depth)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ..base import validate
from ..raster.ops.project_corners import rotate
from .distortion import away_from_zero, lens_model, pinhole
from .parameters import Array, Scalar, as_tensor, batch_of, batch_size, float_type, outside, parameter, scalar

_TOLERANCE = 0.02  # tolerance of R Rᵀ and K's third row; admits matrices typed with three digits, or in bfloat16
_FOCAL = (1e-9, 1e9)  # least and greatest size of a focal length in pixels
_THIRD_ROW = (0.0, 0.0, 1.0)  # third row of every intrinsic matrix


def perspective(vertices: Tensor, angle: Scalar = 30.0) -> Tensor:
    """Project camera coordinates in perspective: (x / (z · tan angle), y / (z · tan angle), z).

    Args:
        vertices: [V, 3] or [B, V, 3] floating, camera coordinates.
        angle: **Half** the field of view in degrees, in (0, 90): a number, or a tensor [] or [B].

    Returns:
        Screen coordinates of the shape of ``vertices`` (with the batch of ``angle``, if it has one); z is unchanged.
        Values and gradients are finite, also at z = 0. Differentiable in both arguments.

    Raises:
        TypeError, ValueError: A type or shape does not fit, or the angle is outside (0, 90) (see `check_values`).

    Example:
        >>> nr.perspective(torch.tensor([[1.0, 2.0, 4.0]]), angle=45)
        tensor([[0.2500, 0.5000, 4.0000]])
    """
    return in_perspective(validate.vertices(vertices), angle)


def in_perspective(vertices: Tensor, angle: Scalar, name: str = "angle") -> Tensor:
    """Apply `perspective` to valid vertices; messages call the angle ``name``."""
    angle = viewing_angle(name, angle, vertices.dtype, vertices.device)
    if not isinstance(angle, Tensor):  # on CUDA, a division by a tensor of the CPU would round twice
        angle = torch.full((), angle, dtype=vertices.dtype, device=vertices.device)
    width = torch.tan(torch.deg2rad(angle))
    batch_size(vertices=batch_of(vertices, 2), **{name: batch_of(width, 0)})
    x, y, z = vertices.unbind(-1)
    across = width[..., None] if width.ndim else width
    near = away_from_zero(z)
    return torch.stack(torch.broadcast_tensors(x / near / across, y / near / across, z), dim=-1)


def orthographic(vertices: Tensor, scale: Scalar = 1.0) -> Tensor:
    """Project camera coordinates without perspective: (x · scale, y · scale, z).

    Args:
        vertices: [V, 3] or [B, V, 3] floating, camera coordinates.
        scale: As in `Camera.look_at`.

    Returns:
        As `perspective`.

    Raises:
        TypeError, ValueError: A type, shape or number does not fit (see `check_values`).

    Example:
        >>> nr.orthographic(torch.tensor([[1.0, 2.0, 4.0]]), scale=0.5)
        tensor([[0.5000, 1.0000, 4.0000]])
    """
    return in_parallel(validate.vertices(vertices), scale)


def in_parallel(vertices: Tensor, scale: Scalar) -> Tensor:
    """Apply `orthographic` to valid vertices."""
    scale = scalar("scale", scale, vertices.dtype, vertices.device)
    batch_size(vertices=batch_of(vertices, 2), scale=batch_of(scale, 0))
    across = scale[..., None] if isinstance(scale, Tensor) and scale.ndim else scale
    x, y, z = vertices.unbind(-1)
    return torch.stack(torch.broadcast_tensors(x * across, y * across, z), dim=-1)


def projection(
    vertices: Tensor,
    K: Array,
    R: Array,
    t: Array,
    dist_coeffs: Array | None = None,
    orig_size: float | Sequence[float] = 1024,
    eps: float = 1e-9,
) -> Tensor:
    """Project world vertices with a calibrated camera, in the conventions of OpenCV.

    1. Camera coordinates X' = R·X + t: x right, y **down**, z forward.
    2. Division by depth: x = X'/(Z' + eps), y = Y'/(Z' + eps).
    3. Distortion with r² = x² + y²: x·(1 + k1·r² + k2·r⁴ + k3·r⁶) + 2·p1·x·y + p2·(r² + 2x²), and
       y·(1 + k1·r² + k2·r⁴ + k3·r⁶) + p1·(r² + 2y²) + 2·p2·x·y.
    4. Pixels (u, v) = K·(x, y, 1): the centre of pixel j is at j + 0.5, v points down.
    5. Screen coordinates in [-1, 1], y up.

    Args:
        vertices: [V, 3] or [B, V, 3] floating, in the world.
        K, R, t, dist_coeffs, orig_size: As in `Camera.projection`.
        eps: Number added to the depth before the division.

    Returns:
        Screen coordinates of the shape of ``vertices`` (with the batch of the camera, if it has one); z = Z'. Values
        and gradients are finite, also on the optical axis and at depth 0. Differentiable in vertices, K, R, t and
        dist_coeffs.

    Raises:
        TypeError, ValueError: A type, shape or number does not fit (see `check_values`).

    Example:
        >>> K = [[500.0, 0.0, 512.0], [0.0, 500.0, 512.0], [0.0, 0.0, 1.0]]
        >>> nr.projection(torch.tensor([[0.0, 1.0, 2.0]]), K, torch.eye(3), (0.0, 0.0, 0.0))
        tensor([[ 0.0000, -0.4883,  2.0000]])
    """
    validate.vertices(vertices)
    eps = validate.number("eps", eps)
    K, R, t, dist_coeffs = calibration(K, R, t, dist_coeffs, vertices.dtype, vertices.device)
    distortion = 1 if dist_coeffs is None else batch_of(dist_coeffs, 1)
    batch_size(
        vertices=batch_of(vertices, 2), K=batch_of(K, 2), R=batch_of(R, 2), t=batch_of(t, 1), dist_coeffs=distortion
    )
    return pixels_to_screen(rotate(R, vertices) + t[..., None, :], K, dist_coeffs, image_size(orig_size), eps)


def calibration(
    K: Any, R: Any, t: Any, dist_coeffs: Any, dtype: torch.dtype, device: torch.device, coefficients: int = 5
) -> tuple[Tensor, Tensor, Tensor, Tensor | None]:
    """Convert the arguments of `projection` to tensors (K, R, t, dist_coeffs), each with or without a batch."""
    t = _without_column(as_tensor("t", t, dtype))
    if t.ndim == 3:
        if t.shape[1:] != (1, 3):
            raise ValueError(f"t: expected shape [3], [B, 3] or [B, 1, 3], got {validate.shape_of(t)}")
        t = t[:, 0]
    K, R = parameter("K", K, (3, 3), dtype, device), parameter("R", R, (3, 3), dtype, device)
    t = parameter("t", t, (3,), dtype, device)
    if dist_coeffs is not None:
        dist_coeffs = _without_column(as_tensor("dist_coeffs", dist_coeffs, dtype))
        if coefficients == 5 and dist_coeffs.ndim in (1, 2) and dist_coeffs.shape[-1] == 4:
            dist_coeffs = functional.pad(dist_coeffs, (0, 1))  # k3 = 0
        dist_coeffs = parameter("dist_coeffs", dist_coeffs, (coefficients,), dtype, device)
    return K, R, t, dist_coeffs


def _without_column(value: Tensor) -> Tensor:
    """Convert columns [N, 1] or [B, N, 1], the vectors that OpenCV returns, to [N] or [B, N]."""
    return value[..., 0] if value.ndim in (2, 3) and value.shape[-1] == 1 else value


def check_intrinsics(K: Tensor) -> None:
    """Check K [3, 3] or [B, 3, 3], while values are checked.

    Raise ValueError if a third row is not (0, 0, 1), or if a focal length is none with which anything can be drawn.
    """
    if not validate.values_are_checked(K):
        return
    rows = K.detach()[..., 2, :].reshape(-1, 3)
    wrong = ((rows - rows.new_tensor(_THIRD_ROW)).abs() > _TOLERANCE).any(1)
    if bool(wrong.any()):
        raise ValueError(f"K: expected the third row (0, 0, 1), got {tuple(rows[wrong][0].tolist())}")
    focal = torch.diagonal(K.detach(), dim1=-2, dim2=-1)[..., :2].double().abs()
    unusable = (focal < _FOCAL[0]) | (focal > _FOCAL[1])
    if bool(unusable.any()):
        got = float(focal[unusable][0])
        raise ValueError(f"K: expected focal lengths from {_FOCAL[0]:g} to {_FOCAL[1]:g} pixels, got {got:g}")


def check_rotation(R: Tensor) -> None:
    """Raise ValueError if R [3, 3] or [B, 3, 3] is not a rotation, while values are checked."""
    if not validate.values_are_checked(R):
        return
    rotations = R.detach().double().reshape(-1, 3, 3)
    product = rotations[:, :, None] * rotations[:, None]  # not matmul: TF32 rounds to three digits
    deviation = (product.sum(-1) - torch.eye(3, dtype=rotations.dtype, device=R.device)).abs().amax((1, 2))
    mirrors = torch.linalg.det(rotations) < 0
    if bool((deviation > _TOLERANCE).any()):
        raise ValueError(f"R: expected a rotation matrix (R Rᵀ = I), got a deviation of {float(deviation.max()):.2g}")
    if bool(mirrors.any()):
        raise ValueError("R: expected a rotation matrix, got a reflection (determinant -1)")


def pixels_to_screen(
    points: Tensor, K: Tensor, dist_coeffs: Tensor | None, size: tuple[float, float], eps: float = 1e-9
) -> Tensor:
    """Project camera coordinates [..., V, 3] (steps 2 to 5 of `projection`); size = (height, width) in pixels.

    The number of ``dist_coeffs`` selects the lens; see `lens_model`.
    """
    if validate.wide(points) is not points:  # r⁶ overflows half precision
        dist_coeffs = None if dist_coeffs is None else validate.wide(dist_coeffs)
        return pixels_to_screen(validate.wide(points), validate.wide(K), dist_coeffs, size, eps).to(points.dtype)
    model = lens_model(dist_coeffs)
    x, y = pinhole(points, eps) if model is None or dist_coeffs is None else model.project(points, dist_coeffs, eps)
    u, v, _ = rotate(K, torch.stack((x, y, torch.ones_like(x)), dim=-1)).unbind(-1)
    height, width = size
    return torch.stack(torch.broadcast_tensors(2 * u / width - 1, 1 - 2 * v / height, points[..., 2]), dim=-1)


def undo_intrinsics(u: Tensor, v: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
    """Solve (u, v) = K (x, y, 1) for x and y [B, V]; K [B, 3, 3] has the third row (0, 0, 1)."""
    a, b, c, d = (K[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)))
    u, v = u - K[:, 0, 2, None], v - K[:, 1, 2, None]
    determinant = a * d - b * c
    return (d * u - b * v) / determinant, (a * v - c * u) / determinant


def image_size(orig_size: Any) -> tuple[float, float]:
    """Convert ``orig_size`` of `projection` to (height, width)."""
    pair = tuple(orig_size) if isinstance(orig_size, (tuple, list)) else (orig_size, orig_size)
    if len(pair) != 2:
        raise ValueError(f"orig_size: expected a number or (height, width), got {orig_size}")
    height, width = (validate.number("orig_size", s) for s in pair)
    if height <= 0 or width <= 0:
        raise ValueError(f"orig_size: expected positive numbers, got {orig_size}")
    return height, width


def viewing_angle(name: str, angle: Any, dtype: torch.dtype, device: torch.device | None = None) -> Scalar:
    """Check half a field of view, in degrees in (0, 90); return a number, or a tensor [] or [B]."""
    value = scalar(name, angle, dtype, device)
    if outside(value, 0.0, 90.0):
        raise ValueError(f"{name}: expected degrees in (0, 90), half the field of view, got {angle}")
    return value


def half_angle(viewing_angle: Any, fov: Any, default: Any = None) -> Any:
    """Choose half a field of view in degrees from either form, or the default; raise ValueError for both forms."""
    if fov is None:
        return default if viewing_angle is None else viewing_angle
    if viewing_angle is not None:
        raise ValueError("fov: expected either this or viewing_angle, got both")
    value = scalar("fov", fov, float_type(fov))
    if outside(value, 0.0, 180.0):
        raise ValueError(f"fov: expected degrees in (0, 180), the whole field of view, got {fov}")
    return value / 2
