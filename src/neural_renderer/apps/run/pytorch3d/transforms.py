"""`Transform3d`: matrices [N, 4, 4] for rows of points; conversions of rotations."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ....camera import rotations
from .properties import batched

axis_angle_to_matrix = so3_exp_map = so3_exponential_map = rotations.from_axis_angle
matrix_to_axis_angle = so3_log_map = rotations.to_axis_angle
quaternion_to_matrix, matrix_to_quaternion = rotations.from_quaternion, rotations.to_quaternion


class Transform3d:
    """A batch of transformations: (x, y, z, 1) · matrix, then a division by the last coordinate."""

    def __init__(self, dtype: torch.dtype = torch.float32, device: Any = "cpu", matrix: Tensor | None = None) -> None:
        matrix = torch.eye(4, dtype=dtype, device=device) if matrix is None else matrix
        self._matrix = matrix if matrix.ndim == 3 else matrix[None]

    @property
    def device(self) -> torch.device:
        return self._matrix.device

    def __len__(self) -> int:
        return len(self._matrix)

    def __getitem__(self, index: Any) -> Transform3d:
        return Transform3d(matrix=self._matrix[index])

    def get_matrix(self) -> Tensor:
        return self._matrix

    def compose(self, *others: Transform3d) -> Transform3d:
        """Return the transformation that does this one first, and then the others."""
        matrix = self._matrix
        for other in others:
            matrix = matrix @ other.get_matrix()
        return Transform3d(matrix=matrix)

    def inverse(self) -> Transform3d:
        return Transform3d(matrix=torch.linalg.inv(self._matrix))

    def transform_points(self, points: Tensor, eps: float | None = None) -> Tensor:
        """Transform points [P, 3] or [N, P, 3]; ``eps`` is the least absolute value of the divisor."""
        matrix = self._matrix.to(points.dtype)
        moved = points @ matrix[:, :3] + matrix[:, 3:]
        divisor = moved[..., 3:]
        if eps is not None:
            divisor = torch.where(divisor < 0, -1.0, 1.0) * divisor.abs().clamp(min=eps)
        result = moved[..., :3] / divisor
        return result[0] if points.ndim == 2 and len(matrix) == 1 else result

    def transform_normals(self, normals: Tensor) -> Tensor:
        """Transform normals [P, 3] or [N, P, 3] by the transposed inverse."""
        result = normals @ torch.linalg.inv(self._matrix[:, :3, :3]).transpose(1, 2).to(normals.dtype)
        return result[0] if normals.ndim == 2 and len(result) == 1 else result

    def to(self, device: Any, *_: Any, **__: Any) -> Transform3d:
        return Transform3d(matrix=self._matrix.to(device))

    def clone(self) -> Transform3d:
        return Transform3d(matrix=self._matrix.clone())

    def rotate(self, *args: Any, **kwargs: Any) -> Transform3d:
        return self.compose(Rotate(*args, **kwargs).to(self.device))

    def translate(self, *args: Any, **kwargs: Any) -> Transform3d:
        return self.compose(Translate(*args, **kwargs).to(self.device))

    def scale(self, *args: Any, **kwargs: Any) -> Transform3d:
        return self.compose(Scale(*args, **kwargs).to(self.device))


class Rotate(Transform3d):
    """Rows of points times R, [3, 3] or [N, 3, 3]."""

    def __init__(self, R: Tensor, dtype: torch.dtype = torch.float32, device: Any = None, **_: Any) -> None:
        rotation = R.to(device or R.device, dtype).reshape(-1, 3, 3)
        super().__init__(matrix=torch.nn.functional.pad(rotation, (0, 1, 0, 1)) + _corner(rotation))


class Translate(Transform3d):
    """Points plus (x, y, z), three numbers or tensors [N], or one tensor [N, 3]."""

    def __init__(self, x: Any, y: Any = None, z: Any = None, dtype: Any = torch.float32, device: Any = None) -> None:
        step = _three(x, y, z, 0.0, device, dtype)
        ones = torch.eye(4, dtype=dtype, device=step.device)
        super().__init__(matrix=ones + torch.nn.functional.pad(step[:, None], (0, 1, 3, 0)))


class Scale(Transform3d):
    """Points times (x, y, z), or times one number."""

    def __init__(self, x: Any, y: Any = None, z: Any = None, dtype: Any = torch.float32, device: Any = None) -> None:
        size = _three(x, y, z, None, device, dtype)
        super().__init__(matrix=torch.diag_embed(torch.nn.functional.pad(size, (0, 1), value=1.0)))


class RotateAxisAngle(Rotate):
    """A turn about "X", "Y" or "Z", by degrees or radians."""

    def __init__(self, angle: Any, axis: str = "X", degrees: bool = True, device: Any = "cpu", **_: Any) -> None:
        radians = batched(angle, device) * (math.pi / 180 if degrees else 1)
        super().__init__(_turn(axis.upper(), radians).transpose(-1, -2))


def euler_angles_to_matrix(euler_angles: Tensor, convention: str) -> Tensor:
    """Convert three angles [..., 3] in radians about the axes of a word such as "XYZ" to matrices [..., 3, 3]."""
    first, second, third = (_turn(axis, angle) for axis, angle in zip(convention, euler_angles.unbind(-1), strict=True))
    return first @ second @ third


def rotation_6d_to_matrix(d6: Tensor) -> Tensor:
    """Convert the first two rows of matrices, [..., 6]."""
    return rotations.from_6d(d6).transpose(-1, -2)


def matrix_to_rotation_6d(matrix: Tensor) -> Tensor:
    return rotations.to_6d(matrix.transpose(-1, -2))


def random_rotations(n: int, dtype: Any = None, device: Any = None) -> Tensor:
    """Return matrices [n, 3, 3], uniform over all rotations."""
    return rotations.from_quaternion(torch.randn(n, 4, dtype=dtype, device=device))


def axis_angle_to_quaternion(axis_angle: Tensor) -> Tensor:
    return rotations.to_quaternion(rotations.from_axis_angle(axis_angle))


def quaternion_to_axis_angle(quaternions: Tensor) -> Tensor:
    return rotations.to_axis_angle(rotations.from_quaternion(quaternions))


def _turn(axis: str, angle: Tensor) -> Tensor:
    unit = angle.new_tensor([float(axis == name) for name in "XYZ"])
    return rotations.from_axis_angle(angle[..., None] * unit)


def _three(x: Any, y: Any, z: Any, missing: float | None, device: Any, dtype: torch.dtype) -> Tensor:
    """Convert x, y, z, or one tensor [N, 3], or one number for all three, to [N, 3]."""
    first = batched(x, device or getattr(x, "device", "cpu")).to(dtype)
    if first.ndim == 2:
        return first
    others = [first if value is None and missing is None else missing if value is None else value for value in (y, z)]
    parts = torch.broadcast_tensors(first, *(batched(value, first.device).to(dtype) for value in others))
    return torch.stack(parts, -1)


def _corner(rotation: Tensor) -> Tensor:
    return torch.diag(rotation.new_tensor([0.0, 0.0, 0.0, 1.0]))
