"""Training of a `ShapeNetwork` on generated shapes, drawn while it trains."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....io.atomic_write import write_file
from ....optim.metrics import silhouette_iou
from ...common.saved_tensors import load_tensors
from ..data.arrays import Split
from ..data.framing import GRID
from ..data.voxels import voxel_iou
from ..networks.shape_network import Known, ShapeNetwork, camera_numbers, pose_targets
from ..options import PretrainOptions
from ..shapes.shapes import Shapes
from ..shapes.views import crop_poses, draw, random_poses

_RATE, _DECAY, _BATCH = 2e-3, 0.02, 24
_VIEWS, _POINTS = 2, 4096  # pictures of each shape, and voxels of each picture, in a step
_LOOKS = 2  # further pictures of each shape, which train only pose and category
_WARM, _AVERAGE = 50, 0.995
_FIRST = 0.4  # share of the training with the first weight of the pose
_CATEGORY, _POSE = 0.05, (0.05, 0.3)  # weights of losses, relative to that of voxels
_OWN = 1 / 3  # share of pictures whose voxels are predicted with the network's own camera
LAST, WEIGHTS = "shapes.ckpt", "weights.pt"
"""Files of a training: the state from which it resumes, and the averaged network in half precision."""


def make_batch(shapes: Shapes, step: int, count: int = _BATCH) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Make the batch of a step: pictures [2B, 4, 64, 64], voxels [B, 32, 32, 32], poses [2B, 6], categories [2B]."""
    rng = np.random.default_rng((shapes.seed, 1, step))
    made = [shapes(step * (count // _VIEWS) + index) for index in range(count // _VIEWS)] * (_VIEWS + _LOOKS)
    pose = crop_poses(random_poses(len(made), rng), [shape.vertices for shape in made], rng)
    images = _worn(draw(made, pose, rng), rng)
    voxels = torch.stack([s.voxels for s in made[:count]]).float()
    return images, voxels, pose, torch.tensor([s.category for s in made])


def _worn(images: Tensor, rng: np.random.Generator) -> Tensor:
    """Blur some pictures, as if they had been enlarged, and vary contrast and colour."""
    images = images.clone()
    for image in images:
        if rng.random() < 0.6:
            size = int(rng.integers(28, 64))
            small = F.interpolate(image[None], (size, size), mode="bilinear", antialias=True)
            image[:] = F.interpolate(small, image.shape[1:], mode="bilinear")[0]
    gain = torch.from_numpy(rng.uniform(0.8, 1.2, (len(images), 3, 1, 1))).float()
    noise = torch.from_numpy(rng.normal(0, 0.02, (len(images), 3, *images.shape[2:]))).float()
    rgb = (images[:, :3] * gain + noise).clamp(0, 1) * (images[:, 3:] > 0)
    return torch.cat((rgb, images[:, 3:]), 1)


def losses(network: ShapeNetwork, batch: tuple[Tensor, ...], step: int, weight: float) -> tuple[Tensor, Tensor]:
    """Compute the loss of the batch of a step, with a weight of the pose, and the mean IoU of its voxels."""
    images, voxels, pose, category = batch
    levels = network.encode(images)
    azimuth, others = network.pose_outputs(levels[-1])
    target, numbers = pose_targets(pose)
    loss = weight * (F.cross_entropy(azimuth, target) + 4 * F.l1_loss(others, numbers))
    loss = loss + _CATEGORY * F.cross_entropy(network.category(levels[-1]), category)

    count, random = len(voxels), torch.Generator().manual_seed(step)
    chosen = torch.randint(GRID**3, (_POINTS,), generator=random)
    is_predicted = torch.rand(count, 1, generator=random) < _OWN
    camera = torch.where(
        is_predicted, torch.cat((pose[:count, :1], camera_numbers(others[:count].detach())), 1), pose[:count]
    )
    logits = network.voxel_logits([level[:count] for level in levels], images[:count], camera, chosen)
    probability, voxels = logits.sigmoid(), voxels.flatten(1)[:, chosen]
    common = (probability * voxels).sum(1)
    iou = common / (probability + voxels - probability * voxels).sum(1).clamp(min=1)
    loss = loss + F.binary_cross_entropy_with_logits(logits, voxels) * 3 + 1 - iou.mean()
    hard = silhouette_iou((logits.detach() > 0)[:, None], voxels[:, None] > 0.5).mean()
    return loss, hard


@torch.no_grad()
def validate(network: ShapeNetwork, split: Split, known: Known = "view", each: int = 4) -> float:
    """Compute the mean voxel IoU over the categories of a split, from some views of each object."""
    means = []
    for name in split.classes:
        scores = []
        for index in range(len(split.images[name])):
            views = (torch.arange(each) * (24 // each) + index) % 24
            images = torch.from_numpy(split.images[name][index][views.numpy()].copy()).float() / 255
            filled = network.published_occupancy(images, views, known) > 0.5
            truth = torch.from_numpy(split.voxels[name][index].copy())
            scores.append(float(voxel_iou(filled, truth.expand_as(filled)).mean()))
        means.append(sum(scores) / len(scores))
    return sum(means) / len(means)


def pretrain(
    shapes: Shapes,
    out: Path,
    steps: int = PretrainOptions.steps,
    minutes: float = math.inf,
    split: Split | None = None,
    every: int = PretrainOptions.every,
    resume: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> ShapeNetwork:
    """Train a network for a number of steps, or for a time limit in minutes if it ends earlier.

    There are two stages. In each the learning rate falls to 0; in the second the pose has a larger weight.

    OUT gets shapes.ckpt, from which ``resume`` goes on, weights.pt and log.csv. Without a limit of time, a resumed
    training ends with the weights of an uninterrupted one. The averaged network is returned.
    """
    torch.manual_seed(shapes.seed)
    network, average = ShapeNetwork(), ShapeNetwork()
    average.load_state_dict(network.state_dict())
    optimizer = torch.optim.AdamW(network.parameters(), _RATE, betas=(0.9, 0.98), weight_decay=_DECAY)
    step, before, rows = 0, 0.0, []
    if resume and (out / LAST).is_file():
        state = load_tensors(out / LAST)
        network.load_state_dict(state["network"])
        average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        step, before, rows = state["step"], state["seconds"], state["rows"]
    start, sums, count = time.monotonic() - before, torch.zeros(2), 0
    while (progress := max(step / steps, (time.monotonic() - start) / (60 * minutes))) < 1:
        second = progress >= _FIRST
        part = (progress - _FIRST) / (1 - _FIRST) if second else progress / _FIRST
        for group in optimizer.param_groups:
            group["lr"] = _RATE * min(1.0, (step + 1) / _WARM) * 0.5 * (1 + math.cos(math.pi * part))
        loss, iou = losses(network, make_batch(shapes, step), step, _POSE[second])
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        step += 1
        keep = min(_AVERAGE, step / (step + 10))
        for mean, value in zip(average.parameters(), network.parameters(), strict=True):
            mean.data.lerp_(value.data, 1 - keep)
        sums, count = sums + torch.stack((loss.detach(), iou)), count + 1
        if step % every == 0 or step == steps:
            values = [round(float(v), 4) for v in sums / count]
            scores = [] if split is None else [round(validate(average.eval(), split), 4)]
            seconds = time.monotonic() - start
            rows.append([step, round(seconds, 1), *values, *scores])
            val = f", IoU of the validation split {scores[0]}" if scores else ""
            tell(f"step {step}, {seconds / 60:.1f} min: loss {values[0]}, IoU {values[1]}{val}")
            _save(out, network, average, optimizer, step, seconds, rows)
            sums, count = torch.zeros(2), 0
    _save(out, network, average, optimizer, step, time.monotonic() - start, rows)
    return average.eval()


def _save(
    out: Path,
    network: ShapeNetwork,
    average: ShapeNetwork,
    optimizer: torch.optim.Optimizer,
    step: int,
    seconds: float,
    rows: list[list[float]],
) -> None:
    """Write the state of a training and its log."""
    file, text = io.BytesIO(), io.StringIO()
    state = {"network": network.state_dict(), "average": average.state_dict(), "optimizer": optimizer.state_dict()}
    torch.save(state | {"step": step, "seconds": seconds, "rows": rows}, file)
    write_file(out / LAST, file.getbuffer())
    half = io.BytesIO()
    torch.save({"weights": {name: value.half() for name, value in average.state_dict().items()}}, half)
    write_file(out / WEIGHTS, half.getbuffer())
    csv.writer(text).writerows([["step", "seconds", "loss", "iou", "validation"], *rows])
    write_file(out / "log.csv", text.getvalue())
