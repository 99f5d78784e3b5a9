"""Baking colours into the cubes that the renderer draws: an image seen through UV, colours of corners, one colour.

Texel (i, j, k) of a face's T³ cube holds the colour at barycentric weights (i, j, k) / (i + j + k) of the face's
corners 0, 1, 2, and texel (0, 0, 0), the only one if T is 1, the colour at the centre. The renderer reads weight w of a
corner at cube coordinate w * (T - 1).
"""

from __future__ import annotations

import numpy as np

WRAPPINGS = ("REPEAT", "MIRRORED_REPEAT", "CLAMP_TO_EDGE", "CLAMP_TO_BORDER")
_MOST_BYTES = 8 * 2**30
_BORDER = 1e-5  # texture coordinates this close to 0 or 1 are on the border: texts are rounded, and so are sums


def barycentric_grid(size: int) -> np.ndarray:
    """The weights [T * T * T, 3] float64 of a cube's texels, in the cube's memory order."""
    grid = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float64)
    grid[0] = 1
    return grid / grid.sum(axis=1, keepdims=True)


def check_size(faces: int, size: int) -> None:
    """TypeError or ValueError if T is no whole number, below 1, or cubes for F faces would take more than 8 GiB."""
    if isinstance(size, bool) or not isinstance(size, (int, np.integer)):
        raise TypeError(f"texture_size: expected an int, got {type(size).__name__}")
    if size < 1:
        raise ValueError(f"texture_size: expected at least 1, got {size}")
    needed = faces * int(size) ** 3 * 12
    if needed > _MOST_BYTES:
        raise ValueError(
            f"texture_size: expected cubes of at most {_MOST_BYTES / 2**30:.0f} GiB, got {needed / 2**30:.1f} GiB "
            f"({faces} faces of {size}³ texels); choose a smaller one"
        )


def bake_corners(colours: np.ndarray, size: int) -> np.ndarray:
    """Cubes [N, T, T, T, 3] float32 that blend the colours [N, 3, 3] of each face's corners."""
    cubes = np.einsum("gk,nkc->ngc", barycentric_grid(size).astype(np.float32), colours.astype(np.float32))
    return cubes.reshape(-1, size, size, size, 3)


def bake_image(
    image: np.ndarray,
    uv: np.ndarray,
    size: int,
    wrapping: str = "REPEAT",
    bilinear: bool = True,
    pixel_centres: bool = False,
) -> np.ndarray:
    """Cubes [N, T, T, T, 3] float32 of an image seen through texture coordinates.

    Args:
        image: [H, W, 3] float32, first row on top.
        uv: [N, 3, 2] float64, finite, of each face's corners; u to the right, v **up**, the image over [0, 1]².
        size: T, texels along a cube's edge.
        wrapping: One of `WRAPPINGS`, for what lies outside [0, 1]: ``"REPEAT"`` (the image again; exactly 1 is its far
            border, unless the face begins there), ``"MIRRORED_REPEAT"``, ``"CLAMP_TO_EDGE"``, or
            ``"CLAMP_TO_BORDER"`` (black).
        bilinear: Blend the four nearest pixels, else take the nearest.
        pixel_centres: False: u = 0 and 1 are the centres of the outermost pixels, as neural_renderer always read
            OBJ files. True: they are the picture's borders, half a pixel further out, as glTF and OpenGL define it.
    """
    if wrapping == "REPEAT":
        # Shift a face outside by whole images, so that it starts in the first one and may end exactly at 1.
        low, high = uv.min(axis=1, keepdims=True), uv.max(axis=1, keepdims=True)
        uv = np.where((low < -_BORDER) | (high > 1 + _BORDER), uv - np.floor(low + _BORDER), uv)
    grid = barycentric_grid(size)
    cubes = np.empty((len(uv), len(grid), 3), dtype=np.float32)
    step = max(1, 2**20 // len(grid))
    for start in range(0, len(uv), step):
        samples = np.einsum("gk,nkc->ngc", grid, uv[start : start + step])
        cubes[start : start + step] = _sample(image, samples, wrapping, bilinear, pixel_centres)
    return cubes.reshape(-1, size, size, size, 3)


def _sample(image: np.ndarray, uv: np.ndarray, wrapping: str, bilinear: bool, pixel_centres: bool) -> np.ndarray:
    height, width = image.shape[:2]
    outside = (uv < -_BORDER) | (uv > 1 + _BORDER)
    if wrapping == "REPEAT":
        uv = np.where(outside, uv - np.floor(uv), uv)
    elif wrapping == "MIRRORED_REPEAT":
        uv = 1 - np.abs(uv % 2 - 1)
    uv = uv.clip(0, 1)
    x, y = uv[..., 0], 1 - uv[..., 1]
    if pixel_centres:
        x, y = (x * width - 0.5).clip(0, width - 1), (y * height - 0.5).clip(0, height - 1)
    else:
        x, y = x * (width - 1), y * (height - 1)
    if bilinear:
        left, top = x.astype(np.int64), y.astype(np.int64)
        right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
        along, down = (x - left)[..., None].astype(np.float32), (y - top)[..., None].astype(np.float32)
        upper = image[top, left] * (1 - along) + image[top, right] * along
        colours = upper * (1 - down) + (image[bottom, left] * (1 - along) + image[bottom, right] * along) * down
    else:
        colours = image[(y + 0.5).astype(np.int64), (x + 0.5).astype(np.int64)]
    if wrapping == "CLAMP_TO_BORDER":
        colours = np.where(outside.any(axis=-1, keepdims=True), np.float32(0), colours)
    return colours
