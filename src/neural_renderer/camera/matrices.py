"""Conversion of view and clip matrices of other programs to the axes and the intrinsic matrix of a camera."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..base import validate
from ..raster.ops.project_corners import rotate
from .lens import check_rotation
from .parameters import as_tensor

# Signs that convert the camera axes of a convention to OpenCV's: right, down, forward.
_AXES = {
    "opencv": (1.0, 1.0, 1.0),
    "opengl": (1.0, -1.0, -1.0),
    "blender": (1.0, -1.0, -1.0),
    "pytorch3d": (-1.0, -1.0, 1.0),
}
_TOLERANCE = 1e-3  # tolerance of a matrix's constant row
_SINGULAR = 1e-6  # relative size below which an orthogonalised row counts as zero


def view_frame(
    world_to_camera: Any, camera_to_world: Any, convention: str, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor, Tensor]:
    """Decompose a view matrix into OpenCV's R [..., 3, 3], the camera's position [..., 3] and OpenCV's t [..., 3]."""
    if convention not in _AXES:
        raise ValueError(f"convention: expected one of {', '.join(map(repr, _AXES))}, got {convention!r}")
    if (world_to_camera is None) == (camera_to_world is None):
        count = "none" if camera_to_world is None else "both"
        raise ValueError(f"world_to_camera: expected either this or camera_to_world, got {count}")
    name, value = "camera_to_world", camera_to_world
    if camera_to_world is None:
        name, value = "world_to_camera", world_to_camera
    matrix = _view_matrix(name, value, convention == "pytorch3d", dtype, device)
    rotation, shift = matrix[..., :3, :3], matrix[..., :3, 3]
    with validate.called(R=name):
        check_rotation(rotation)
    signs = matrix.new_tensor(_AXES[convention])
    if name == "camera_to_world":
        R = rotation.transpose(-1, -2) * signs[:, None]
        return R, shift, -rotate(R, shift[..., None, :])[..., 0, :]
    return rotation * signs[:, None], -rotate(rotation.transpose(-1, -2), shift[..., None, :])[..., 0, :], shift * signs


def clip_frame(matrix: Any, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor, Tensor, bool]:
    """Decompose a perspective clip matrix: K [B, 3, 3] for an image of 2 × 2 pixels, R, t, and whether it mirrors."""
    clip = _matrix("matrix", matrix, (4,), device).double()
    clip = clip if clip.ndim == 3 else clip[None]
    x, y, _, w = clip.unbind(-2)
    # Pixels of an image of 2 × 2: u = x / w + 1 to the right, v = 1 − y / w down.
    rows = torch.stack((x + w, w - y, w), -2)
    K, R, t = decomposed(rows)
    depth, focal = rows[:, 2, :3].norm(dim=-1), K.diagonal(dim1=1, dim2=2)[:, :2]
    mirrors = focal[:, 0] < 0
    is_checked = validate.values_are_checked(clip)
    if is_checked:
        if bool((depth <= _SINGULAR * rows[..., :3].abs().amax((1, 2))).any()):
            raise ValueError(
                "matrix: expected a perspective projection, got one whose fourth row hardly depends on the point; "
                "for a view without perspective use Camera.from_matrix(..., orthographic=True)"
            )
        if not bool((focal.abs() * depth[:, None] > _SINGULAR * rows[:, :2, :3].norm(dim=-1)).all()):  # or NaN
            raise ValueError("matrix: expected independent rows, got a matrix that projects to a line or a point")
        if bool(mirrors.any() != mirrors.all()):
            raise ValueError("matrix: expected a batch that mirrors all images or none, got both")
    return K.to(dtype), R.to(dtype), t.to(dtype), is_checked and bool(mirrors.all())


def decomposed(rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Split projections to pixels, [B, 3, 4] float64, into K with K₂₂ = 1, R and t; K₀₀ < 0 if they mirror.

    RQ decomposition by Gram-Schmidt from the last row (Hartley and Zisserman, "Multiple view geometry", 6.2.4).
    """
    forward, depth = _unit(rows[:, 2, :3])
    down, _ = _unit(rows[:, 1, :3] - _dot(rows[:, 1, :3], forward)[:, None] * forward)
    R = torch.stack((torch.linalg.cross(down, forward, dim=-1), down, forward), -2)
    rows = rows / depth[:, None, None]
    K = (rows[..., :3] @ R.transpose(1, 2)).triu()
    return K, R, torch.linalg.solve_triangular(K, rows[..., 3:], upper=True)[..., 0]


def clip_range(matrix: Any, device: torch.device) -> tuple[float, float]:
    """Read the near and the far depth from a perspective clip matrix, or several of one range."""
    clip = _matrix("matrix", matrix, (4,), device).detach().double().reshape(-1, 4, 4)
    z, w = clip[:, 2], clip[:, 3]
    slope = _dot(z[:, :3], w[:, :3]) / _dot(w[:, :3], w[:, :3])
    remainder = z - slope[:, None] * w  # z = slope · w + offset, if the first three numbers are 0
    offset, size = remainder[:, 3], clip.abs().amax((1, 2))
    if not bool((remainder[:, :3].abs().amax(1) <= _TOLERANCE * size).all()):
        raise ValueError("matrix: expected a perspective projection whose z depends only on the depth")
    depths = torch.stack((-offset / (1 + slope), offset / (1 - slope)), 1) / w[:, :3].norm(dim=1)[:, None]
    near, far = depths[0].tolist()
    far = torch.finfo(torch.float32).max if not 0 < far < torch.finfo(torch.float32).max else far
    if not 0 <= near < far or not bool(((depths - depths[0]).abs() <= _TOLERANCE * depths[0].abs()).all()):
        raise ValueError(f"matrix: expected one range of depths, 0 <= near < far, got {depths.tolist()}")
    return near, far


def _view_matrix(name: str, value: Any, in_rows: bool, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Convert a matrix [3, 4], [4, 4] or a batch; ``in_rows``: it multiplies points that are row vectors."""
    matrix = _matrix(name, value, (4,) if in_rows else (3, 4), device).to(dtype)
    matrix = matrix.transpose(-1, -2) if in_rows else matrix
    if matrix.shape[-2] == 4 and validate.values_are_checked(matrix):
        last = matrix.detach()[..., 3, :].reshape(-1, 4)
        wrong = ((last - last.new_tensor([0.0, 0.0, 0.0, 1.0])).abs() > _TOLERANCE).any(1)
        if bool(wrong.any()):
            part = "column" if in_rows else "row"
            raise ValueError(f"{name}: expected the last {part} (0, 0, 0, 1), got {tuple(last[wrong][0].tolist())}")
    return matrix


def _matrix(name: str, value: Any, rows: tuple[int, ...], device: torch.device) -> Tensor:
    """Convert numbers to a floating tensor [R, 4] or [B, R, 4], with R one of ``rows``."""
    matrix = as_tensor(name, value, torch.float64)
    if matrix.ndim not in (2, 3) or matrix.shape[-1] != 4 or matrix.shape[-2] not in rows:
        shapes = " or ".join(f"[{r}, 4]" for r in rows)
        raise ValueError(f"{name}: expected shape {shapes}, or a batch of them, got {validate.shape_of(matrix)}")
    matrix = matrix if matrix.is_floating_point() else matrix.double()
    validate.finite(name, matrix)
    return matrix.to(device)


def _unit(vector: Tensor) -> tuple[Tensor, Tensor]:
    """Split vectors [B, 3] into directions and lengths [B]."""
    length = vector.norm(dim=-1)
    return vector / length[:, None], length


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)
