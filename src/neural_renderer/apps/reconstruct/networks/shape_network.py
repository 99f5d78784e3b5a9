"""`ShapeNetwork`: voxels, category and pose from one cropped picture.

A U-net predicts features in the frustum of the picture, as in "Pixels, voxels, and views" (Shin, Fowlkes and Hoiem,
CVPR 2018). Given the pose of the picture, they are sampled in the frame of the object, and mirrored at its plane of
symmetry. A decoder of the whole picture adds what the picture hides; a small network combines both in each voxel.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..data.framing import GRID, VIEWS
from ..data.voxels import voxel_centers
from ..shapes.views import camera_points, published_crops

_DEPTHS = 32  # samples of the frustum along the depth
_DEEP = 0.8  # half the depth of the frustum, for an object of longest side 1
_CODE, _POSE = 256, 9  # numbers that describe a picture, and its pose
_TRIED = 8  # azimuths that are tried
_LIKELY, _CERTAIN = 0.1, 0.5  # weights in the choice, relative to that of outlines

Known = Literal["nothing", "camera", "view"]


class ShapeNetwork(nn.Module):
    """Network from cropped pictures [B, 4, 64, 64] in [0, 1] to voxels [B, 32, 32, 32] of objects.

    Poses [B, 6] are those of `shapes.views`. The voxels are in the published axes.

    Attributes:
        kind: "shape".

    Example:
        >>> network = ShapeNetwork()
        >>> network.occupancy(torch.rand(2, 4, 64, 64)).shape
        torch.Size([2, 32, 32, 32])
    """

    kind = "shape"
    points: Tensor

    def __init__(self, classes: int = 13, width: int = 24) -> None:
        super().__init__()
        widths = (width, 2 * width, 4 * width, 6 * width)
        self.stem = _layer(4, widths[0], 5, 2)
        self.down = nn.ModuleList(nn.Sequential(_layer(i, o, 3, 2), _Residual(o)) for i, o in pairwise(widths))
        self.code = nn.Sequential(nn.Flatten(), nn.Linear(16 * widths[3], _CODE), nn.SiLU())
        self.category = nn.Linear(_CODE, classes)
        self.azimuth = nn.Linear(_CODE, VIEWS)
        self.camera = nn.Linear(_CODE, 5)
        self.posed = nn.Sequential(nn.Linear(_CODE + _POSE, _CODE), nn.SiLU())
        self.spread = nn.Linear(_CODE, widths[3])
        self.up = nn.ModuleList(_layer(i + o, o, 3, 1) for i, o in zip(widths[:0:-1], widths[-2::-1], strict=True))
        self.frustum = nn.Conv2d(widths[0], 2 * _DEPTHS, 1)
        self.hidden = nn.Sequential(
            nn.Linear(_CODE, 32 * 64),
            nn.Unflatten(1, (32, 4, 4, 4)),
            nn.GroupNorm(4, 32),
            nn.ReLU(),
            nn.ConvTranspose3d(32, 16, 4, stride=2, padding=1),
            nn.GroupNorm(4, 16),
            nn.ReLU(),
            nn.ConvTranspose3d(16, 2, 4, stride=2, padding=1),
        )
        self.combine = nn.Sequential(nn.Linear(8, 24), nn.ReLU(), nn.Linear(24, 1))
        self.register_buffer("points", voxel_centers(), persistent=False)

    def encode(self, images: Tensor) -> list[Tensor]:
        """Compute features of pictures at 32, 16, 8 and 4 pixels, and their codes [B, 256]."""
        levels = [self.stem(torch.cat((images[:, :3] * images[:, 3:], images[:, 3:]), 1) * 2 - 1)]
        for layer in self.down:
            levels.append(layer(levels[-1]))
        return [*levels, self.code(levels[-1])]

    def pose_outputs(self, code: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits of azimuths, [B, 24], and the five other numbers, [B, 5] (see `pose_targets`)."""
        return self.azimuth(code), self.camera(code)

    def recognize(self, images: Tensor, count: int = 1) -> tuple[Tensor, Tensor, Tensor]:
        """Predict category and the ``count`` likeliest poses: means over pictures [B, 4, 64, 64] and their mirrors.

        Returns probabilities of categories [B, classes], poses [count, B, 6], and the logarithms of their
        probabilities.
        """
        both = [self.encode(seen)[-1] for seen in (images, images.flip(3))]
        category = torch.stack([self.category(code).softmax(1) for code in both]).mean(0)
        (logits, others), (turned, flipped) = (self.pose_outputs(code) for code in both)
        back = (VIEWS // 2 - torch.arange(VIEWS, device=images.device)) % VIEWS  # mirrored at x = 0, φ becomes π − φ
        scores, bins = ((logits + turned[:, back]) / 2).log_softmax(1).topk(count)
        others = (others + flipped * others.new_tensor([1, 1, -1, 1, 1])) / 2
        rest = camera_numbers(others)
        poses = [torch.cat((column[:, None] * (2 * math.pi / VIEWS), rest), 1) for column in bins.T]
        return category, torch.stack(poses), scores.T

    def voxel_logits(self, levels: list[Tensor], images: Tensor, pose: Tensor, chosen: Tensor | None = None) -> Tensor:
        """Compute logits [B, N] of voxels from the result of `encode`, the pictures, and their poses [B, 6].

        ``chosen`` [N] are indices of voxels, in the order of a flat grid; by default all 32³.
        """
        *features, code = levels
        code = self.posed(torch.cat((code, _pose_features(pose)), 1))
        value = features[-1] + self.spread(code)[:, :, None, None]
        for layer, skip in zip(self.up, features[-2::-1], strict=True):
            value = layer(torch.cat((F.interpolate(value, scale_factor=2.0), skip), 1))
        volume = self.frustum(value).unflatten(1, (2, _DEPTHS))

        points = self.points if chosen is None else self.points[chosen]
        both = torch.cat((points, points * points.new_tensor([-1.0, 1.0, 1.0])))  # and mirrored
        place = camera_points(both, pose)
        grid = torch.stack((place[..., 0], -place[..., 1], (place[..., 2] - pose[:, 2:3]) / _DEEP), -1)
        seen = F.grid_sample(volume, grid[:, :, None, None], padding_mode="border", align_corners=False)
        outline = F.grid_sample(images[:, 3:], grid[:, :, None, :2], align_corners=False)
        seen = torch.cat((seen[..., 0, 0], outline[..., 0] * 4 - 2), 1)
        x, y, z = points.unbind(-1)
        inner = (2 * torch.stack((x, -z, y), -1))[None, :, None, None].expand(len(images), -1, -1, -1, -1)
        hidden = F.grid_sample(self.hidden(code), inner, align_corners=True)[..., 0, 0]
        stack = torch.cat((*seen.chunk(2, 2), hidden), 1)
        return self.combine(stack.transpose(1, 2))[..., 0] + hidden[:, 0] + stack[:, 0]

    def voxels(self, levels: list[Tensor], images: Tensor, pose: Tensor) -> Tensor:
        """Predict probabilities [B, 32, 32, 32] from the result of `encode`, the pictures, and their poses [B, 6]."""
        return self.voxel_logits(levels, images, pose).sigmoid().reshape(-1, GRID, GRID, GRID)

    def occupancy(self, images: Tensor, pose: Tensor | None = None) -> Tensor:
        """Predict probabilities [B, 32, 32, 32] that voxels are filled; a missing pose is that of `search`."""
        return self.search(images)[0] if pose is None else self.voxels(self.encode(images), images, pose)

    def search(self, images: Tensor, camera: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Predict voxels for the eight likeliest azimuths, and choose one.

        The choice adds the likelihood of the azimuth, the agreement of outlines, and the IoU that the probabilities of
        the voxels let expect. The azimuths of the poses ``camera`` [B, 6] are unknown; None to predict all numbers.
        Returns probabilities of voxels, poses, and probabilities of categories [B, classes].
        """
        levels = self.encode(images)
        category, poses, scores = self.recognize(images, _TRIED)
        if camera is not None:
            poses = torch.cat((poses[..., :1], camera[None, :, 1:].expand(_TRIED, -1, -1)), 2)
        results = torch.stack([self.voxels(levels, images, pose) for pose in poses])
        fits = torch.stack([outline_iou(result, images, pose) for result, pose in zip(results, poses, strict=True)])
        chosen = (fits + _LIKELY * scores + _CERTAIN * expected_iou(results)).argmax(0), torch.arange(len(images))
        return results[chosen], poses[chosen], category

    def published_occupancy(self, images: Tensor, views: Tensor | None = None, known: Known = "nothing") -> Tensor:
        """Predict from images [B, 4, 64, 64] in [0, 1] of the data sets.

        ``known`` is the part of the poses of ``views`` [B] that the network gets: nothing; the camera, which has the
        same height, distance and frame in all views; or the whole view, azimuth included.
        """
        cropped, pose = published_crops(images, torch.zeros(len(images)) if views is None else views)
        if known == "view":
            return self.occupancy(cropped, pose)
        return self.search(cropped, pose if known == "camera" else None)[0]


def expected_iou(probability: Tensor) -> Tensor:
    """Estimate the IoU [..., B] of voxels with probabilities [..., B, 32, 32, 32], filled where they are above 0.5."""
    flat = probability.flatten(-3)
    common = torch.where(flat > 0.5, flat, 0.0).sum(-1)
    return common / (torch.where(flat > 0.5, 1.0, flat).sum(-1) + 1e-6)


def outline_iou(occupancy: Tensor, images: Tensor, pose: Tensor, size: int = 32) -> Tensor:
    """Compare the outlines of voxels [B, 32, 32, 32] with pictures [B, 4, 64, 64] of poses [B, 6]: IoU [B]."""
    count = len(images)
    screen = camera_points(voxel_centers().to(images), pose)
    column = ((screen[..., 0] + 1) / 2 * size).long()
    row = ((1 - screen[..., 1]) / 2 * size).long()
    valid = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    flat = torch.where(valid, row * size + column, 0)
    values = torch.where(valid, occupancy.reshape(count, -1), 0.0)
    drawn = torch.zeros(count, size * size, device=images.device).scatter_reduce(1, flat, values, "amax")
    mask = F.avg_pool2d(images[:, 3:], 64 // size).flatten(1)
    common = torch.minimum(drawn, mask).sum(1)
    return common / (torch.maximum(drawn, mask).sum(1) + 1e-6)


def pose_targets(pose: Tensor) -> tuple[Tensor, Tensor]:
    """Convert poses [B, 6] to shares of azimuths [B, 24], and elevation, 1/d, u, v and s [B, 5]."""
    place = pose[:, 0] / (2 * math.pi) * VIEWS
    low = place.floor()
    share = place - low
    target = torch.zeros(len(pose), VIEWS)
    target.scatter_(1, (low.long() % VIEWS)[:, None], (1 - share)[:, None])
    target.scatter_add_(1, ((low.long() + 1) % VIEWS)[:, None], share[:, None])
    return target, torch.stack((pose[:, 1], 1 / pose[:, 2], *pose[:, 3:].unbind(1)), 1)


def camera_numbers(outputs: Tensor) -> Tensor:
    """Convert predicted elevation, 1/d, u, v and s [B, 5] to elevation, d, u, v and s, with d and s in their ranges."""
    elevation, inverse, u, v, side = outputs.unbind(1)
    return torch.stack((elevation, 1 / inverse.clamp(0.08, 0.7), u, v, side.clamp(0.3, 1)), 1)


def _pose_features(pose: Tensor) -> Tensor:
    """Convert poses [B, 6] to smooth features [B, 9]."""
    azimuth, elevation, distance, *crop = pose.unbind(1)
    waves = [f(k * azimuth) for k in (1, 2) for f in (torch.sin, torch.cos)]
    return torch.stack((*waves, elevation, 2 / distance, *crop), 1)


def _layer(inward: int, outward: int, size: int, stride: int) -> nn.Sequential:
    convolution = nn.Conv2d(inward, outward, size, stride=stride, padding=size // 2, bias=False)
    return nn.Sequential(convolution, nn.GroupNorm(8, outward), nn.ReLU())


class _Residual(nn.Module):
    """Residual block: a 3×3 convolution and a shortcut."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.deep = _layer(width, width, 3, 1)

    def forward(self, value: Tensor) -> Tensor:
        return value + self.deep(value)
