"""Half and double of constants that judge an object in photographs: ``python -m benchmarks.object_constants SET …``.

A set is a folder of `benchmarks.path_traced` with the result of its fit ``alone``; every second of its photographs is
used. Stages, for all sets together:

- beside: area around outlines that does not look like the background, in percent: the largest of the true meshes, and
  the smallest of meshes without their upper third. `verdict.MOST_BESIDE` is between them.
- colours: mean IoU of masks by colours, of pictures of 160 pixels.
- turntable: the same, with the object before a still painting, and points on the object alone.
- depth: contradiction of masks by colours, and of those by depth, in percent of the object, for each set; and of masks
  by colours that are moved by a tenth of the picture.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
import torch.nn.functional as F

import neural_renderer as nr
from neural_renderer.apps.common.views.views import Views
from neural_renderer.apps.fit.cameras import Similarity
from neural_renderer.apps.fit.photos import beside, histogram
from neural_renderer.apps.fit.photos.geometry.depth import DepthMaps
from neural_renderer.apps.fit.photos.geometry.solid import find_solid
from neural_renderer.apps.fit.photos.masks import object_masks, shape_masks, voxels
from neural_renderer.apps.fit.photos.place import find_place
from neural_renderer.camera.files import read_camera_file

from .half_and_double import replaced, section
from .verdicts import in_order

_SIDE, _EVERY = 160, 2
_PAINTING = Path(__file__).resolve().parents[1] / "examples/data/starry_night.jpg"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.object_constants", description=__doc__)
    parser.add_argument("sets", type=Path, nargs="+", help="folders of photographs with a fit")
    parser.add_argument("--stages", nargs="+", choices=_STAGES, default=list(_STAGES))
    options = parser.parse_args()
    torch.set_num_threads(1)
    sets = [Judged(folder) for folder in options.sets]
    for name in options.stages:
        constants, score = _STAGES[name]
        section(name, constants, partial(score, sets))


class Judged:
    """Photographs with cameras that were found, true masks, the true mesh and that of the fit."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        found = read_camera_file(folder / "alone/sparse/0/images.bin")
        self.names = [entry.name for entry in found.images][::_EVERY]
        with replaced(object_masks, "_SIDE", _SIDE):
            self.images, self.full = object_masks._load([folder / "alone/images" / name for name in self.names])
        if found.points is None:
            raise ValueError(f"{folder}: expected points of structure from motion, got none")
        self.camera, self.points = in_order(found, self.names, self.full), found.points
        self.size = self.images.shape[1], self.images.shape[2]
        masks = [nr.load_image(next((folder / "masks").glob(f"{Path(name).stem}.*")))[..., 0] for name in self.names]
        self.masks = F.interpolate(torch.stack(masks)[:, None], self.size, mode="area")[:, 0].numpy() > 0.5
        motion = Similarity.between(
            in_order(read_camera_file(folder / "cameras.json"), self.names, self.full), self.camera
        )
        truth = nr.Mesh.load(folder / "truth.ply", texture_size=2)
        self.up = motion.points(torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]])).diff(dim=0)[0]
        self.vertices, self.faces = motion.points(truth.vertices.detach()), truth.faces.long()
        self.photos = torch.from_numpy(self.images).permute(0, 3, 1, 2)

    def outlines(self, share: float) -> np.ndarray:
        """Draw the outlines [N, H, W] of the lower share of the true mesh."""
        height = self.vertices @ self.up
        limit = height.min() + share * (height.max() - height.min())
        kept = self.faces[(height[self.faces] <= limit).all(1)]
        center, half = self.vertices.mean(0), float((self.vertices - self.vertices.mean(0)).abs().max())
        views = Views(self.camera, torch.ones(len(self.camera), *self.size)).normalized(center, half)
        with torch.no_grad():
            return views.draw(((self.vertices - center) / half, kept)).alpha.numpy() > 0.5

    def beside(self) -> tuple[float, float]:
        """Measure how large a thing `stands_beside` finds next to the true mesh, and next to its lower two thirds."""
        whole, part = (
            beside.stands_beside(self.photos, self.camera, self.points, self.outlines(share)) for share in (1.0, 2 / 3)
        )
        return whole, part

    def iou(self, masks: np.ndarray) -> float:
        pairs = zip(masks, self.masks, strict=True)
        return float(np.mean([(mask & true).sum() / max((mask | true).sum(), 1) for mask, true in pairs]))

    def colors(self, images: np.ndarray, points: torch.Tensor | None = None) -> np.ndarray:
        """Find masks [N, H, W] by colours, and points [P, 3], by default those of structure from motion."""
        place = find_place(self.camera, self.points if points is None else points, self.full)
        no_depth = np.zeros((len(images), 1, 1), np.int8)
        return object_masks._masks_of_colors(images, self.camera, place, lambda *_: None, no_depth)[0]

    @cached_property
    def turned(self) -> np.ndarray:
        """The photographs with the object before a still painting, with noise of 0.01."""
        painting = nr.load_image(_PAINTING)[..., :3].permute(2, 0, 1)
        still = F.interpolate(painting[None], self.size, mode="area")[0].permute(1, 2, 0).numpy()
        noise = np.random.default_rng(0).normal(0, 0.01, self.images.shape)
        return (np.where(self.masks[..., None], self.images, still) + noise).clip(0, 1).astype(np.float32)

    @cached_property
    def by_depth(self) -> tuple[shape_masks.ShapeMasks, np.ndarray]:
        """The object by depth of the fit, and masks by colours."""
        read = shape_masks.read_depth(self.folder / "alone", self.names)
        if read is None:
            raise ValueError(f"{self.folder}: expected depth of the photographs, got none")
        maps: DepthMaps = read[0]
        size = maps.depth.shape[1], maps.depth.shape[2]
        photos = F.interpolate(self.photos, size, mode="bilinear")
        solid = find_solid(Views(self.camera, torch.ones(len(self.names), *size), photos), maps)
        if isinstance(solid, str):
            raise ValueError(f"{self.folder}: {solid}")
        drawn = shape_masks.draw(solid, self.camera, self.size) > 0.5
        found = shape_masks.ShapeMasks(drawn, solid.maps, solid.ground, None, True, 0.0, torch.zeros(0, 3), solid)
        return found, self.colors(self.images)

    def contradictions(self) -> list[float]:
        found, colors = self.by_depth
        moved = np.roll(colors, colors.shape[2] // 10, 2)
        masks = colors, np.asarray(found.masks), moved
        shown = shape_masks.shown_by_depth(found, self.camera)
        return [shape_masks.contradiction(one, shown) for one in masks]


def score_beside(sets: list[Judged]) -> str:
    whole, part = zip(*(one.beside() for one in sets), strict=True)
    return f"{max(whole):.2%}, {min(part):.2%}"


_STAGES: dict[str, tuple[dict[ModuleType, str], Callable[[list[Judged]], str]]] = {
    "beside": ({beside: "_WINDOW _NOISES _LEAST _SPECK _HIDES _MOST_PLAIN _LEAST_STRANGE _HEIGHT"}, score_beside),
    "colours": (
        {
            histogram: "_BINS _NOTHING _SMOOTH",
            object_masks: "_BAND _WINDOW _LEAST_NOISE _LIKE _OTHERWISE",
            voxels: "_CELLS _NEAR _SMOOTH",
        },
        lambda sets: ", ".join(f"{one.iou(one.colors(one.images)):.3f}" for one in sets),
    ),
    "turntable": (
        {object_masks: "_STILL _MOSTLY _LEAST_STILL"},
        lambda sets: ", ".join(f"{one.iou(one.colors(one.turned, one.vertices[::10])):.3f}" for one in sets),
    ),
    "depth": (
        {shape_masks: "_SOLID_CELL _INSIDE"},
        lambda sets: "; ".join(" ".join(f"{share:.1%}" for share in one.contradictions()) for one in sets),
    ),
}

if __name__ == "__main__":
    main()
