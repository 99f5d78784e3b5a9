"""Small changes of cameras as parameters: pose and focal length."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ....camera import Camera

FREEDOMS = 6
"""Parameters of a pose: three of rotation, three of place."""


def change_cameras(camera: Camera, poses: Tensor, focal: Tensor) -> Camera:
    """Change poses and focal length of cameras; differentiable in the changes.

    A rotation turns the scene around the origin of the world, where the object is, and not around the camera: a turned
    camera and one that moved sideways look almost the same, and descent would confuse them.

    Args:
        camera: N cameras.
        poses: [N, 6]. Rotation vector around the camera's axes, in radians; then the shift of the world's origin along
            these axes, relative to its depth.
        focal: [] or [1], logarithm of the factor of the focal length of all cameras, or of the scale of parallel ones.

    Returns:
        N cameras.

    Example:
        >>> from neural_renderer.tasks.fit.cameras.pose_offsets import change_cameras
        >>> camera = nr.Camera.look_at((0.0, 0.0, -2.0), viewing_angle=45)
        >>> pose = torch.tensor([[0.0, 0.0, 0.0, 0.1, 0.0, 0.0]])  # the object a little to the right
        >>> change_cameras(camera, pose, torch.zeros(1))(torch.zeros(1, 3))
        tensor([[[0.1000, 0.0000, 2.0000]]])
    """
    poses, focal = poses.to(camera.rotation), focal.to(camera.rotation)
    place = camera.translation - torch.einsum("bij,bj->bi", camera.rotation, camera.origin)  # of the world's origin
    rotation = torch.linalg.matrix_exp(_cross_matrix(poses[:, :3])) @ camera.rotation
    place = place + place[:, 2:] * poses[:, 3:]
    factor = focal.reshape(()).exp()
    lens: dict[str, Any]
    if camera.K is not None:
        scale = torch.ones_like(camera.K)
        scale[:, :2, :2] = factor
        return replace(camera, rotation=rotation, origin=torch.zeros_like(place), translation=place, K=camera.K * scale)
    if camera.viewing_angle is not None:
        half = torch.deg2rad(torch.as_tensor(camera.viewing_angle).to(factor))
        lens = {"viewing_angle": torch.rad2deg(torch.atan(torch.tan(half) / factor))}
    else:
        lens = {"scale": camera.scale * factor}
    origin = -torch.einsum("bij,bi->bj", rotation, place)
    return replace(camera, rotation=rotation, origin=origin, translation=torch.zeros_like(origin), **lens)


def _cross_matrix(vectors: Tensor) -> Tensor:
    """Make the matrices [N, 3, 3] that compute cross products with vectors [N, 3]."""
    x, y, z = vectors.unbind(1)
    zero = torch.zeros_like(x)
    rows = (zero, -z, y, z, zero, -x, -y, x, zero)
    return torch.stack(rows, 1).view(-1, 3, 3)
