"""Endless training shapes: objects of the grammars, and deformed models of a folder that exchange their parts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ....io import load_mesh
from ....raster.ops.voxels import fill
from ...common.geometry.edges import connected_components
from ..data.framing import GRID, mirror, scale_to_unit
from ..data.models_folder import Model
from ..data.voxels import voxel_centers, voxelize_model
from . import devices, furniture, vehicles
from .parts import Builder

GRAMMARS: dict[str, Callable[[Builder], None]] = {
    "airplane": vehicles.airplane,
    "bed": furniture.bed,
    "bench": furniture.bench,
    "blaster": lambda b: devices.gun(b, True),
    "cabinet": furniture.cabinet,
    "car": vehicles.car,
    "chair": furniture.chair,
    "display": devices.display,
    "lamp": devices.lamp,
    "rifle": lambda b: devices.gun(b, False),
    "sofa": furniture.sofa,
    "table": furniture.table,
    "watercraft": vehicles.watercraft,
}
"""Category → function that builds a random object of it."""
CLASSES = tuple(sorted(GRAMMARS))
"""Categories, in the order of the network's classes."""

_SPACING = 0.25  # as of `voxelize_model`
_MOST_SCALED, _TRIES = 2.0, 4  # scale of exchanged parts along an axis, and models that each model exchanges with
_MOST_FACES = 30_000  # larger models are too slow to draw and to fill at every step


@dataclass(frozen=True)
class Shape:
    """A training shape in the frame of the models; its longest side is 1, its bounding box is centred.

    Attributes:
        category: Number of the category in `CLASSES`.
        vertices: [V, 3] float32.
        faces: [F, 3] int64.
        colors: [F, 3] float32, RGB of each face.
        voxels: [32, 32, 32] bool, in the published axes (y, −z, x).
    """

    category: int
    vertices: Tensor
    faces: Tensor
    colors: Tensor
    voxels: Tensor


class Shapes:
    """Endless source of shapes. Shape ``number`` depends only on the seed and on the models.

    Args:
        seed: Seed of all shapes.
        models: Models to deform, as from `models_folder.find_models`; those that cannot be read are left out. Each
            also exchanges its upper parts with a random model of its category.
        share: Share of shapes that come from models, if there are any.

    Example:
        >>> Shapes(seed=0)(7).voxels.shape
        torch.Size([32, 32, 32])
    """

    def __init__(self, seed: int = 0, models: Sequence[Model] = (), share: float = 0.5) -> None:
        self.seed = seed
        stored = [kept for kept in map(_store, models) if kept is not None]
        self.stored = {k: [one for one in stored if one.category == k] for k in range(len(CLASSES))}
        rng = np.random.default_rng((seed, 2))
        for same in self.stored.values():
            pairs = [
                (one, other, float(rng.uniform(0.25, 0.75)))
                for one in same
                for other in rng.permutation(len(same))[:_TRIES]
            ]
            same += [mixed for one, other, level in pairs if (mixed := _exchanged(one, same[other], level)) is not None]
        self.share = share

    def __call__(self, number: int) -> Shape:
        """Generate shape ``number``; all categories are equally likely."""
        rng = np.random.default_rng((self.seed, number))
        category = int(rng.integers(len(CLASSES)))
        models = self.stored[category]
        if models and rng.random() < self.share:
            return _deformed(models[int(rng.integers(len(models)))], rng)
        return _built(category, rng)


def _built(category: int, rng: np.random.Generator) -> Shape:
    """Build an object from the grammar of its category, stretched a little."""
    builder = Builder(rng)
    GRAMMARS[CLASSES[category]](builder)
    stretch = np.exp(rng.normal(0, 0.08, 3))
    corners, triangles, shades, start = [], [], [], 0
    for part, indices, color in builder.parts:
        corners.append(part * stretch)
        triangles.append(indices + start)
        shade = 1 + 0.06 * rng.standard_normal((len(indices), 1)) * (rng.random() < 0.3)
        shades.append(np.clip(color * shade, 0, 1))
        start += len(part)
    vertices = scale_to_unit(torch.from_numpy(np.concatenate(corners)).float())
    faces, colors = torch.from_numpy(np.concatenate(triangles)), torch.from_numpy(np.concatenate(shades)).float()
    return Shape(category, vertices, faces, colors, _fill(vertices, faces))


def _fill(vertices: Tensor, faces: Tensor) -> Tensor:
    """Voxelise closed parts: their surface and all that it encloses, in the published axes."""
    points = mirror(vertices) * (GRID - 1) + GRID / 2
    filled = fill(points[None].contiguous(), faces.flip(1).int(), GRID, _SPACING)[0]
    return filled.transpose(0, 1).flip(2)


