"""Baking of texture cubes from images with texture coordinates and from corner colours.

Texel (i, j, k) of a face's T³ cube holds the colour at barycentric weights (i, j, k) / (i + j + k) of the face's
corners 0, 1, 2. Texel (0, 0, 0), the only one if T = 1, holds the colour at the centre. The renderer reads weight w of
a corner at cube coordinate w · (T − 1).
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..base import validate

_MOST_BYTES = 8 * 2**30
_SAMPLES_AT_ONCE = 2**20
_BORDER = 1e-5  # texture coordinates this close to 0 or 1 count as 0 or 1, because files and sums are rounded


def barycentric_grid(size: int) -> np.ndarray:
    """Compute the barycentric weights [T · T · T, 3] float64 of a cube's texels, in memory order."""
    grid = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float64)
    grid[0] = 1
    return grid / grid.sum(axis=1, keepdims=True)


def trilinear_texels(weights: np.ndarray, size: int, margin: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Find the eight texels that the renderer blends at barycentric weights [N, 3]: indices and shares, [N, 8] each.

    Coordinates in the cube of ``size``³ texels end at size − 1 − margin, as by the ``eps`` of `render`.
    """
    at = (weights * (size - 1)).clip(0, size - 1 - margin if size > 1 else 0)
    low = np.floor(at + 1e-9).clip(0, max(size - 2, 0)).astype(np.int64)
    up = (at - low).clip(0, 1)
    index = np.zeros((len(at), 1), dtype=np.int64)
    shares = np.ones((len(at), 1), dtype=at.dtype)
    for axis in range(3):
        ends = np.stack((low[:, axis], np.minimum(low[:, axis] + 1, size - 1)), 1)
        parts = np.stack((1 - up[:, axis], up[:, axis]), 1)
        index = (index[:, :, None] * size + ends[:, None]).reshape(len(at), -1)
        shares = (shares[:, :, None] * parts[:, None]).reshape(len(at), -1)
    return index, shares


def check_size(faces: int, size: int) -> None:
    """Raise TypeError or ValueError if T is not an int ≥ 1, or if cubes for F faces would take more than 8 GiB."""
    if isinstance(size, bool) or not isinstance(size, (int, np.integer)):
        raise TypeError(f"texture_size: expected an int, got {type(size).__name__}")
    if size < 1:
        raise ValueError(f"texture_size: expected at least 1, got {size}")
    needed = faces * int(size) ** 3 * 12  # three float32 numbers per texel
    if needed > _MOST_BYTES:
        raise ValueError(
            f"texture_size: expected cubes of at most {_MOST_BYTES / 2**30:.0f} GiB, got {needed / 2**30:.1f} GiB "
            f"({faces} faces of {size}³ texels); choose a smaller one"
        )


def bake_corners(values: Tensor, size: int) -> Tensor:
    """Bake values [F, 3 corners, C] into texture cubes [F, T, T, T, C] that interpolate them; differentiable."""
    weights = torch.from_numpy(barycentric_grid(size)).to(values)
    return torch.einsum("gk,fkc->fgc", weights, values).reshape(len(values), size, size, size, values.shape[2])


def bake_image(
    image: np.ndarray,
    uv: np.ndarray,
    size: int,
    wrap: str | tuple[str, str] = "repeat",
    bilinear: bool = True,
    pixel_centers: bool = False,
) -> np.ndarray:
    """Bake an image [H, W, 3] float32 into the texture cubes [N, T, T, T, 3] of N faces.

    Texture coordinates [N, 3, 2] of the corners, v **up**, are wrapped outside [0, 1] by "repeat", "mirror", "clamp", a
    pair of them for u and v, or "border", which is black. With "repeat", exactly 1 is the far border of the image,
    unless the face begins there. With ``pixel_centers``, 0 and 1 are the borders of the image, as in glTF; otherwise
    they are the centres of the outermost pixels, as the first packages read OBJ files.
    """
    repeat = _axes(wrap, "repeat")
    if repeat.any():
        # Shift faces outside by whole images, so that they start in the first one and may end exactly at 1.
        low, high = uv.min(axis=1, keepdims=True), uv.max(axis=1, keepdims=True)
        uv = np.where(repeat & ((low < -_BORDER) | (high > 1 + _BORDER)), uv - np.floor(low + _BORDER), uv)
    grid = barycentric_grid(size)
    cubes = np.empty((len(uv), len(grid), 3), dtype=np.float32)
    step = max(1, _SAMPLES_AT_ONCE // len(grid))
    for start in range(0, len(uv), step):
        samples = np.einsum("gk,nkc->ngc", grid, uv[start : start + step])
        cubes[start : start + step] = _sample(image, samples, wrap, bilinear, pixel_centers)
    return cubes.reshape(-1, size, size, size, 3)


def _axes(wrap: str | tuple[str, str], mode: str) -> np.ndarray:
    """Test for u and v whether they wrap in a mode, [2] bool."""
    return np.array([one == mode for one in ((wrap, wrap) if isinstance(wrap, str) else wrap)])


def _sample(
    image: np.ndarray, uv: np.ndarray, wrap: str | tuple[str, str], bilinear: bool, pixel_centers: bool
) -> np.ndarray:
    """Sample an image at texture coordinates [..., 2]; arguments as `bake_image`. Returns [..., 3]."""
    height, width = image.shape[:2]
    outside = (uv < -_BORDER) | (uv > 1 + _BORDER)
    repeat, mirror = _axes(wrap, "repeat"), _axes(wrap, "mirror")
    if repeat.any():
        uv = np.where(repeat & outside, uv - np.floor(uv), uv)
    if mirror.any():
        uv = np.where(mirror, 1 - np.abs(uv % 2 - 1), uv)
    uv = uv.clip(0, 1)
    x, y = uv[..., 0], 1 - uv[..., 1]
    if pixel_centers:
        x, y = (x * width - 0.5).clip(0, width - 1), (y * height - 0.5).clip(0, height - 1)
    else:
        x, y = x * (width - 1), y * (height - 1)
    if bilinear:
        left, top = x.astype(np.int64), y.astype(np.int64)
        right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
        along, down = (x - left)[..., None].astype(np.float32), (y - top)[..., None].astype(np.float32)
        upper = image[top, left] * (1 - along) + image[top, right] * along
        colors = upper * (1 - down) + (image[bottom, left] * (1 - along) + image[bottom, right] * along) * down
    else:
        colors = image[(y + 0.5).astype(np.int64), (x + 0.5).astype(np.int64)]
    if wrap == "border":
        colors = np.where(outside.any(axis=-1, keepdims=True), np.float32(0), colors)
    return colors


def noise_cubes(faces: Tensor, texture_size: int) -> Tensor:
    """Make texture cubes [F, T, T, T, 3] of the first packages, to be optimised through a sigmoid."""
    size = validate.whole("texture_size", texture_size, 1)
    return 0.05 * torch.randn(len(faces), size, size, size, 3, device=faces.device)


def white_cubes(faces: Tensor, texture_size: int) -> Tensor:
    """Make white texture cubes [F, T, T, T, 3]."""
    size = validate.whole("texture_size", texture_size, 1)
    return torch.ones(len(faces), size, size, size, 3, device=faces.device)
