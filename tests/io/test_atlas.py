"""The texture atlas: places of tiles, and the pixels around them."""

from __future__ import annotations

import numpy as np

from neural_renderer.io.atlas import build_atlas


def test_each_face_finds_its_colours() -> None:
    """At the corners of a tile are the texels of the corners, in whatever order the tiles lie."""
    cubes = np.random.default_rng(0).random((50, 3, 3, 3, 3), dtype=np.float32)
    picture, pixels = build_atlas(cubes)
    x, y = pixels.astype(int).transpose(2, 0, 1)
    corners = np.stack([cubes[:, 2, 0, 0], cubes[:, 0, 2, 0], cubes[:, 0, 0, 2]], axis=1)
    assert np.abs(picture[y, x] / 255 - corners).max() < 0.51 / 255
    assert len({tuple(place) for place in pixels[:, 0].tolist()}) == 50


def test_tiles_of_one_colour_lie_together() -> None:
    """Mipmaps blend neighbouring tiles: of four colours in random order three borders are left."""
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.9, 0.9, 0.9]], dtype=np.float32)
    chosen = np.random.default_rng(0).integers(0, 4, 900)
    _, pixels = build_atlas(np.broadcast_to(colors[chosen, None, None, None], (900, 2, 2, 2, 3)))
    in_order = chosen[np.lexsort((pixels[:, 0, 0], pixels[:, 0, 1]))]
    assert np.count_nonzero(np.diff(in_order)) == 3
