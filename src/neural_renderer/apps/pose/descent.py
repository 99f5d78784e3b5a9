"""Gauss-Newton on a batch of poses, under unknown light."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.func import jvp, vmap

from ...optim import pyramid
from ...optim.robust import LOSSES
from .model import Model, Poses, fitted_light
from .target import FAR_PRICE, Crop

_FIRST_DAMPING = 1e-2
_LESS_DAMPING, _MORE_DAMPING = 0.3, 5.0  # factors after a step that decreases the loss, and after another
_LEAST_NOISE = 0.25 / 12**0.5  # of residuals: coverage is drawn in steps of a quarter
# Least precision of any combination of the parameters; those that the pictures do not determine have a large variance.
_LEAST_PRECISION = 0.1
_SCALE = 0.3  # above this residual robust losses grow slower
_DEEP = 2.0  # weight of depth, in radii of the object
_BLOCKS, _LEFT_OUT = 8, 0.999  # along the side of a picture, and the share of a block's weight that is left out
_JOINED = 1, 2  # sides of the left-out squares, in blocks
_SHORTEST = 8e-4  # motion of the outline in a step, in radii of the object, below which the descent ends
_FARTHEST = 6.0  # pixels that the outline may move in a step
_LEAST_GAIN, _PATIENCE = 1e-3, 4  # of the loss, relative to it, without which so many steps end the descent


@dataclass(frozen=True, eq=False)
class Problem:
    """Comparison of poses with crops of one or several pictures.

    Attributes:
        model: The mesh.
        crops: A crop of each picture.
        motions: Their motions, [3, 4] each.
        color: Weight of colours; silhouettes have 1.
        zooms: Whether the focal length is free.
        loss: Robust loss of residuals.
        levels: Levels of pyramids.
        hidden: Whether parts of the object may be hidden, so that masks are only a part of its silhouette.
        far: Residual of covering pixels far from the mask if parts may be hidden; it makes objects smaller.
        smooth: Whether to draw with anti-aliasing.
    """

    model: Model
    crops: tuple[Crop, ...]
    motions: tuple[Tensor, ...]
    color: float = 1.0
    zooms: bool = False
    loss: str = "squares"
    levels: int = 3
    hidden: bool = False
    far: float = FAR_PRICE
    smooth: bool = True

    def light(self, poses: Poses) -> Tensor | None:
        """Fit the light of all pictures together for each pose, [B, 9, 3]; None without colours."""
        if not self.color:
            return None
        parts = []
        for crop, motion in zip(self.crops, self.motions, strict=True):
            images = crop.images
            if images is None:
                return None
            found = self.model.fragments(poses, crop, motion, False)
            albedo, harmonics = self.model.surface(found, poses, motion)
            weights = (found.face_index >= 0) * crop.mask * crop.known
            photo = images.permute(1, 2, 0).reshape(1, -1, 3)
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
                channels.append(self.color * self.model.lit(found, poses, motion, light))
                photo = self.color * crop.images
            deep = behind = torch.zeros(0, crop.size, crop.size)
            if crop.depth is not None:
                points = found.interpolate(self.model.points[None])
                depth = points @ (motion[2, :3] @ poses.rotation)[:, None, :, None]
                channels.append(_DEEP * (depth + _depths(poses, motion)))
                deep = _DEEP * crop.depth[None]
                # Behind the object is the given depth, or its mean: a far background would rule the outline's motion.
                behind = torch.where(deep > 0, deep, deep.sum() / (deep > 0).sum())
            behind = torch.cat((torch.zeros(1, crop.size, crop.size), torch.zeros_like(photo), behind))
            image = found.composite(torch.cat(channels, -1), background=behind)
            alpha, colors = image[:, :1], image[:, 1 : 1 + len(photo)] - photo
            outline = alpha - crop.mask
            if self.hidden:
                outline, colors = torch.where(outline > 0, crop.beside(self.far) * outline, outline), colors * crop.mask
            depths = (image[:, 1 + len(photo) :] - deep) * (deep > 0)
            result.append(torch.cat((outline, colors, depths), 1) * crop.known)
        return result

    def flat(self, images: list[Tensor]) -> Tensor:
        """Make pyramids of residuals, [..., N]."""
        levels = [level.flatten(-3) for one in images for level in pyramid(one, self.levels)]
        return torch.cat(levels, -1)


def _depths(poses: Poses, motion: Tensor) -> Tensor:
    """Compute the depth of the objects' centres, [B, 1, 1, 1]."""
    return (poses.translation() @ motion[2, :3] + motion[2, 3])[:, None, None, None]