def _store(model: Model) -> Shape | None:
    """Load a model, its voxels those of its interior; None if its category is unknown, or it is broken or too large."""
    if model.category not in CLASSES:
        return None
    try:
        vertices, faces, textures = load_mesh(Path(model.path), 2)
    except (ValueError, OSError):
        return None
    if len(faces) > _MOST_FACES:
        return None
    colors = torch.full((len(faces), 3), 0.75) if textures is None else textures.flatten(1, 3).mean(1)
    return _stored(CLASSES.index(model.category), vertices, faces.long(), colors)


def _stored(category: int, vertices: Tensor, faces: Tensor, colors: Tensor) -> Shape:
    """Scale a model, drop its unused vertices, and voxelise it."""
    used, faces = torch.unique(faces, return_inverse=True)
    vertices = scale_to_unit(vertices[used])
    return Shape(category, vertices, faces, colors, voxelize_model(mirror(vertices), faces.flip(1)))


def _exchanged(one: Shape, other: Shape, level: float) -> Shape | None:
    """Replace the parts of a model above a level by those of another, scaled to the same box.

    Parts are connected components. A part is above the level if its centre is, in fractions of the height. Returns None
    if both are the same model, one has parts on one side only, or a side would be scaled by more than `_MOST_SCALED`.
    """
    split = [_above(model, level) for model in (one, other)]
    if one is other or not all(bool(above.any()) and not bool(above.all()) for above in split):
        return None
    boxes = []
    for model, above in zip((one, other), split, strict=True):
        points = model.vertices[model.faces[above]].flatten(0, 1)
        boxes.append((points.amin(0), (points.amax(0) - points.amin(0)).clamp(min=1e-3)))
    (low, size), (start, length) = boxes
    scale = size / length
    if float(torch.maximum(scale, 1 / scale).max()) > _MOST_SCALED:
        return None
    moved = (other.vertices - start) * scale + low
    vertices = torch.cat((one.vertices, moved))
    faces = torch.cat((one.faces[~split[0]], other.faces[split[1]] + len(one.vertices)))
    return _stored(one.category, vertices, faces, torch.cat((one.colors[~split[0]], other.colors[split[1]])))


def _above(model: Shape, level: float) -> Tensor:
    """Find the faces [F] of components whose centre lies above a level, in fractions of the height."""
    where = torch.unique(model.vertices, dim=0, return_inverse=True)[1]  # files repeat vertices at seams
    component = connected_components(where[model.faces])
    count = int(component.max()) + 1
    heights = model.vertices[model.faces][..., 1].mean(1)
    mean = torch.zeros(count).index_add_(0, component, heights) / torch.bincount(component, minlength=count).clamp(1)
    low, high = model.vertices[:, 1].aminmax()
    return mean[component] > low + level * (high - low)


def _deformed(model: Shape, rng: np.random.Generator) -> Shape:
    """Stretch and taper a model, and vary its colours."""
    stretch = torch.from_numpy(np.exp(rng.normal(0, 0.14, 3))).float()
    taper = float(rng.normal(0, 0.1))

    def taper_at(height: Tensor) -> Tensor:
        return (1 + taper * height)[..., None] * torch.tensor([1.0, 0.0, 1.0]) + torch.tensor([0.0, 1.0, 0.0])

    vertices = model.vertices * taper_at(model.vertices[:, 1]) * stretch
    low, high = vertices.amin(0), vertices.amax(0)
    center, side = (low + high) / 2, (high - low).max()
    vertices = (vertices - center) / side
    surface = _fill(vertices, model.faces)
    points = (voxel_centers().reshape(GRID, GRID, GRID, 3) * side + center) / stretch
    points = points / taper_at(points[..., 1])
    index = (points * (GRID - 1) + (GRID - 1) / 2).round().long()
    valid = ((index >= 0) & (index < GRID)).all(-1)
    x, y, z = index.clamp(0, GRID - 1).unbind(-1)
    inner = model.voxels[y, GRID - 1 - z, x] & valid
    colors = model.colors
    if rng.random() < 0.5:
        colors = colors[:, torch.from_numpy(rng.permutation(3))]
    colors = colors ** float(np.exp(rng.normal(0, 0.3)))
    if rng.random() < 0.15:
        colors = torch.from_numpy(rng.uniform(0.1, 0.9, 3)).float().expand(len(colors), 3)
    return Shape(model.category, vertices, model.faces, colors.clamp(0, 1), surface | inner)
