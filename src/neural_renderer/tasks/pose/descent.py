"""Gauss-Newton for many poses at once, under unknown light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.func import jvp, vmap

from ...optim import pyramid
from ...optim.robust import LOSSES
from .model import Model, Poses, fitted_light, shaded
from .target import Crop

_FIRST_DAMPING = 1e-2
_COVERING = 0.35  # residual of covering a pixel beside the mask, if parts may be hidden
_FARTHEST = 6.0  # pixels that the outline may move in a step


@dataclass(frozen=True, eq=False)
class Problem:
    """What poses are compared with: crops of one or several pictures, and how.

    Attributes:
        model: The mesh.
        crops: A crop of each picture.
        motions: Their motions, [3, 4] each.
        color: Weight of colours; silhouettes have 1.
        zooms: Whether the focal length is free.
        loss, scale: Robust loss of residuals.
        levels: Levels of pyramids.
    """

    model: Model
    crops: tuple[Crop, ...]
    motions: tuple[Tensor, ...]
    color: float = 1.0
    zooms: bool = False
    loss: str = "squares"
    scale: float = 0.3
    levels: int = 3
    seen: str = "whole"
    smooth: bool = True
    worth: float = 0.3

    def light(self, poses: Poses) -> Tensor | None:
        """Fit the light of all pictures together for each pose, [B, 9, 3]; None without colours."""
        if not self.color:
            return None
        parts = []
        for crop, motion in zip(self.crops, self.motions, strict=True):
            found = self.model.fragments(poses, crop, motion, False)
            albedo, harmonics = self.model.surface(found, poses, motion)
            assert crop.images is not None
            weights = (found.face_index >= 0) * crop.mask * crop.known
            photo = crop.images.permute(1, 2, 0).reshape(1, -1, 3)
            parts.append((albedo.flatten(1, 2), harmonics.flatten(1, 2), weights.flatten(1), photo))
        joined = [torch.cat(each, 1) for each in zip(*parts, strict=True)]
        return fitted_light(*joined)

    def residuals(self, poses: Poses, light: Tensor | None) -> list[Tensor]:
        """Compute the differences of drawn and given images, [B, C, n, n] for each picture: alpha first."""
        result = []
        for crop, motion in zip(self.crops, self.motions, strict=True):
            found = self.model.fragments(poses, crop, motion, self.smooth)
            channels = [torch.ones(*found.face_index.shape, 1)]
            photo = torch.zeros(0, crop.size, crop.size)
            if light is not None and crop.images is not None:
                albedo, harmonics = self.model.surface(found, poses, motion)
                channels.append(self.color * shaded(albedo, harmonics, light))
                photo = self.color * crop.images
            # Without a mask, the photo itself is the background: then colours count where the object covers it.
            behind = torch.cat((torch.zeros(1, crop.size, crop.size), photo * float(self.seen == "none")))
            image = found.composite(torch.cat(channels, -1), background=behind)
            alpha, colors = image[:, :1], image[:, 1:] - photo
            if self.seen == "none":
                outline = self.worth * (1 - alpha)
            else:
                outline = alpha - crop.mask
            if self.seen == "part":
                outline, colors = torch.where(outline > 0, _COVERING * outline, outline), colors * crop.mask
            result.append(torch.cat((outline, colors), 1) * crop.known)
        return result

    def flat(self, images: list[Tensor]) -> Tensor:
        """Make pyramids of residuals, [..., N]."""
        levels = [level.flatten(-3) for one in images for level in pyramid(one, self.levels)]
        return torch.cat(levels, -1)

    def steps(self) -> Tensor:
        """Choose changes of the parameters that move the object by about a pixel, [6 or 7]."""
        pixel = 1 / self.crops[0].size
        return torch.tensor([2.5, 2.5, 2.5, 1.0 , 1.0, 2.5, 6.0][: 6 + self.zooms]) * pixel


def columns_by_differences(problem: Problem, poses: Poses, light: Tensor | None) -> Tensor:
    sizes = problem.steps() * torch.tensor(1.0)
    sizes[3:5] *= float(problem.crops[0].size / problem.crops[0].K[0, 0])
    count, batch = len(sizes), len(poses)
    offsets = torch.cat((torch.diag(sizes), -torch.diag(sizes)))  # [2P, P]
    wide = Poses(*(getattr(poses, n).repeat(2 * count, *([1] * (getattr(poses, n).dim() - 1))) for n in ("rotation", "place", "zoom")))
    moved = wide.moved(offsets.repeat_interleave(batch, 0))
    lit = None if light is None else light.repeat(2 * count, 1, 1)
    r = problem.flat(problem.residuals(moved, lit)).view(2, count, batch, -1)
    return (r[0] - r[1]) / (2 * sizes[:, None, None])


def columns_forward(problem: Problem, poses: Poses, light: Tensor | None) -> Tensor:
    zero = torch.zeros(len(poses), 6 + problem.zooms)
    units = torch.eye(zero.shape[1])[:, None].expand(-1, len(poses), -1)

    def function(step: Tensor) -> Tensor:
        return problem.flat(problem.residuals(poses.moved(step), light))

    return vmap(lambda t: jvp(function, (zero,), (t,))[1])(units)


COLUMNS = columns_forward


def losses(problem: Problem, poses: Poses, light: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
    light = problem.light(poses) if light is None else light
    r = problem.flat(problem.residuals(poses, light))
    rho, weights = LOSSES[problem.loss]((r / problem.scale).square())
    return 0.5 * problem.scale**2 * rho.sum(-1), r, weights


@torch.no_grad()
def descend(problem: Problem, poses: Poses, iterations: int) -> tuple[Poses, Tensor]:
    """Take steps of Levenberg and Marquardt for each pose; return the poses and their losses [B]."""
    damping = torch.full((len(poses),), _FIRST_DAMPING)
    light = problem.light(poses)
    loss, r, weights = losses(problem, poses, light)
    for _ in range(iterations):
        J = COLUMNS(problem, poses, light).movedim(0, 1)  # [B, P, N]
        gradient = torch.einsum("bpn,bn->bp", J, weights * r)
        matrix = (J * weights[:, None]) @ J.transpose(1, 2)
        diagonal = matrix.diagonal(dim1=1, dim2=2)
        diagonal = diagonal.clamp(min=1e-9) + 1e-6 * diagonal.amax(1, keepdim=True)
        damped = matrix + torch.diag_embed(diagonal * damping[:, None])
        step = torch.linalg.solve(damped.double(), -gradient.double()).float()
        step = step * _shortening(problem, poses, step)
        trial = poses.moved(step)
        new_light = problem.light(trial)
        new_loss, new_r, new_weights = losses(problem, trial, new_light)
        good = new_loss < loss
        damping = torch.where(good, damping * 0.3, damping * 5).clamp(1e-6, 1e4)
        poses = Poses(*(torch.where(good.view(-1, *[1] * (a.dim() - 1)), b, a) for a, b in (
            (poses.rotation, trial.rotation), (poses.place, trial.place), (poses.zoom, trial.zoom))))
        loss = torch.where(good, new_loss, loss)
        r, weights = torch.where(good[:, None], new_r, r), torch.where(good[:, None], new_weights, weights)
        light = None if light is None else torch.where(good[:, None, None], new_light, light)
    return poses, loss


def _shortening(problem: Problem, poses: Poses, step: Tensor) -> Tensor:
    """Compute the factor that keeps the motion in pixels small, [B, 1]."""
    focal = float(problem.crops[0].K[0, 0])
    radius = focal * poses.place[:, 2].exp()
    motion = radius * (step[:, :3].norm(dim=1) + step[:, 5].abs()) + focal * step[:, 3:5].norm(dim=1)
    return (_FARTHEST / motion.clamp(min=1e-9)).clamp(max=1.0)[:, None]
