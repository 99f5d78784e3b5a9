"""Masks that photographs without cameras come with: files, transparency, or what a plain background leaves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from ...io import load_image, save_image
from ...io.images import size_of
from ..masks.operations import limit_size, resize
from ..masks.rule import MaskRule, mask_beside, mask_in_file, transparency
from .copies import IMAGES, MASKS, Photographs, Progress

_SIDE = 640  # pixels of the longer side of pictures that are cut out by their background
_LEAST_SHARE = 0.8  # share of the photographs that a rule must cut out; the masks of the others follow from these
_LEAST_OBJECT, _MOST_OBJECT = 0.002, 0.9  # share of a picture that an object takes up


def write_known_masks(photographs: Photographs, folders: list[Path], rule: MaskRule, progress: Progress) -> bool:
    """Write the masks of photographs that can be had without cameras, as large as the copies; tell if there are any.

    Masks in the folders come first, in this order; the rule separates the object where there is no mask, unless it
    leaves too many photographs without.
    """
    target, names = photographs.folder / MASKS, photographs.names
    given, found, failures = 0, [], 0
    for done, name in enumerate(names):
        progress("masks", done, len(names))
        copy = photographs.folder / IMAGES / name
        if file := next(filter(None, (photographs.find_mask(folder, name) for folder in folders)), None):
            given += 1
            own = mask_beside(target, name)
            if own is None or not own.samefile(file) or size_of(own) != size_of(copy):
                mask = resize(mask_in_file(file, upright=True)[None], size_of(copy))[0]
                save_image(target / f"{name}.png", mask)
        elif failures <= (1 - _LEAST_SHARE) * len(names):
            try:
                found.append((name, _mask(copy, rule)))
            except ValueError:
                failures += 1
    found = found if failures <= (1 - _LEAST_SHARE) * len(names) else []
    for name, mask in found:
        save_image(target / f"{name}.png", mask)
    progress("masks", len(names), len(names))
    return bool(given or found)


def _mask(path: Path, rule: MaskRule) -> torch.Tensor:
    """Separate the object [H, W] of a copy by a rule. Raises ValueError if there is none."""
    image = load_image(path)
    size = image.shape[0], image.shape[1]
    alpha = transparency(image)
    if alpha is None:
        small = limit_size(image, _SIDE)
        alpha = resize(rule.reduced(max(1, round(max(size) / _SIDE))).find(small)[None], size)[0]
    if not _LEAST_OBJECT < float(np.mean(alpha.numpy() > 0.5)) < _MOST_OBJECT:
        raise ValueError(f"{path}: expected an object before a plain background, got none")
    return alpha
