"""Pictures of an object, cut out around it at several sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

_CLOSE = 0.06  # of a crop's side, from the mask
_CLOSE_PRICE, FAR_PRICE = 0.6, 0.15
_KNOWN = 0.99  # share of a pixel whose depth is known


@dataclass(frozen=True, eq=False)
class Crop:
    """A square part of a picture, reduced to n × n pixels.

    Attributes:
        K: [3, 3], intrinsic matrix of the crop in pixels.
        images: [3, n, n]: red, green and blue times the mask; or None.
        mask: [n, n] in [0, 1].
        depth: [n, n], 0 where it is not known; or None.
        known: [n, n] in [0, 1], 0 outside of the picture.
    """

    K: Tensor
    images: Tensor | None
    mask: Tensor
    depth: Tensor | None
    known: Tensor

    @property
    def size(self) -> int:
        """Side in pixels."""
        return self.mask.shape[-1]

    def beside(self, far: float = FAR_PRICE) -> Tensor:
        """Compute residuals [n, n] of covering pixels outside of the mask, for objects that may be occluded.

        They are large close to the mask, so that outlines coincide, and small farther away, where an occluder may be.
        """
        reach = max(1, round(_CLOSE * self.size))
        close = F.max_pool2d(self.mask[None], 2 * reach + 1, 1, reach)[0]
        return far + (_CLOSE_PRICE - far) * close


@dataclass(frozen=True, eq=False)
class Picture:
    """Picture of an object from one camera.

    Attributes:
        K: [3, 3], intrinsic matrix in pixels; the pixel in the corner has its centre at (0.5, 0.5).
        mask: [H, W] in [0, 1].
        photo: [3, H, W], or None.
        depth: [H, W] along the viewing axis, 0 where it is not known; or None.
        motion: [3, 4], from the space of the first camera to that of this one.
    """

    K: Tensor
    motion: Tensor
    mask: Tensor
    photo: Tensor | None = None
    depth: Tensor | None = None

    def window(self, margin: float) -> tuple[float, float, float]:
        """Find the square that holds the object: its centre in pixels, x and y, and its side.

        ``margin`` is the side relative to that of the mask.
        """
        rows, columns = (torch.nonzero(self.mask.amax(axis) > 0.5).flatten() for axis in (1, 0))
        top, bottom, left, right = (float(v) for v in (rows[0], rows[-1] + 1, columns[0], columns[-1] + 1))
        return (left + right) / 2, (top + bottom) / 2, margin * max(bottom - top, right - left) + 2

    def crop(self, window: tuple[float, float, float], size: int) -> Crop:
        """Cut out a square and reduce it to about this side in pixels; it is not enlarged."""
        height, width = self.mask.shape
        x, y, side = window
        step = max(1, math.ceil(side / size))
        size = min(size, math.ceil(side / step))
        left, top = round(x - step * size / 2), round(y - step * size / 2)
        layers = [torch.ones(1, height, width), self.mask[None]]
        if self.photo is not None:
            layers.append(self.photo * self.mask)
        if self.depth is not None:
            layers += [(self.depth > 0).float()[None], self.depth[None]]
        whole = torch.cat(layers)
        right, bottom = left + step * size - width, top + step * size - height
        part = F.avg_pool2d(F.pad(whole, (-left, right, -top, bottom))[None], step)[0]
        K = self.K.clone()
        K[:2] = (K[:2] - K.new_tensor([[0, 0, left], [0, 0, top]])) / step
        colors = part[2:5] if self.photo is not None else None
        depth = torch.where(part[-2] > _KNOWN, part[-1], 0.0) if self.depth is not None else None
        return Crop(K, colors, part[1], depth, part[0])
