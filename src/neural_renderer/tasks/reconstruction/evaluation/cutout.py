"""Any picture of one object as a network wants it: cut out, and framed as the training data are."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ..data.framing import SIZE

EXTENT = 44  # pixels of the object's longest side, and how far below the middle its box's middle is: in the training
_LOWER = 1.5  # data that is so on average
_KEPT = 2048  # pixels of a picture's longest side: more show nothing more in 64
_LARGEST = 640  # pixels of the longest side in which an object is looked for
_SPECK = 0.02  # pieces smaller than this part of the largest one are dirt
_DETAIL = 8  # pixels: an object that is smaller shows nothing


def cut_out(image: Tensor, mask: Tensor | None = None) -> Tensor:
    """A picture with its object's transparency: [4, H, W] float32 in [0, 1], colours not multiplied by it.

    Larger pictures are made smaller, to 2048 pixels a side.

    image: [H, W, 3 or 4] in [0, 1], as `load_image` gives it. mask: [H, W] in [0, 1], 1 on the object, of the same
    size or shape; without it the image's transparency counts, and without that, what differs from a plain background.
    Specks are dropped.

    Raises ValueError where there is no object, none but the whole picture, or no plain background.
    """
    image = _bounded(image, _KEPT)
    rgb = image[..., :3].permute(2, 0, 1)
    height, width = rgb.shape[1:]
    if mask is not None:
        if abs(mask.shape[0] * width - mask.shape[1] * height) > 0.02 * width * mask.shape[0]:
            raise ValueError(
                f"mask: expected the shape of the image, {width} x {height}, got {mask.shape[1]} x {mask.shape[0]}"
            )
        alpha = _resized(mask[None], (height, width))[0]
    elif image.shape[2] == 4 and float(image[..., 3].min()) < 0.99:
        alpha = image[..., 3]
    else:
        small = _bounded(image, _LARGEST).permute(2, 0, 1)
        alpha = _resized(plain_background_mask(small[:3])[None], (height, width))[0]
    if float(alpha.max()) < 0.5:
        raise ValueError("expected an object, got a picture without one")
    if float(alpha.min()) > 0.5:
        raise ValueError("expected background around the object, got a mask that covers the whole picture")
    return torch.cat((rgb, without_specks(alpha)[None]))


def framed(rgba: Tensor, extent: float = EXTENT) -> Tensor:
    """A cut-out [4, H, W] as an image of the training data, uint8 [4, 64, 64]: at the same place, and as large.

    extent: pixels of the object's longer side; in the training data 30 to 59, by its shape (see `predict.best_frame`).

    Raises ValueError for an object of a few pixels.
    """
    rows, columns = (np.flatnonzero((rgba[3] > 0.5).any(axis).numpy()) for axis in (1, 0))
    if not len(rows):
        raise ValueError("expected an object, got a picture without one")
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    found = max(bottom - top, right - left)
    if found < _DETAIL:
        raise ValueError(f"expected an object of at least {_DETAIL} pixels, got one of {found}")
    side = found * SIZE / extent
    middle = torch.tensor([(left + right) / 2, (top + bottom) / 2 - _LOWER * side / SIZE])
    # Multiplied by alpha, so that the background's colour does not bleed in; and small first, against aliasing.
    pixels = torch.cat((rgba[:3] * rgba[3:], rgba[3:]))
    scale = min(1.0, 2 * SIZE / float(side))
    size = [max(1, round(scale * n)) for n in pixels.shape[1:]]
    small = F.interpolate(pixels[None], size, mode="bilinear", antialias=scale < 1, align_corners=False)
    place = (torch.arange(2 * SIZE) + 0.5) / (2 * SIZE) - 0.5
    y, x = torch.meshgrid(place * side + middle[1], place * side + middle[0], indexing="ij")
    grid = torch.stack((2 * x / rgba.shape[2] - 1, 2 * y / rgba.shape[1] - 1), -1).float()
    sampled = F.grid_sample(small, grid[None], padding_mode="zeros", align_corners=False)
    pixels = F.avg_pool2d(sampled, 2)[0].clamp(0, 1)
    pixels = pixels * (pixels[3:] > 0.5 / 255)
    colours = (pixels[:3] / pixels[3:].clamp(min=1e-6)).clamp(0, 1)
    return (torch.cat((colours, pixels[3:])) * 255 + 0.5).to(torch.uint8)


def plain_background_mask(rgb: Tensor) -> Tensor:
    """Where a picture [3, H, W] differs from its background: [H, W] in [0, 1], soft at the outline.

    The background is a colour that changes slowly, as a wall or paper in uneven light does: a quadratic in x and y,
    fitted to the picture's border. Up to a third of the border may be object. Raises ValueError where it is not plain.
    """
    height, width = rgb.shape[1:]
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
    basis = torch.stack((torch.ones_like(x), x, y, x * x, x * y, y * y), -1)
    depth = max(1, round(0.02 * min(height, width)))
    border = torch.ones(height, width, dtype=torch.bool)
    border[depth:-depth, depth:-depth] = False
    places, colours = basis[border], rgb[:, border].t()
    # Begin with the border's median, and let what is far from the background so far have no say.
    error = (colours - colours.median(0).values).abs().amax(1)
    for _ in range(8):
        kept = error <= max(float(error.quantile(0.65)), 0.02)
        weights = torch.linalg.lstsq(places[kept].double(), colours[kept].double()).solution.float()
        error = (colours - places @ weights).abs().amax(1)
    noise = float(error[error <= error.quantile(0.65)].square().mean().sqrt())
    threshold = max(0.06, 5 * noise)
    if threshold > 0.25 or float((error > threshold).float().mean()) > 0.34:
        raise ValueError(
            "expected transparency, a mask, or an object before a plain background, got a picture without a plain one"
        )
    distance = (rgb - (basis @ weights).permute(2, 0, 1)).abs().amax(0)
    return ((distance - 0.6 * threshold) / (0.8 * threshold)).clamp(0, 1)


def without_specks(alpha: Tensor) -> Tensor:
    """A mask [H, W] without pieces that are much smaller than the largest one."""
    small = _bounded(alpha[..., None], _LARGEST)[..., 0]
    label = pieces(small > 0.5)
    count = torch.bincount(label[label >= 0])
    kept = torch.isin(label, (count >= _SPECK * count.max()).nonzero()[:, 0])
    # A little wider than the piece, for its soft outline.
    wide = F.max_pool2d(kept[None, None].float(), 5, 1, 2)
    return alpha * F.interpolate(wide, tuple(alpha.shape), mode="nearest")[0, 0]


def pieces(mask: Tensor) -> Tensor:
    """A number for each connected piece of a mask [H, W] bool at all its pixels, -1 elsewhere: int64 [H, W]."""
    height, width = mask.shape
    index = torch.arange(height * width).reshape(height, width)
    across, down = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    ends = torch.cat(
        (
            torch.stack((index[:, 1:][across], index[:, :-1][across]), 1),
            torch.stack((index[1:][down], index[:-1][down]), 1),
        )
    )
    label = index.flatten()
    while True:  # the lowest index in reach, passed on from pixel to pixel and from label to label
        lowest = label[ends].amin(1)
        passed = label.scatter_reduce(0, ends.flatten(), lowest.repeat_interleave(2), "amin")
        passed = passed.scatter_reduce(0, label[ends].flatten(), lowest.repeat_interleave(2), "amin")
        passed = passed[passed]
        if torch.equal(passed, label):
            break
        label = passed
    return torch.where(mask, label.reshape(height, width), -1)


def _bounded(image: Tensor, most: int) -> Tensor:
    """[H, W, C], smaller if a side is longer than ``most``; colours count by their transparency, where there is any."""
    height, width = image.shape[:2]
    scale = most / max(height, width)
    if scale >= 1:
        return image
    weighted = image if image.shape[2] < 4 else torch.cat((image[..., :3] * image[..., 3:], image[..., 3:]), 2)
    size = (max(1, round(scale * height)), max(1, round(scale * width)))
    small = _resized(weighted.permute(2, 0, 1), size).permute(1, 2, 0)
    if image.shape[2] < 4:
        return small
    return torch.cat((small[..., :3] / small[..., 3:].clamp(min=1e-6), small[..., 3:]), 2)


def _resized(image: Tensor, size: tuple[int, int]) -> Tensor:
    """[C, H, W] at another size."""
    if tuple(image.shape[1:]) == size:
        return image
    return F.interpolate(image[None], size, mode="bilinear", antialias=True, align_corners=False)[0].clamp(0, 1)
