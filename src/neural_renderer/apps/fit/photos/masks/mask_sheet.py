"""Contact sheet of photographs with their masks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from .....io.images import load_reduced
from ....common.masks.operations import centered, resize, upright
from ....common.masks.rule import mask_beside, mask_in_file
from ....common.pictures.sheet import sheet
from ....common.views.views import downscale

_SIDE, _COLUMNS, _ROWS = 320, 4, 3
_OUTSIDE = (0.75, 0.15, 0.55)  # colour of the background, which no object has
_FADED = 0.3  # of the picture, outside


def mask_sheet(files: Sequence[Path], masks: Path, turns: dict[str, int]) -> Tensor:
    """Draw up to twelve photographs, evenly spaced, with the outside of their masks tinted: [H, W, 3] uint8.

    Those in ``turns``, see `turns_of`, are turned upright.
    """
    count = min(len(files), _COLUMNS * _ROWS)
    chosen = [files[row * len(files) // count] for row in range(count)]
    tiles = [upright(mask_tile(file, masks), turns.get(file.name, 0)) for file in chosen]
    size = max(tile.shape[1] for tile in tiles), max(tile.shape[2] for tile in tiles)
    tiles = [centered(tile, size, 1.0) for tile in tiles]
    tiles += [torch.ones_like(tiles[0])] * (-count % _COLUMNS)
    return sheet([tiles[row : row + _COLUMNS] for row in range(0, len(tiles), _COLUMNS)])


def mask_tile(file: Path, masks: Path, side: int = _SIDE) -> Tensor:
    """Draw a photograph [3, H, W] with its mask."""
    picture = downscale(load_reduced(file, least=side)[0][..., :3].permute(2, 0, 1), side)
    found = mask_beside(masks, file.name)
    if found is None:
        return picture
    inside = resize(mask_in_file(found)[None], (picture.shape[1], picture.shape[2]))
    return torch.where(inside > 0.5, picture, _FADED * picture + (1 - _FADED) * torch.tensor(_OUTSIDE)[:, None, None])
