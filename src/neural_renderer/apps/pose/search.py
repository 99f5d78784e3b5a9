"""Global search: a known mesh is drawn from all sides, rotated in the picture by correlation, and compared.

Silhouettes are compared in polar coordinates around a centre, in units of their size. There a rotation in the picture
is a shift, so that one correlation along circles, by the fast Fourier transform, compares all rotations. If the whole
silhouette is visible, its moments give the centre and the size. Otherwise a grid of both is tried.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ...camera import rotations
from ...meshes.primitives import icosphere
from .model import RIDGE, Model, Poses
from .target import Crop

_TEMPLATE = 64  # side of a template in pixels
_RADII, _ANGLES = 20, 72  # of the polar grids
_USUAL_SPREAD = 0.55  # root mean square distance of a usual silhouette from its centroid, in radii of the object
_NEAREST, _FILLED = 1.15, 0.95  # least distance of an object in radii; share of a template that its sphere fills
_STEEP = 0.9  # height of a direction, above which another one is up
_REACH = 2.6  # outer radius of a polar grid, in root mean square distances of the silhouette from its centroid
POSES_PER_PASS = 50
"""Poses that are compared with pictures together, which limits memory."""
_LIGHTS = 4  # spherical harmonics there
_SIDES = 3  # subdivisions of an icosahedron whose vertices are the directions
_SIZES = (1.0, 1.15, 1.32, 1.52, 1.75)  # of the whole silhouette of an occluded object, relative to its visible part
_SHIFTS = (-1.05, -0.7, -0.35, 0.0, 0.35, 0.7, 1.05)  # of its centre, relative to the visible part's size


@dataclass(frozen=True, eq=False)
class Templates:
    """Silhouettes from V directions, and how they were drawn.

    Attributes:
        rotations: [V, 3, 3].
        depth: Distance of the object's centre.
        masks: [V, n, n].
        focal: Focal length in pixels.
        centers, spreads: Moments of the masks, [V, 2] and [V], in pixels.
    """

    rotations: Tensor
    depth: float
    masks: Tensor
    focal: float
    centers: Tensor
    spreads: Tensor

    @classmethod
    def of(cls, model: Model, views: Tensor, depth: float) -> Templates:
        """Draw the silhouettes of a mesh at a distance in its radii."""
        depth = max(depth, _NEAREST)
        focal = _TEMPLATE / 2 * _FILLED * math.sqrt(depth**2 - 1)  # the sphere of radius 1 fills the picture
        K = torch.tensor([[focal, 0, _TEMPLATE / 2], [0, focal, _TEMPLATE / 2], [0, 0, 1.0]])
        blank = torch.ones(_TEMPLATE, _TEMPLATE)
        place = torch.tensor([[0.0, 0, -math.log(depth)]]).expand(len(views), 3)
        poses = Poses(views, place, torch.zeros(len(views), 1))
        masks = drawn_masks(model, poses, Crop(K, None, blank, None, blank), torch.eye(3, 4))
        return cls(views, depth, masks, focal, *moments(masks))


def view_rotations(level: int) -> Tensor:
    """Make rotations [V, 3, 3] into a camera's space (x right, y down, z forward) from evenly spread directions."""
    forward, _ = icosphere(level)
    up = torch.where(forward[:, 1:2].abs() > _STEEP, torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0]))
    right = F.normalize(torch.linalg.cross(forward, up), dim=1)
    return torch.stack((right, torch.linalg.cross(forward, right), forward), 1)


