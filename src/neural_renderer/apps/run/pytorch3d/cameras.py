"""Cameras: from the world to the view by R and T, to the projection by a matrix, and to NDC.

NDC has x to the left and y up; the shorter side of the image is [-1, 1].
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from .properties import TensorProperties, batched, convert_to_tensors_and_broadcast
from .transforms import Rotate, Transform3d, Translate

_R, _T = torch.eye(3)[None], torch.zeros(1, 3)


class CamerasBase(TensorProperties):
    """Common part of all cameras. Keywords such as ``R`` and ``T`` of methods replace those of the camera for good."""

    R: Tensor
    T: Tensor
    K: Tensor | None
    image_size: Tensor | None = None
    perspective = True

    def get_world_to_view_transform(self, **kwargs: Any) -> Transform3d:
        self.R, self.T = kwargs.get("R", self.R), kwargs.get("T", self.T)
        return Rotate(self.R).compose(Translate(self.T))

    def get_camera_center(self, **kwargs: Any) -> Tensor:
        self.get_world_to_view_transform(**kwargs)
        return -(self.T[:, None] @ self.R.transpose(1, 2))[:, 0]

    def get_projection_transform(self, **kwargs: Any) -> Transform3d:
        K = kwargs.get("K", self.K)
        return Transform3d(matrix=(self._matrix() if K is None else K).transpose(1, 2))

    def get_full_projection_transform(self, **kwargs: Any) -> Transform3d:
        return self.get_world_to_view_transform(**kwargs).compose(self.get_projection_transform(**kwargs))

    def get_ndc_camera_transform(self, **kwargs: Any) -> Transform3d:
        """Return the transformation of the projection to NDC: x / s, for pixels (x + width / 2 - 2 px) / s."""
        if self.in_ndc():
            return Transform3d(device=self.device)
        size, scale = self._size(kwargs)
        shift = size.flip(-1) / 2 - 2 * self.get_principal_point(**kwargs)
        return _scaled(1 / scale, shift / scale)

    def transform_points(self, points: Tensor, eps: float | None = None, **kwargs: Any) -> Tensor:
        return self.get_full_projection_transform(**kwargs).transform_points(points, eps=eps)

    def transform_points_ndc(self, points: Tensor, eps: float | None = None, **kwargs: Any) -> Tensor:
        full = self.get_full_projection_transform(**kwargs).compose(self.get_ndc_camera_transform(**kwargs))
        return full.transform_points(points, eps=eps)

    def transform_points_screen(
        self, points: Tensor, eps: float | None = None, with_xyflip: bool = True, **kwargs: Any
    ) -> Tensor:
        """Return pixels, x to the right and y down, (width / 2 - s x, height / 2 - s y), and the third coordinate."""
        size, scale = self._size(kwargs)
        to_screen = _scaled(-scale if with_xyflip else scale, size.flip(-1) / 2)
        return to_screen.transform_points(self.transform_points_ndc(points, eps, **kwargs))

    def unproject_points(self, xy_depth: Tensor, world_coordinates: bool = True, **kwargs: Any) -> Tensor:
        """Return the points at (x, y) of the projection, or of NDC with ``from_ndc``, and a depth in world units."""
        projection = self.get_projection_transform(**kwargs)
        if kwargs.get("from_ndc"):
            projection = projection.compose(self.get_ndc_camera_transform(**kwargs))
        to_view = projection.inverse()
        depth = xy_depth[..., 2:]
        row, offset = projection.get_matrix()[:, 2, 2], projection.get_matrix()[:, 3, 2]
        row, offset = (value.view(-1, *[1] * (xy_depth.ndim - 1)) for value in (row, offset))
        third = row + offset / depth if self.perspective else row * depth + offset
        points = to_view.transform_points(torch.cat((xy_depth[..., :2], third), -1))
        view = self.get_world_to_view_transform(**kwargs)
        return view.inverse().transform_points(points) if world_coordinates else points

    def get_principal_point(self, **kwargs: Any) -> Tensor:
        return self.get_projection_transform(**kwargs).get_matrix()[:, 2 if self.perspective else 3, :2]

    def is_perspective(self) -> bool:
        return self.perspective

    def in_ndc(self) -> bool:
        return bool(getattr(self, "_in_ndc", True))

    def get_znear(self) -> Any:
        return getattr(self, "znear", None)

    def get_image_size(self) -> Tensor | None:
        return self.image_size

    def _matrix(self) -> Tensor:
        raise NotImplementedError

    def _size(self, kwargs: Any) -> tuple[Tensor, Tensor]:
        """Return (height, width) [N, 2], and half of the shorter side [N, 1]."""
        size = kwargs.get("image_size", self.image_size)
        if size is None:
            raise ValueError("image_size: expected (height, width) for pixels, got None")
        size = batched(size, self.device).view(-1, 2)
        return size, size.amin(1, keepdim=True) / 2

    def _of(self, *rows: tuple[Any, ...]) -> Tensor:
        """Make matrices [N, 4, 4] from rows of numbers and tensors [N]."""
        ones = torch.ones(self._N, device=self.device)
        return torch.stack([torch.stack([ones * number for number in row], -1) for row in rows], -2)


class FoVPerspectiveCameras(CamerasBase):
    """Cameras with the field of view ``fov``, the whole vertical angle; OpenGL's matrix with depth in [0, 1]."""

    def __init__(
        self, znear: Any = 1.0, zfar: Any = 100.0, aspect_ratio: Any = 1.0, fov: Any = 60.0, degrees: bool = True,
        R: Tensor = _R, T: Tensor = _T, K: Tensor | None = None, device: Any = "cpu",
    ) -> None:  # fmt: skip
        super().__init__(device, znear=znear, zfar=zfar, aspect_ratio=aspect_ratio, fov=fov, R=R, T=T, K=K)
        self.degrees = degrees

    def _matrix(self) -> Tensor:
        names = ("znear", "zfar", "fov", "aspect_ratio")
        near, far, fov, aspect = (getattr(self, name) for name in names)
        focal = 1 / torch.tan((fov * math.pi / 180 if self.degrees else fov) / 2)
        depth = far / (far - near)
        return self._of((focal / aspect, 0, 0, 0), (0, focal, 0, 0), (0, 0, depth, -near * depth), (0, 0, 1, 0))