def _columns(problem: Problem, poses: Poses, light: Tensor | None) -> Tensor:
    """Differentiate the residuals with respect to poses, in forward mode, and to light if there is one: [B, P, N]."""
    zero = torch.zeros(len(poses), 6 + problem.zooms)
    units = torch.eye(zero.shape[1])[:, None].expand(-1, len(poses), -1)

    def function(step: Tensor) -> Tensor:
        return problem.flat(problem.residuals(poses.moved(step), light))

    columns: Tensor = vmap(lambda t: jvp(function, (zero,), (t,))[1])(units)
    if light is None:
        return columns.movedim(0, 1)
    return torch.cat((columns, _light_columns(problem, poses)), 0).movedim(0, 1)


def _light_columns(problem: Problem, poses: Poses) -> Tensor:
    """Differentiate the residuals with respect to the light, in which they are linear: [27, B, N].

    With these columns, residuals that a change of the light explains do not move the pose.
    """
    images = []
    for crop, motion in zip(problem.crops, problem.motions, strict=True):
        found = problem.model.fragments(poses, crop, motion, False)
        albedo, harmonics = problem.model.surface(found, poses, motion)
        inside = (found.face_index >= 0) * crop.known * (crop.mask if problem.hidden else 1.0)
        lit = torch.einsum("bhw,bhwc,bhwi->icbhw", problem.color * inside, albedo, harmonics)
        channels = 4 if crop.depth is None else 5
        image = lit.new_zeros(9, 3, len(poses), channels, crop.size, crop.size)
        for channel in range(3):
            image[:, channel, :, 1 + channel] = lit[:, channel]
        images.append(image.flatten(0, 1))
    return problem.flat(images)


