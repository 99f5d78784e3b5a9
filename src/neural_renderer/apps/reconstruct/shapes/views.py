"""Pictures of training shapes from random views, cropped to the object, and the pose of each crop.

A pose is a tensor of six numbers: azimuth φ and elevation in radians, the distance d of the camera for a longest side
of 1, the centre (u, v) of the crop and half its side s, in units at the object's distance. The camera stands at
d (cos e cos φ, sin e, cos e sin φ), so that view k of the data sets has φ = 15° k. A point with camera coordinates
(x, y, z), z forward, is at ((x d / z − u)/s, (y d / z − v)/s) of the crop, which is [-1, 1]² with v up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....meshes.batch import pad
from ....meshes.normals import face_normals
from ....rendering.forward import render
from ..data.framing import DISTANCE, ELEVATION, SIZE, VIEWING_ANGLE, VIEWS
from .shapes import Shape

EXTENT = 56  # length of the object's longer side in a crop, in pixels of 64
_NEAR, _FAR = 0.2, 20.0


def camera_points(points: Tensor, pose: Tensor) -> Tensor:
    """Convert points [P, 3] or [B, P, 3] of the models' frame to coordinates (u, v, depth) [B, P, 3] of crops.

    ``pose`` is [B, 6]. The depth is the distance from the camera along its axis.
    """
    azimuth, elevation, distance, *crop = pose[:, :, None].unbind(1)
    ce, se, ca, sa = elevation.cos(), elevation.sin(), azimuth.cos(), azimuth.sin()
    x, y, z = (points if points.ndim == 3 else points[None]).unbind(-1)
    along = ca * x + sa * z
    right, up, toward = sa * x - ca * z, ce * y - se * along, ce * along + se * y
    depth = distance - toward
    scale = distance / depth
    return torch.stack(((right * scale - crop[0]) / crop[2], (up * scale - crop[1]) / crop[2], depth), -1)


def clip_points(points: Tensor, pose: Tensor) -> Tensor:
    """Convert points, as of `camera_points`, to clip space [B, P, 4], for `render` without a camera."""
    place = camera_points(points, pose)
    depth = place[..., 2:]
    lens = (_FAR + _NEAR) / (_FAR - _NEAR) * depth - 2 * _FAR * _NEAR / (_FAR - _NEAR)
    return torch.cat((place[..., :2] * depth, lens, depth), -1)


def random_poses(count: int, rng: np.random.Generator) -> Tensor:
    """Draw poses [count, 6] of uncropped views: half as in the data sets, half with any elevation and lens."""
    pose = np.zeros((count, 6))
    pose[:, 0] = rng.uniform(0, 2 * np.pi, count)
    published = rng.random(count) < 0.5
    elevation = np.where(published, ELEVATION, rng.uniform(-5, 60, count))
    pose[:, 1] = np.radians(elevation)
    pose[:, 2] = np.where(published, DISTANCE, 1 / rng.uniform(1 / 10, 1 / 1.5, count))
    pose[:, 5] = 1
    return torch.from_numpy(pose).float()


def crop_poses(pose: Tensor, vertices: Sequence[Tensor], rng: np.random.Generator) -> Tensor:
    """Move the crops of poses [B, 6] so that they frame objects with vertices [V_b, 3], with a little noise."""
    pose = pose.clone()
    for row, points in zip(pose, vertices, strict=True):
        place = camera_points(points, row[None])[0, :, :2]
        low, high = place.amin(0), place.amax(0)
        side = (high - low).max() / 2 * SIZE / EXTENT * math.exp(rng.normal(0, 0.03))
        row[3:5] = (low + high) / 2 + side * torch.from_numpy(rng.normal(0, 0.015, 2)).float()
        row[5] = side
    return pose


def published_pose(views: Tensor) -> Tensor:
    """Make the poses [B, 6] of views [B] of the data sets, uncropped."""
    views = views.float()
    pose = torch.zeros(len(views), 6)
    pose[:, 0], pose[:, 1], pose[:, 2] = views * (2 * math.pi / VIEWS), math.radians(ELEVATION), DISTANCE
    pose[:, 5] = DISTANCE * math.tan(math.radians(VIEWING_ANGLE))
    return pose


def crop(images: Tensor, size: int = SIZE) -> tuple[Tensor, Tensor]:
    """Crop RGBA images [B, 4, H, W] in [0, 1] to their objects: [B, 4, size, size].

    Returns also the crops [B, 3] in units of half the height of the image: centre (u, v), v up, and half the side.
    """
    height, width = images.shape[2:]
    crops, results = [], []
    for image in images:
        solid = image[3] > (0.5 if float(image[3].max()) > 0.5 else -1.0)  # the whole picture, if it has no object
        rows, columns = (solid.any(axis).nonzero()[:, 0] for axis in (1, 0))
        top, bottom, left, right = (int(n) for n in (rows[0], rows[-1] + 1, columns[0], columns[-1] + 1))
        half = max(bottom - top, right - left) / 2 * SIZE / EXTENT
        center = (left + right) / 2, (top + bottom) / 2
        place = ((torch.arange(2 * size) + 0.5) / size - 1) * half
        y, x = torch.meshgrid(place + center[1], place + center[0], indexing="ij")
        shrink = min(1.0, size / half)  # shrinking first avoids aliasing
        pixels = torch.cat((image[:3] * image[3:], image[3:]))[None]
        if shrink < 1:
            small = [max(1, round(shrink * n)) for n in (height, width)]
            pixels = F.interpolate(pixels, small, mode="bilinear", antialias=True, align_corners=False)
        grid = torch.stack((2 * x / width - 1, 2 * y / height - 1), -1)[None]
        result = F.avg_pool2d(F.grid_sample(pixels, grid, align_corners=False), 2)[0].clamp(0, 1)
        results.append(torch.cat((result[:3] / result[3:].clamp(min=1e-4), result[3:])).clamp(0, 1))
        unit = height / 2
        crops.append([(center[0] - width / 2) / unit, (height / 2 - center[1]) / unit, half / unit])
    return torch.stack(results), torch.tensor(crops)


def published_crops(images: Tensor, views: Tensor) -> tuple[Tensor, Tensor]:
    """Crop images [B, 4, 64, 64] in [0, 1] of the data sets; return the crops and their poses [B, 6]."""
    cropped, place = crop(images)
    pose = published_pose(views)
    pose[:, 3:] = place * pose[:, 5:]
    return cropped, pose


@torch.no_grad()
def draw(shapes: Sequence[Shape], pose: Tensor, rng: np.random.Generator, size: int = SIZE) -> Tensor:
    """Draw a shape per pose [B, 6] with random lights: RGBA [B, 4, size, size] in [0, 1]; transparent colours are 0."""
    vertices, faces = pad([s.vertices for s in shapes]), pad([s.faces for s in shapes])
    corners = vertices[torch.arange(len(shapes))[:, None, None], faces]
    eye = _eyes(pose)
    normals = face_normals(corners)
    facing = torch.einsum("bfc,bfc->bf", normals, eye[:, None] - corners.mean(2))
    normals = normals * facing.sign()[..., None]
    light = torch.zeros(normals.shape[:2])
    ambient = torch.from_numpy(rng.uniform(0.25, 0.6, (len(shapes), 1))).float()
    for strength in (rng.uniform(0.3, 0.7, len(shapes)), rng.uniform(0, 0.3, len(shapes))):
        direction = torch.from_numpy(rng.normal(0, 1, (len(shapes), 3))).float() * 0.7 + eye / eye.norm(
            dim=1, keepdim=True
        )
        direction[:, 1] += 0.8
        cosine = torch.einsum("bfc,bc->bf", normals, F.normalize(direction, dim=1)).clamp(min=0)
        light += torch.from_numpy(strength).float()[:, None] * cosine
    colors = (0.05 + 0.95 * pad([s.colors for s in shapes])) * (ambient + light)[..., None]
    textures = colors[:, :, None, None, None]
    image = render(
        (clip_points(vertices, pose), faces, textures),
        None,
        2 * size,
        light=None,
        outputs=("rgb", "alpha"),
        anti_aliasing=False,
    )
    alpha = F.avg_pool2d(image.alpha[:, None], 2)
    rgb = F.avg_pool2d(image.rgb, 2) / alpha.clamp(min=1e-6)
    return torch.cat((rgb * (alpha > 0), alpha), 1).clamp(0, 1)


def _eyes(pose: Tensor) -> Tensor:
    """Compute the positions [B, 3] of the cameras of poses."""
    azimuth, elevation, distance = pose[:, 0], pose[:, 1], pose[:, 2]
    flat = elevation.cos() * distance
    return torch.stack((flat * azimuth.cos(), elevation.sin() * distance, flat * azimuth.sin()), 1)