class FoVOrthographicCameras(CamerasBase):
    """Cameras with parallel rays, which see a box."""

    perspective = False

    def __init__(
        self, znear: Any = 1.0, zfar: Any = 100.0, max_y: Any = 1.0, min_y: Any = -1.0, max_x: Any = 1.0,
        min_x: Any = -1.0, scale_xyz: Any = ((1.0, 1.0, 1.0),), R: Tensor = _R, T: Tensor = _T,
        K: Tensor | None = None, device: Any = "cpu",
    ) -> None:  # fmt: skip
        box = {"znear": znear, "zfar": zfar, "max_y": max_y, "min_y": min_y, "max_x": max_x, "min_x": min_x}
        super().__init__(device, **box, scale_xyz=scale_xyz, R=R, T=T, K=K)

    def _matrix(self) -> Tensor:
        names = ("max_x", "min_x", "max_y", "min_y", "zfar", "znear")
        right, left, top, bottom, far, near = (getattr(self, name) for name in names)
        x, y, z = self.scale_xyz.unbind(-1)  # type: ignore[attr-defined]
        across, along = (2 * x / (right - left), 0, 0, -(right + left) / (right - left)), z / (far - near)
        up = (0, 2 * y / (top - bottom), 0, -(top + bottom) / (top - bottom))
        return self._of(across, up, (0, 0, along, -near / (far - near)), (0, 0, 0, 1))


class PerspectiveCameras(CamerasBase):
    """Cameras with a focal length and a principal point, in NDC, or in pixels with ``in_ndc=False``."""

    def __init__(
        self, focal_length: Any = 1.0, principal_point: Any = ((0.0, 0.0),), R: Tensor = _R, T: Tensor = _T,
        K: Tensor | None = None, device: Any = "cpu", in_ndc: bool = True, image_size: Any = None,
    ) -> None:  # fmt: skip
        values = {"focal_length": focal_length, "principal_point": principal_point, "image_size": image_size}
        super().__init__(device, **values, R=R, T=T, K=K)
        focal = self.focal_length
        self.focal_length: Tensor = (focal if focal.ndim == 2 else focal[:, None]).expand(-1, 2)
        self._in_ndc = in_ndc

    def _matrix(self) -> Tensor:
        (fx, fy), (px, py) = self.focal_length.unbind(-1), self.principal_point.unbind(-1)  # type: ignore[attr-defined]
        if self.perspective:
            return self._of((fx, 0, px, 0), (0, fy, py, 0), (0, 0, 0, 1), (0, 0, 1, 0))
        return self._of((fx, 0, 0, px), (0, fy, 0, py), (0, 0, 1, 0), (0, 0, 0, 1))


