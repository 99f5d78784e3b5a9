"""Colours of the background behind an object, from other photographs that see it past the object."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...camera import Camera
from ..fit.fit_views import Views
from .place import Place
from .sweep import rays_of

_NEAR, _FAR = 6, 6  # views that tell how the background looks behind a pixel: the nearest ones, and of the others


def predict_background(images: np.ndarray, camera: Camera, place: Place, hidden: np.ndarray) -> np.ndarray:
    """Predict the colours [N, H, W, 3] of the background behind each pixel; NaN where nothing tells.

    They are what other views show of the point in which the pixel's ray meets the table: their median.

    Args:
        images: Photographs [N, H, W, 3].
        camera: Their N cameras.
        place: Place of the object, with the plane of the table; without one, nothing is predicted.
        hidden: [N, H, W] bool: what hides the background, such as outlines of the object.
    """
    predicted = np.full_like(images, np.nan, dtype=np.float32)
    if place.ground is None:
        return predicted
    size, count = (images.shape[1], images.shape[2]), len(images)
    layers = torch.from_numpy(np.concatenate((images, hidden[..., None]), 3, dtype=np.float32)).permute(0, 3, 1, 2)
    eyes = Views(camera, torch.ones(count, 2, 2)).eyes()[0]
    order = torch.cdist(eyes, eyes).argsort(1)[:, 1:].tolist()
    for row in range(count):
        others = order[row][:_NEAR] + order[row][_NEAR :: -(-count // _FAR)]
        points, t = meet_table(camera[row : row + 1], place.ground, size)
        pixels, depth = camera[others].project(points.flatten(0, 1).float().expand(len(others), -1, -1), size)
        spot = pixels / pixels.new_tensor([size[1], size[0]]) * 2 - 1
        seen = F.grid_sample(layers[others], spot[:, None], align_corners=False)[:, :, 0]
        shown = (depth > 0) & (spot.abs() < 1).all(-1) & (seen[:, 3] < 0.5) & (t.flatten() > 0)
        colours = torch.where(shown[:, None], seen[:, :3], torch.nan).nanmedian(0).values
        predicted[row] = colours.view(3, *size).permute(1, 2, 0).numpy()
    return predicted


def meet_table(camera: Camera, ground: np.ndarray, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Compute where each pixel's ray of one camera meets the plane ``ground`` [4]: points [H, W, 3] and depths [H, W].

    Depths are not positive, or not finite, where it does not.
    """
    eye, way = (part.double() for part in rays_of(camera, size))
    normal = torch.from_numpy(ground[:3])
    depth = (float(ground[3]) - eye @ normal) / (way @ normal)
    return eye + depth[..., None] * way, depth
