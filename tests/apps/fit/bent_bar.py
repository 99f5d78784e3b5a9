"""Ten views of a bent bar without symmetry, and usual mistakes in masks and cameras."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

import neural_renderer as nr
from neural_renderer.apps.fit import Views

SIGNS = torch.tensor([1.0, -1.0, -1.0])


def calibrated(camera: nr.Camera) -> nr.Camera:
    """Convert cameras with a viewing angle to cameras with K, for images of 48 x 64."""
    rotation = camera.rotation * torch.tensor([1.0, -1.0, 1.0])[:, None]
    focal = 24 / math.tan(math.radians(22))
    K = torch.tensor([[focal, 0.0, 33.0], [0.0, focal, 23.0], [0.0, 0.0, 1.0]])
    return nr.Camera.projection(K, rotation, -torch.einsum("bij,bj->bi", rotation, camera.origin), orig_size=(48, 64))


def bent_bar() -> Views:
    parts = [
        nr.cube()[0] * torch.tensor(size) + torch.tensor(place)
        for size, place in (
            ((0.7, 0.2, 0.25), (0.0, 0.0, 0.0)),
            ((0.2, 0.5, 0.2), (0.55, 0.5, 0.1)),
            ((0.1, 0.15, 0.5), (-0.5, -0.2, 0.5)),
        )
    ]
    faces = nr.cube()[1]
    mesh = nr.Mesh(torch.cat(parts), torch.cat([faces + 8 * row for row in range(3)]))
    elevation = torch.tensor([-25.0, 10.0, 40.0, 20.0, 30.0]).repeat(2)
    eyes = nr.get_points_from_angles(3.2, elevation, torch.arange(10) * 36.0)
    return Views.of(mesh, calibrated(nr.Camera.look_at(eyes)), (48, 64))


def with_one_turned(views: Views) -> Views:
    """Turn the mask of the fourth view by 180°."""
    masks = views.masks.clone()
    masks[3] = masks[3].rot90(2, (0, 1))
    return Views(views.camera, masks)


def upside_down(views: Views) -> Views:
    return Views(views.camera, views.masks.rot90(2, (1, 2)))


def mirrored(views: Views) -> Views:
    return Views(views.camera, views.masks.flip(2))


def with_axes(views: Views) -> Views:
    """Exchange the camera axes of OpenCV and OpenGL."""
    camera = views.camera
    moved = replace(camera, rotation=camera.rotation * SIGNS[:, None], translation=camera.translation * SIGNS)
    return Views(moved, views.masks)


def inverted(views: Views) -> Views:
    """Exchange camera-to-world and world-to-camera matrices."""
    camera = views.camera
    moved = replace(camera, rotation=camera.rotation.transpose(1, 2).contiguous(), translation=views.eyes()[0])
    return Views(moved, views.masks)


def scaled(views: Views, factors: list[list[float]]) -> Views:
    """Multiply the intrinsics [3, 3] by factors."""
    return Views(replace(views.camera, K=views.camera.K * torch.tensor(factors)), views.masks)  # type: ignore[operator]