class OrthographicCameras(PerspectiveCameras):
    """Cameras with parallel rays, a scale and a principal point."""

    perspective = False


OpenGLPerspectiveCameras, OpenGLOrthographicCameras = FoVPerspectiveCameras, FoVOrthographicCameras
SfMPerspectiveCameras, SfMOrthographicCameras = PerspectiveCameras, OrthographicCameras


def camera_position_from_spherical_angles(
    distance: Any, elevation: Any, azimuth: Any, degrees: bool = True, device: Any = "cpu"
) -> Tensor:
    """Return the position [N, 3] of a camera: azimuth 0 is at +z and grows towards +x."""
    distance, elevation, azimuth = convert_to_tensors_and_broadcast(distance, elevation, azimuth, device=device)
    if degrees:
        elevation, azimuth = elevation * (math.pi / 180), azimuth * (math.pi / 180)
    flat = distance * elevation.cos()
    return torch.stack((flat * azimuth.sin(), distance * elevation.sin(), flat * azimuth.cos()), -1).view(-1, 3)


def look_at_rotation(
    camera_position: Any, at: Any = ((0, 0, 0),), up: Any = ((0, 1, 0),), device: Any = "cpu"
) -> Tensor:
    """Return R [N, 3, 3] whose columns are the camera's axes: left, up and forward."""
    given = convert_to_tensors_and_broadcast(camera_position, at, up, device=device)
    eye, at, up = (value.view(-1, 3) for value in given)
    z = functional.normalize(at - eye, eps=1e-5)
    x = functional.normalize(torch.linalg.cross(up.expand_as(z), z), eps=1e-5)
    y = functional.normalize(torch.linalg.cross(z, x), eps=1e-5)
    along_up = (x.abs() < 5e-3).all(1, keepdim=True)  # rounding of the eye's position gives the direction of y
    x = torch.where(along_up, functional.normalize(torch.linalg.cross(y, z), eps=1e-5), x)
    return torch.stack((x, y, z), -1)


def look_at_view_transform(
    dist: Any = 1.0, elev: Any = 0.0, azim: Any = 0.0, degrees: bool = True, eye: Any = None, at: Any = ((0, 0, 0),),
    up: Any = ((0, 1, 0),), device: Any = "cpu",
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Return R [N, 3, 3] and T [N, 3] of a camera at an eye, or at angles around ``at``, that looks at ``at``."""
    at = batched(at, device).view(-1, 3)
    around = camera_position_from_spherical_angles(dist, elev, azim, degrees, device) + at if eye is None else eye
    eye = batched(around, device).view(-1, 3)
    R = look_at_rotation(eye, at, up, device)
    return R, -(eye[:, None] @ R)[:, 0]


def cameras_from_opencv_projection(R: Tensor, tvec: Tensor, camera_matrix: Tensor, image_size: Tensor) -> Any:
    """Return `PerspectiveCameras` in NDC for OpenCV's R, t and K, and (height, width)."""
    size = image_size.to(R).view(-1, 2).flip(-1)
    scale = size.amin(1, keepdim=True) / 2
    focal = torch.stack((camera_matrix[:, 0, 0], camera_matrix[:, 1, 1]), -1) / scale
    point = -(camera_matrix[:, :2, 2] - size / 2) / scale
    turned = torch.tensor([-1.0, -1.0, 1.0]).to(R)
    # Both axes of the image are turned around, and matrices multiply rows.
    moved = tvec.view(-1, 3) * turned
    return PerspectiveCameras(focal, point, R.transpose(1, 2) * turned, moved, device=R.device, image_size=image_size)


def _scaled(scale: Tensor, shift: Tensor) -> Transform3d:
    """Make the transformation of x and y to x · scale + shift, from [N, 1] and [N, 2]."""
    matrix = torch.eye(4, device=scale.device).repeat(max(len(scale), len(shift)), 1, 1)
    matrix[:, 0, 0] = matrix[:, 1, 1] = scale[:, 0]
    matrix[:, 3, :2] = shift
    return Transform3d(matrix=matrix)
