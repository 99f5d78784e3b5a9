"""One picture from many cubes: a tile per face, for the formats that know only images and texture coordinates.

A tile shows its face as a right triangle, corners at pixels (1, 1), (1, 1 + n) and (1 + n, 1 + n), n a multiple of
T - 1, if that is not 0, so that the texels in the plane of the face fall on pixels. The rest of the tile carries the
colours on across the triangle's border, so that a viewer which blends neighbouring pixels draws no seam. One with
mipmaps blends neighbouring tiles as well, so tiles of similar colour lie together.
"""

from __future__ import annotations

import math

import numpy as np

_LARGEST = 8192  # pixels: the widest texture that every viewer and GPU takes
_TRIANGLE = np.array([[0, 0], [0, 1], [1, 1]])  # (x, y down) of the corners in units of n


def build_atlas(textures: np.ndarray, tile: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Draw the cubes of a mesh into one picture.

    Args:
        textures: [F, T, T, T, 3] float32 in [0, 1].
        tile: the width of a tile in pixels, at least 4; None chooses it as told below.

    Returns:
        The picture, [H, W, 3] uint8, first row on top, and where each face's corners are in it: [F, 3, 2] float64
        pixel positions (x right, y down; pixel 0's centre is 0). Tiles are about 15 pixels wide, up to 50 if all
        fit in 1024, fewer for meshes of more than 290,000 faces so that all fit in 8192; ValueError if they cannot.
    """
    faces, size = textures.shape[:2]
    columns = math.ceil(math.sqrt(faces))
    rows = math.ceil(faces / columns)
    span = _span(size, columns) if tile is None else tile - 3
    tile = span + 3
    weights, used = _tile_weights(size, span), _face_texels(size)
    picture = np.zeros((rows * tile, columns * tile, 3), dtype=np.uint8)
    texels = textures.reshape(faces, -1, 3)[:, used]
    order = _by_colour(texels.mean(axis=1))
    for row in range(rows):
        own = texels[order[row * columns : (row + 1) * columns]]
        colours = weights @ own.transpose(1, 0, 2).reshape(len(used), -1)
        colours = (colours.clip(0, 1) * 255 + 0.5).astype(np.uint8).reshape(tile, tile, -1, 3)
        strip = colours.transpose(0, 2, 1, 3).reshape(tile, -1, 3)
        picture[row * tile : (row + 1) * tile, : strip.shape[1]] = strip
    index = np.argsort(order)
    origins = np.stack([index % columns, index // columns], axis=1) * tile + 1
    return picture, (origins[:, None] + _TRIANGLE * span).astype(np.float64)


def coordinates(pixels: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Texture coordinates of pixel positions [..., 2] on a picture [H, W, 3] whose borders are 0 and 1, v up."""
    return (pixels + 0.5) / [picture.shape[1], picture.shape[0]] * [1, -1] + [0, 1]


def _by_colour(means: np.ndarray) -> np.ndarray:
    """An order [F] of colours [F, 3] in which neighbours are alike: along a Z-curve through the cube of colours."""
    levels = (means.clip(0, 1) * 31).astype(np.int64)
    code = np.zeros(len(means), dtype=np.int64)
    for bit in range(5):
        for channel in range(3):
            code |= ((levels[:, channel] >> bit) & 1) << (3 * bit + channel)
    return np.argsort(code, kind="stable")


def _span(size: int, columns: int) -> int:
    """Pixels from corner to corner: in steps of T - 1, unless the picture would become too wide."""
    steps = max(size - 1, 1)
    span = max(1, round(min(48, max(12, 1024 // columns - 3)) / steps)) * steps
    most = _LARGEST // columns - 3
    if most < 1:
        raise ValueError(
            f"textures: expected at most {(_LARGEST // 4) ** 2} faces for a picture of {_LARGEST} pixels, got about "
            f"{columns**2}; write the mesh without textures, as PLY with vertex colours, or in parts"
        )
    if span > most:
        span = max(most // steps * steps, min(most, steps))
    return span


def _tile_weights(size: int, span: int) -> np.ndarray:
    """How each pixel of a tile mixes the texels of the face: [tile * tile, K] float32.

    A pixel outside the triangle takes twice the colour at the nearest point of the border minus the colour as far
    inside: then two pixels on either side of the border average to the colour on it.
    """
    y, x = (np.indices((span + 3, span + 3)) - 1).reshape(2, -1) / span
    wanted = np.stack([1 - y, y - x, x], axis=1)
    border = _nearest_in_triangle(wanted)
    inward = (border - wanted) * np.minimum(1, 1.5 / span / np.abs(border - wanted).max(axis=1).clip(1e-9))[:, None]
    return 2 * _trilinear(border, size) - _trilinear(_nearest_in_triangle(border + inward), size)


def _nearest_in_triangle(weights: np.ndarray) -> np.ndarray:
    """The nearest weights [N, 3] that are all at least 0, still adding up to 1."""
    for _ in range(2):
        weights = weights.clip(0)
        positive = weights > 0
        excess = (weights.sum(axis=1) - 1) / positive.sum(axis=1)
        weights = weights - positive * excess[:, None]
    return weights.clip(0)


def _face_texels(size: int) -> np.ndarray:
    """The texels of a cube that the renderer ever blends: [K] int64 positions in its T * T * T."""
    total = np.indices((size, size, size)).sum(axis=0).reshape(-1)
    return np.flatnonzero((total >= size - 3) & (total <= size + 1))


def _trilinear(barycentric: np.ndarray, size: int) -> np.ndarray:
    """The weights [N, K] float32 of the face's texels that the renderer blends at barycentric weights [N, 3]."""
    used = _face_texels(size)
    column = np.zeros(size**3, dtype=np.int64)  # the other texels have weight 0 and may add it anywhere
    column[used] = np.arange(len(used))
    at = barycentric * (size - 1)
    low = np.floor(at + 1e-9).clip(0, max(size - 2, 0)).astype(np.int64)
    part = (at - low).clip(0, 1)
    weights = np.zeros((len(at), len(used)), dtype=np.float32)
    for corner in np.ndindex(2, 2, 2):
        share = np.where(corner, part, 1 - part).prod(axis=1)
        texel = np.ravel_multi_index(tuple(np.minimum(low + corner, size - 1).T), (size, size, size))
        weights[np.arange(len(at)), column[texel]] += share
    return weights
