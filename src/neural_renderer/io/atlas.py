"""Texture atlas: one image with a tile per face, for file formats without texture cubes.

A tile shows its face as a right triangle with corners at pixels (1, 1), (1, 1 + n) and (1 + n, 1 + n). n is a multiple
of T − 1 (if T > 1), so that the texels in the plane of the face fall on pixels. The rest of the tile extrapolates the
colours beyond the triangle, so that bilinear viewers draw no seams. Viewers with mipmaps blend adjacent tiles, so tiles
of similar colour are placed together.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from .cubes import trilinear_texels

_LARGEST = 8192  # pixels: all viewers and GPUs accept textures of this width
_GOOD_WIDTH = 1024  # pixels: tiles grow as long as the picture stays this narrow
_LEAST_SPAN, _MOST_SPAN = 12, 48  # pixels of n, unless the picture would be wider than `_LARGEST`
_BORDER = 3  # pixels of a tile besides n
_COLOR_BITS = 5  # bits of each channel that decide the order of tiles
_TRIANGLE = np.array([[0, 0], [0, 1], [1, 1]])  # (x, y down) of the corners in units of n


def build_atlas(textures: np.ndarray, tile: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Draw texture cubes [F, T, T, T, 3] float32 in [0, 1] into one image; ValueError if there are too many faces.

    A tile is ``tile`` ≥ 4 pixels wide, or as `_span` chooses. Returns the image [H, W, 3] uint8, and the pixel
    positions of the faces' corners, [F, 3, 2] float64 (x right, y down; pixel 0 has its centre at 0).
    """
    faces, size = textures.shape[:2]
    columns = math.ceil(math.sqrt(faces))
    rows = math.ceil(faces / columns)
    span = _span(size, columns) if tile is None else tile - _BORDER
    tile = span + _BORDER
    weights, used = _tile_weights(size, span), _face_texels(size)
    picture = np.zeros((rows * tile, columns * tile, 3), dtype=np.uint8)
    texels = textures.reshape(faces, -1, 3)[:, used]
    order = _by_color(texels.mean(axis=1))
    for row in range(rows):
        cubes = texels[order[row * columns : (row + 1) * columns]]
        # By torch, as numpy's threads spin while they wait: up to 20 times as long while other programs run.
        colors = (torch.from_numpy(weights) @ torch.from_numpy(cubes.transpose(1, 0, 2).reshape(len(used), -1))).numpy()
        colors = (colors.clip(0, 1) * 255 + 0.5).astype(np.uint8).reshape(tile, tile, -1, 3)
        strip = colors.transpose(0, 2, 1, 3).reshape(tile, -1, 3)
        picture[row * tile : (row + 1) * tile, : strip.shape[1]] = strip
    index = np.argsort(order)
    origins = np.stack([index % columns, index // columns], axis=1) * tile + 1
    return picture, (origins[:, None] + _TRIANGLE * span).astype(np.float64)


def coordinates(pixels: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Convert pixel positions [..., 2] on a picture [H, W, 3] to texture coordinates (v up, 0 and 1 at the borders)."""
    return (pixels + 0.5) / [picture.shape[1], picture.shape[0]] * [1, -1] + [0, 1]


def _by_color(means: np.ndarray) -> np.ndarray:
    """Sort colours [F, 3] along a Z-curve through the RGB cube, so that neighbours are similar; return their order."""
    levels = (means.clip(0, 1) * (2**_COLOR_BITS - 1)).astype(np.int64)
    code = np.zeros(len(means), dtype=np.int64)
    for bit in range(_COLOR_BITS):
        for channel in range(3):
            code |= ((levels[:, channel] >> bit) & 1) << (3 * bit + channel)
    return np.argsort(code, kind="stable")


def _span(size: int, columns: int) -> int:
    """Choose n, the pixels between two corners: a multiple of T − 1, unless the picture would become too wide.

    A tile has about 15 pixels, up to 50 in narrow pictures, and fewer for meshes of more than 290,000 faces.
    """
    steps = max(size - 1, 1)
    span = max(1, round(min(_MOST_SPAN, max(_LEAST_SPAN, _GOOD_WIDTH // columns - _BORDER)) / steps)) * steps
    most = _LARGEST // columns - _BORDER
    if most < 1:
        limit = (_LARGEST // (_BORDER + 1)) ** 2
        raise ValueError(
            f"textures: expected at most {limit} faces for a picture of {_LARGEST} pixels, got about {columns**2}; "
            "write the mesh without textures, as PLY with vertex colours, or in parts"
        )
    if span > most:
        span = max(most // steps * steps, min(most, steps))
    return span


def _tile_weights(size: int, span: int) -> np.ndarray:
    """Compute the weights of the face's texels in each pixel of a tile, [tile · tile, K] float32.

    A pixel outside the triangle is extrapolated: twice the colour of the nearest border point minus the colour at the
    same distance inside. The mean of two pixels on either side of the border is then the colour of the border.
    """
    y, x = (np.indices((span + _BORDER, span + _BORDER)) - 1).reshape(2, -1) / span
    wanted = np.stack([1 - y, y - x, x], axis=1)
    border = _nearest_in_triangle(wanted)
    inward = (border - wanted) * np.minimum(1, 1.5 / span / np.abs(border - wanted).max(axis=1).clip(1e-9))[:, None]
    return 2 * _trilinear(border, size) - _trilinear(_nearest_in_triangle(border + inward), size)


def _nearest_in_triangle(weights: np.ndarray) -> np.ndarray:
    """Project barycentric weights [N, 3] onto the triangle: all ≥ 0, sum 1."""
    for _ in range(2):
        weights = weights.clip(0)
        positive = weights > 0
        excess = (weights.sum(axis=1) - 1) / positive.sum(axis=1)
        weights = weights - positive * excess[:, None]
    return weights.clip(0)


def _face_texels(size: int) -> np.ndarray:
    """Find the texels of a cube that rendering can read, [K] int64 indices into its T · T · T."""
    total = np.indices((size, size, size)).sum(axis=0).reshape(-1)
    return np.flatnonzero((total >= size - 3) & (total <= size + 1))


def _trilinear(barycentric: np.ndarray, size: int) -> np.ndarray:
    """Compute the renderer's trilinear weights [N, K] float32 at barycentric weights [N, 3]."""
    used = _face_texels(size)
    column = np.zeros(size**3, dtype=np.int64)  # unused texels have weight 0, so their column does not matter
    column[used] = np.arange(len(used))
    index, shares = trilinear_texels(barycentric, size)
    weights = np.zeros((len(barycentric), len(used)), dtype=np.float32)
    for corner in range(8):
        weights[np.arange(len(index)), column[index[:, corner]]] += shares[:, corner]
    return weights
