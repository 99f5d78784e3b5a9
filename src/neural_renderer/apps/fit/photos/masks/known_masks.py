"""Masks of photographs without cameras: from files, transparency or a plain background."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from .....io import load_image, save_image
from .....io.images import size_of
from ....common.masks.operations import SAME_SHAPE, SMALL_HOLE, centered, erode, fill_holes, limit_size, resize, upright
from ....common.masks.rule import MOST_SEARCHED, MaskRule, border_pattern, mask_beside, mask_in_file, transparency
from ..copies import IMAGES, MASKS, Photographs, Progress, turns_of
from ..found import FOUND, found_masks

_LEAST_SHARE = 0.8  # least share of the photographs that a rule cuts out; their masks give those of the others
_LEAST_OBJECT, _MOST_OBJECT = 0.002, 0.9  # share of a picture that an object takes up
_MOST_PATTERN = 0.015  # greatest pattern of a plain background: unevenly lit paper has less, a patterned cloth 0.03
_STEP, _MOST_FAINT = 0.05, 0.4  # change of colour across an outline, and share of it that may show less
_MOST_HOLES = 0.12  # share of an object that all holes by mistake take up


def write_known_masks(
    photographs: Photographs, folders: list[Path], rule: MaskRule, progress: Progress
) -> dict[str, int]:
    """Write the masks that need no cameras, of the size of the copies; count them by origin.

    Masks in the folders come first, in this order; the rule separates the object where there is no mask. If it
    finds none in too many photographs, its masks of the others are accidental, and are not written.
    """
    target, names = photographs.folder / MASKS, photographs.names
    origins: Counter[str] = Counter()
    found, failures, earlier, turns = [], 0, found_masks(target), turns_of(photographs.folder)
    for done, name in enumerate(names):
        progress("masks", done, len(names))
        copy = photographs.folder / IMAGES / name
        if file := next(filter(None, (photographs.find_mask(folder, name) for folder in folders)), None):
            present = mask_beside(target, name)
            is_found = name in earlier and present is not None and present.samefile(file)
            origins[FOUND if is_found else f"files in {file.parent}"] += 1
            if present is None or not present.samefile(file) or size_of(present) != size_of(copy):
                mask = _laid(mask_in_file(file, upright=True)[None], size_of(copy), turns.get(name, 0))
                save_image(target / f"{name}.png", mask[0])
        elif failures <= (1 - _LEAST_SHARE) * len(names):
            try:
                found.append((name, *_mask(copy, rule)))
            except ValueError:
                failures += 1
    found = found if failures <= (1 - _LEAST_SHARE) * len(names) else []
    for name, mask, origin in found:
        origins[origin] += 1
        save_image(target / f"{name}.png", mask)
    progress("masks", len(names), len(names))
    return origins


def _laid(mask: torch.Tensor, size: tuple[int, int], turn: int) -> torch.Tensor:
    """Lay a mask [1, H, W] as a copy of some size lies, if their shapes differ: turned back, and with added borders."""
    if abs(mask.shape[1] * size[1] / (mask.shape[2] * size[0]) - 1) < SAME_SHAPE:
        return resize(mask, size)
    if (mask.shape[1] > mask.shape[2]) == (turn > 0):
        mask = upright(mask, {6: 8, 8: 6}.get(turn, turn))
    scale = min(size[0] / mask.shape[1], size[1] / mask.shape[2])
    return centered(resize(mask, (round(mask.shape[1] * scale), round(mask.shape[2] * scale))), size)


def _mask(path: Path, rule: MaskRule) -> tuple[torch.Tensor, str]:
    """Separate the object [H, W] of a copy by a rule, and name the origin of the mask; ValueError if there is none.

    A rule without colours looks for a plain background. One with a pattern, or with the object's colours, leaves holes;
    of one that darkens too much towards the corners a spot in the middle stands out, whose outline no colours show.
    """
    image = load_image(path)
    size = image.shape[0], image.shape[1]
    alpha, origin = transparency(image), "transparency"
    if alpha is None:
        small = limit_size(image, MOST_SEARCHED)
        found = rule.reduced(max(1, round(max(size) / MOST_SEARCHED))).find(small)
        origin = "the options for masks"
        if rule.below is None and rule.background is None:
            origin, inside = "a plain background", found > 0.5
            holes = int((fill_holes(inside, SMALL_HOLE) & ~inside).sum())
            if border_pattern(small) > _MOST_PATTERN or holes > _MOST_HOLES * int(inside.sum()):
                raise ValueError(f"{path}: expected a plain background, got a pattern, or holes in the object")
            if _faint(small, inside) > _MOST_FAINT:
                raise ValueError(f"{path}: expected an object with an outline before a plain background, got none")
        alpha = resize(found[None], size)[0]
    if not _LEAST_OBJECT < float(np.mean(alpha.numpy() > 0.5)) < _MOST_OBJECT:
        raise ValueError(f"{path}: expected an object before a plain background, got none")
    return alpha, origin


def _faint(image: torch.Tensor, inside: torch.Tensor) -> float:
    """Measure the share of the outline of an object [H, W] across which the colours of a picture change little."""
    smooth = F.avg_pool2d(image[..., :3].permute(2, 0, 1), 3, 1, 1)
    change = F.max_pool2d(smooth, 9, 1, 4) + F.max_pool2d(-smooth, 9, 1, 4)
    outline = inside & ~erode(inside, 1)
    return float((change.amax(0)[outline] < _STEP).float().mean()) if bool(outline.any()) else 1.0
