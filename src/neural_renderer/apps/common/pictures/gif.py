"""GIF: animations with 256 colours for all images, dithered so that gradients have no bands."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

_SAMPLES = 1 << 18  # pixels of all images together that are sampled to choose the colours
_NEIGHBOURS = 3  # colours whose mean distance is the step between two shades
_PATTERN = np.zeros((1, 1))  # Bayer's order of the pixels of a tile: the share of brighter ones grows evenly
for _ in range(3):
    _PATTERN = np.block([[4 * _PATTERN, 4 * _PATTERN + 2], [4 * _PATTERN + 3, 4 * _PATTERN + 1]])
_PATTERN = (_PATTERN + 0.5) / _PATTERN.size - 0.5  # in (-½, ½)


def encode_gif(pictures: list[np.ndarray], fps: float) -> bytes:
    """Encode images [H, W, 3] uint8 of one size as a looping GIF.

    All images share one palette, and the pattern is fixed to the pixels: a still background stays still. Colours that
    the palette holds exactly are kept.
    """
    palette = _palette(pictures)
    colors = np.array(palette.getpalette(), np.int16).reshape(-1, 3)
    apart = np.linalg.norm((colors[:, None] - colors).astype(np.float32), axis=2)
    apart[apart == 0] = np.inf
    step = np.sort(apart, 1)[:, :_NEIGHBOURS].mean(1)
    step[np.isinf(step)] = 0  # of a single colour
    height, width = pictures[0].shape[:2]
    pattern = np.tile(_PATTERN, (height // 8 + 1, width // 8 + 1))[:height, :width].astype(np.float32)
    images = []
    for picture in pictures:
        nearest = np.asarray(_mapped(picture, palette))
        # Along its error, a colour that is a third of a step away from its nearest one gets the next one in a third of
        # the pixels, and one without error never does.
        error = (picture - colors[nearest]).astype(np.float32)
        length = np.sqrt(np.einsum("hwc,hwc->hw", error, error))
        error *= (step[nearest] * pattern / np.maximum(length, 1))[..., None]
        images.append(_mapped((picture + error + 0.5).clip(0, 255).astype(np.uint8), palette))
    duration, file = 10 * max(2, round(100 / fps)), io.BytesIO()
    images[0].save(file, "GIF", save_all=True, append_images=images[1:], duration=duration, loop=0, disposal=1)
    return file.getvalue()


def _palette(pictures: list[np.ndarray]) -> Image.Image:
    """Choose 256 colours for all images. A plain area keeps its own colour."""
    every = max(1, sum(picture[..., 0].size for picture in pictures) // _SAMPLES)
    pixels = np.concatenate([picture.reshape(-1, 3)[start % every :: every] for start, picture in enumerate(pictures)])
    palette = Image.fromarray(pixels[None]).quantize(256, dither=Image.Dither.NONE)
    red, green, blue = pixels.astype(np.int32).T
    numbers, counts = np.unique(red << 16 | green << 8 | blue, return_counts=True)
    colors = np.stack([numbers >> 16, numbers >> 8 & 255, numbers & 255], 1).astype(np.uint8)
    entries = np.asarray(_mapped(colors[None], palette))[0]
    chosen = np.array(palette.getpalette(), np.uint8).reshape(-1, 3)
    totals = np.bincount(entries, counts, len(chosen))
    plain = counts > totals[entries] / 2  # at most one colour of each entry
    chosen[entries[plain]] = colors[plain]
    palette.putpalette(chosen.tobytes())
    return palette


def _mapped(picture: np.ndarray, palette: Image.Image) -> Image.Image:
    return Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