def losses(problem: Problem, poses: Poses, light: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the loss of each pose [B], its residuals [B, N] and their weights; fits the light if it is None."""
    light = problem.light(poses) if light is None else light
    r = problem.flat(problem.residuals(poses, light))
    rho, weights = LOSSES[problem.loss]((r / _SCALE).square())
    return 0.5 * _SCALE**2 * rho.sum(-1), r, weights


@torch.no_grad()
def descend(problem: Problem, poses: Poses, iterations: int) -> tuple[Poses, Tensor]:
    """Take steps of Levenberg and Marquardt for each pose; return the poses and their losses [B].

    The light follows by least squares; under a robust loss, which least squares do not minimise, by the same steps.
    """
    damping = torch.full((len(poses),), _FIRST_DAMPING)
    light = problem.light(poses)
    loss, r, weights = losses(problem, poses, light)
    focal = float(problem.crops[0].K[0, 0])
    idle = 0
    for _ in range(iterations):
        J = _columns(problem, poses, light)
        gradient = torch.einsum("bpn,bn->bp", J, weights * r)
        matrix = (J * weights[:, None]) @ J.transpose(1, 2)
        diagonal = matrix.diagonal(dim1=1, dim2=2)
        diagonal = diagonal.clamp(min=1e-9) + 1e-6 * diagonal.amax(1, keepdim=True)
        damped = matrix + torch.diag_embed(diagonal * damping[:, None])
        change = torch.linalg.solve(damped.double(), -gradient.double()).float()
        step, relit = change.split((6 + problem.zooms, change.shape[1] - 6 - problem.zooms), 1)
        motion = _motion(poses, step, focal)
        if bool((motion < _SHORTEST * focal * poses.place[:, 2].exp()).all()):
            break
        share = (_FARTHEST / motion.clamp(min=1e-9)).clamp(max=1.0)[:, None]
        trial = poses.moved(share * step)
        robust = light is not None and problem.loss != "squares"
        new_light = light + (share * relit).view(-1, 9, 3) if robust else problem.light(trial)
        new_loss, new_r, new_weights = losses(problem, trial, new_light)
        good = new_loss < loss
        idle = 0 if bool((loss - new_loss > _LEAST_GAIN * loss).any()) else idle + 1
        damping = torch.where(good, damping * _LESS_DAMPING, damping * _MORE_DAMPING).clamp(1e-6, 1e4)
        poses = Poses(
            *(
                torch.where(good.view(-1, *[1] * (a.dim() - 1)), b, a)
                for a, b in ((poses.rotation, trial.rotation), (poses.place, trial.place), (poses.zoom, trial.zoom))
            )
        )
        loss = torch.where(good, new_loss, loss)
        r, weights = torch.where(good[:, None], new_r, r), torch.where(good[:, None], new_weights, weights)
        if light is not None and new_light is not None:
            light = torch.where(good[:, None, None], new_light, light)
        if idle == _PATIENCE:
            break
    return poses, loss


def _motion(poses: Poses, step: Tensor, focal: float) -> Tensor:
    """Bound how far a step moves the object in pixels, [B]."""
    radius = focal * poses.place[:, 2].exp()
    return radius * (step[:, :3].norm(dim=1) + step[:, 5:].abs().sum(1)) + focal * step[:, 3:5].norm(dim=1)


@torch.no_grad()
def covariance(problem: Problem, pose: Poses) -> Tensor:
    """Estimate the covariance of the steps at a pose, [P, P], with unknown light.

    It is a sum: what independent noise as large as the residuals, or as the steps of drawn coverage, would do; and two
    jackknives, how the pose moves if one block of the pictures after the other is left out, a small or a large one.
    Residuals of many pixels are alike where the light is wrong, even those of small blocks that are neighbours.
    """
    light = problem.light(pose)
    images = problem.residuals(pose, light)
    _, r, weights = losses(problem, pose, light)
    J = _columns(problem, pose, light)[0]
    block, count = _blocks(problem, images), 6 + problem.zooms
    counts = block.bincount(minlength=_BLOCKS**2 * len(images)).tolist()
    parts = [(J[:, rows], weights[0, rows], r[0, rows]) for rows in block.argsort().split(counts)]
    matrices = torch.stack([(part * weight) @ part.T for part, weight, _ in parts]).double()
    gradients = torch.stack([part @ (weight * rest) for part, weight, rest in parts]).double()
    variance = (weights * r.square()).sum() / max(1, r.numel() - len(J)) + _LEAST_NOISE**2
    matrix = matrices.sum(0)
    matrix.diagonal().add_(_LEAST_PRECISION * variance + 1e-12 * matrix.diagonal().mean())
    total = variance * torch.linalg.inv(matrix)[:count, :count]
    for side in _JOINED:
        moves = torch.linalg.solve(matrix - _LEFT_OUT * _joined(matrices, side), _joined(gradients, side))[:, :count]
        total += moves.T @ moves
    return total.float()


def _joined(values: Tensor, side: int) -> Tensor:
    """Add up the values [N · _BLOCKS², ...] of side × side neighbouring blocks."""
    rest = values.shape[1:]
    return values.view(-1, _BLOCKS // side, side, _BLOCKS // side, side, *rest).sum((2, 4)).view(-1, *rest)


def _blocks(problem: Problem, images: list[Tensor]) -> Tensor:
    """Number the blocks of pixels that residuals belong to, [N]."""
    blocks = []
    for number, image in enumerate(images):
        for level in pyramid(image, problem.levels):
            row, column = (torch.arange(side) * _BLOCKS // side for side in level.shape[-2:])
            blocks.append(((number * _BLOCKS + row[:, None]) * _BLOCKS + column).expand(level.shape[-3:]).flatten())
    return torch.cat(blocks)