def moments(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Compute centroids [B, 2] in pixels, x and y, and root mean square distances from them [B], of [B, n, n]."""
    at = torch.arange(mask.shape[-1]) + 0.5
    area = mask.sum((1, 2)).clamp(min=1e-3)
    x, y = (mask.sum(1) * at).sum(1) / area, (mask.sum(2) * at).sum(1) / area
    xx, yy = (mask.sum(1) * at**2).sum(1) / area, (mask.sum(2) * at**2).sum(1) / area
    return torch.stack((x, y), 1), (xx + yy - x**2 - y**2).clamp(min=0.5**2).sqrt()


def drawn_masks(model: Model, poses: Poses, crop: Crop, motion: Tensor) -> Tensor:
    """Draw silhouettes without anti-aliasing, [B, n, n]."""
    parts = [poses[i : i + POSES_PER_PASS] for i in range(0, len(poses), POSES_PER_PASS)]
    return torch.cat([model.fragments(p, crop, motion, False).face_index >= 0 for p in parts]).float()


def search(model: Model, crop: Crop, count: int, hidden: bool) -> Poses:
    """Find the poses whose silhouettes agree best with the mask of a crop.

    Args:
        model: The mesh.
        crop: The crop, in which the mask is not empty.
        count: Number of poses.
        hidden: Whether parts of the object may be hidden, so that the mask is only a part of its silhouette.

    Returns:
        The poses, from best to worst.
    """
    center, spread = moments(crop.mask[None])
    focal = float(crop.K[0, 0])
    views = view_rotations(_SIDES)
    first = Templates.of(model, views[::5], _USUAL_SPREAD * focal / float(spread))
    size = float(first.spreads.mean()) / first.focal
    if hidden:
        size /= _SIZES[2]
    drawn = Templates.of(model, views, first.depth * size * focal / float(spread))
    if hidden:
        shifts = torch.cartesian_prod(torch.tensor(_SHIFTS), torch.tensor(_SHIFTS), torch.tensor(_SIZES))
        center, spread = center + spread[:, None] * shifts[:, :2], spread * shifts[:, 2]
    target = crop.mask - crop.beside().square() * (1 - crop.mask) if hidden else crop.mask
    scores, rows = _scores(target, center, spread, drawn, hidden).max(0)  # the best place for each rotation
    around = torch.cat((scores[:, -1:], scores, scores[:, :1]), 1)
    peaks = torch.where(scores >= F.max_pool1d(around, 3, 1), scores, -math.inf)
    best = peaks.flatten().topk(min(count, peaks.numel())).indices
    view, angle, row = best // _ANGLES, best % _ANGLES, rows.flatten()[best]
    return _placed(crop, drawn, view, angle * (2 * math.pi / _ANGLES), center[row], spread[row])


def _scores(mask: Tensor, center: Tensor, spread: Tensor, drawn: Templates, hidden: bool) -> Tensor:
    """Compare a mask, or the worth of covering each pixel, with all templates at all angles: [H, V, angles]."""
    radius = (torch.arange(_RADII) + 0.5)[:, None]
    ours = _polar(mask.expand(len(center), -1, -1), center, spread) * radius
    theirs = _polar(drawn.masks, drawn.centers, drawn.spreads)
    # The picture at the angle a shows the template at a - turn.
    spectrum = torch.einsum("hra,vra->hva", torch.fft.rfft(ours), torch.fft.rfft(theirs).conj())
    shared = torch.fft.irfft(spectrum, n=_ANGLES)
    if hidden:  # areas in pixels of the picture, since the rows differ in size
        return (spread * spread)[:, None, None] * shared
    area = (theirs * radius).sum((1, 2))[None, :, None]
    return shared / (ours.sum((1, 2))[:, None, None] + area - shared)


def _polar(mask: Tensor, center: Tensor, spread: Tensor) -> Tensor:
    """Sample silhouettes [B, n, n] around centres, [B, radii, angles]."""
    radius = (torch.arange(_RADII) + 0.5) / _RADII * _REACH
    angle = torch.arange(_ANGLES) * (2 * math.pi / _ANGLES)
    grid = torch.stack((radius[:, None] * angle.cos(), radius[:, None] * angle.sin()), -1)
    at = center[:, None, None] + spread[:, None, None, None] * grid
    return F.grid_sample(mask[:, None], at * (2 / mask.shape[-1]) - 1, align_corners=False)[:, 0]


def _placed(crop: Crop, drawn: Templates, view: Tensor, angle: Tensor, center: Tensor, spread: Tensor) -> Poses:
    """Make the poses that show templates, rotated in the picture by angles, at centres and of sizes in a crop."""
    about = _about_z(angle)
    focal = crop.K[:2, :2].diagonal()
    rays = (center - crop.K[:2, 2]) / focal
    size = drawn.spreads[view] / drawn.focal * focal[0] / spread  # template relative to picture
    shift = (drawn.centers[view] - _TEMPLATE / 2) / drawn.focal / size[:, None]
    off = torch.einsum("bij,bj->bi", about[:, :2, :2], shift)
    place = torch.cat((rays - off, -(drawn.depth * size).log()[:, None]), 1)
    forward = torch.cat((rays, torch.ones(len(rays), 1)), 1)  # templates look along it
    tilt = torch.linalg.cross(torch.tensor([[0.0, 0, 1]]).expand_as(forward), forward)
    rotation = rotations.from_axis_angle(tilt) @ about @ drawn.rotations[view]
    return Poses(rotation, place, torch.zeros(len(place), 1))


def matched(model: Model, poses: Poses, crop: Crop, motion: Tensor) -> Poses:
    """Shift and scale poses so that the moments of their silhouettes are those of the mask."""
    center, spread = moments(crop.mask[None])
    centers, spreads = moments(drawn_masks(model, poses, crop, motion))
    shift = (center - centers) / crop.K[:2, :2].diagonal()
    place = poses.place + torch.cat((shift, (spread / spreads).log()[:, None]), 1)
    return Poses(poses.rotation, place, poses.zoom)


def settled(
    model: Model, poses: Poses, crop: Crop, motion: Tensor, color: float, reach: float, steps: int
) -> tuple[Poses, Tensor]:
    """Move each pose to the place near it where outline and colours agree best; return the poses and their costs [B].

    Each pose is drawn once, and a grid of places moves the picture instead. The least squares of the light at all
    places together are matrix products.

    Args:
        model: The mesh.
        poses: B poses.
        crop: The crop; the object may be hidden in part.
        motion: [3, 4], its motion.
        color: Weight of colours; silhouettes have 1.
        reach: Farthest shift, relative to the object's radius; sizes change by half of it.
        steps: Number of shifts to each side and down.
    """
    along = torch.linspace(-reach, reach, steps)
    grid = torch.cartesian_prod(along, along, torch.linspace(-reach / 2, reach / 2, 3))
    focal = crop.K[:2, :2].diagonal()
    radius, scale = poses.place[:, 2].exp().mean(), grid[:, 2:].exp()
    at = (torch.arange(crop.size) + 0.5) * (2 / crop.size) - 1  # sizes change around the middle of the crop
    right, down = (scale * at + 2 / crop.size * focal[axis] * radius * grid[:, axis, None] for axis in (0, 1))
    where = torch.stack(torch.broadcast_tensors(right[:, None], down[:, :, None]), -1)
    worth = (crop.beside() * (1 - crop.mask)).square() - crop.mask.square()
    weight = crop.known * crop.mask.square()
    layers = torch.stack((crop.known * worth, weight, *(() if crop.images is None else weight * crop.images)))
    pictures = F.grid_sample(layers.expand(len(grid), -1, -1, -1), where, align_corners=False)
    pictures = (pictures * scale[:, :, None, None].square()).flatten(2).permute(1, 2, 0)  # [layers, pixels, K]
    parts = [poses[i : i + POSES_PER_PASS] for i in range(0, len(poses), POSES_PER_PASS)]
    cost, row = torch.cat([_costs(model, part, crop, motion, color, pictures) for part in parts]).min(1)
    middle = (crop.size / 2 - crop.K[:2, 2]) / focal
    rays = middle + (poses.place[:, :2] - middle) * scale[row] + radius * grid[row, :2]
    old, new = (F.pad(each, (0, 1), value=1.0) for each in (poses.place[:, :2], rays))
    rotation = rotations.from_axis_angle(torch.linalg.cross(old, new))  # the object shows the same side
    place = torch.cat((rays, poses.place[:, 2:] + grid[row, 2:]), 1)
    return Poses(rotation @ poses.rotation, place, poses.zoom), cost


def _costs(model: Model, poses: Poses, crop: Crop, motion: Tensor, color: float, pictures: Tensor) -> Tensor:
    """Compare poses with K pictures: the worth of each pixel's cover, its weight, and colours: [B, K]."""
    found = model.fragments(poses, crop, motion, False)
    drawn = (found.face_index >= 0).float().flatten(1)
    cost = drawn @ pictures[0]
    if len(pictures) == 2:
        return cost
    albedo, harmonics = model.surface(found, poses, motion)
    lights = harmonics[..., :_LIGHTS].flatten(1, 2) * drawn[..., None]
    for channel in range(3):
        columns = albedo[..., channel].flatten(1, 2)[..., None] * lights
        gram = ((columns[..., None, :] * columns[..., None]).permute(0, 2, 3, 1) @ pictures[1]).movedim(3, 1)
        right = (columns.transpose(1, 2) @ pictures[2 + channel]).transpose(1, 2)[..., None]
        gram = gram + RIDGE * (gram[..., :1, :1] + 1) * torch.eye(_LIGHTS)
        cost -= color**2 * (right * torch.linalg.solve(gram, right)).sum((2, 3))
    return cost


def _about_z(angle: Tensor) -> Tensor:
    return rotations.from_axis_angle(torch.stack((0 * angle, 0 * angle, angle), 1))


def apart(poses: Poses, count: int, least: float) -> list[int]:
    """Choose the first poses, from best to worst, whose rotations differ by at least this angle in radians."""
    kept: list[int] = []
    for row in range(len(poses)):
        trace = torch.einsum("bij,ij->b", poses.rotation[kept], poses.rotation[row])
        if not kept or float(trace.max()) < 1 + 2 * math.cos(least):
            kept.append(row)
        if len(kept) == count:
            break
    return kept
