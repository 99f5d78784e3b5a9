"""Small copies of images with cameras, in a folder of results: whoever views it needs no file outside of it."""

from __future__ import annotations

from pathlib import Path

import torch

from ....camera import Camera
from ....camera.files.opencv import has_opencv_lens, save_cameras
from ....io.atomic_write import write_file
from ....io.images import encode_image
from .views import Views, downscale

COPIES = "views"
"""Folder of the copies, and of their camera file, in that of the results."""
SIDE = 256
"""Most pixels of the longer side of a copy."""
_CAMERAS = "cameras.json"


def copy_paths(output: Path, count: int) -> list[Path]:
    """List the files that `save_copies` writes for so many views: pictures, and the camera file at the end."""
    return [output / COPIES / name for name in (*(f"{number:04}.png" for number in range(count)), _CAMERAS)]


def save_copies(output: Path, camera: Camera, views: Views) -> None:
    """Write pictures of views whose alpha is the mask, white without photos, and their cameras.

    Cameras that are orthographic or fisheyes have no such file, and so no copies.
    """
    if not has_opencv_lens(camera):
        return
    *pictures, cameras = copy_paths(output, len(views))
    for number, path in enumerate(pictures):
        mask = views.masks[number][None]
        photo = mask.expand(3, -1, -1) if views.photos is None else views.photos[number]
        small = downscale(torch.cat((photo, mask)), SIDE)
        small[:3] /= small[3:].clamp(min=1e-6)  # photos are multiplied by their masks
        write_file(path, encode_image(path, small.permute(1, 2, 0).cpu(), fast=True))
    save_cameras(cameras, camera, [path.name for path in pictures], views.size)
