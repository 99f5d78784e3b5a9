"""Half and double of constants of depth, solids and surfaces: ``python -m benchmarks.geometry_constants STAGE SET …``.

A set is a folder of `benchmarks.path_traced` with the result of its fit ``alone``; each number is a mean of the sets.
``depth`` and ``surface`` take eight neighbouring photographs of 64 and of 112 pixels: the share of pixels of the true
mesh that have a depth, and of these the share within 1% of the true depth. ``solid`` takes the depth of the fit: IoU of
the solid's drawings with those of the true mesh, and the mean distance of its vertices from the true mesh in percent of
its longest side. ``cut`` is the same with a box around the object in one photograph.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.views.views import Views, downscale
from neural_renderer.apps.fit.cameras import Similarity
from neural_renderer.apps.fit.photos.geometry import cut, depth, solid, surface, sweep
from neural_renderer.apps.fit.photos.masks.shape_masks import draw, read_depth
from neural_renderer.camera.files import read_camera_file
from neural_renderer.io.images import load_reduced

from .half_and_double import table
from .verdicts import in_order

_SIDES, _FEW = {"depth": 64, "surface": 112}, 8  # longer side in pixels, and number, of photographs of some stages
_STAGES = {
    "depth": {
        depth: (
            *("_PARTNERS", "_BEST_ANGLE", "_AROUND", "_SHIFT", "_TAIL", "_WIDER"),
            *("_CORRELATION", "_TOLERANCE"),
        ),
        sweep: ("_NOISE", "_BEST", "_STEP", "_JUMP", "_EDGE", "_UNSEEN"),
    },
    "surface": {surface: (*("_LEVELS", "_SLOPE", "_CELL", "_MOST_DEPTH", "_REACH", "_EDGE", "_PASSES"),)},
    "solid": {
        depth: ("_LEAST_SUPPORT",),
        solid: (
            *("FLAT", "_SAMPLE", "_VIEW_POINTS", "SHARE", "_SEARCH", "_BINS", "_LEAST_IN_BIN"),
            *("_NEAR", "_FLOATS", "_LOWEST", "_GAP", "_MOST_PIECES", "_LEAST_PIECE", "_MOST_OUTSIDE", "_MARGIN"),
            *("_CELLS", "_BAND", "_BEHIND", "_SURE", "_TENSION", "_LEAST_SHARE", "_STEPS", "_SMOOTH"),
        ),
    },
    "cut": {solid: ("_SAMPLE", "_IN_BOX"), cut: ("_NEIGHBOURS", "_REACH", "_TENSION", "_ROUNDS")},
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.geometry_constants", description=__doc__)
    parser.add_argument("stage", choices=_STAGES)
    parser.add_argument("sets", type=Path, nargs="+", help="folders of photographs with a fit")
    options = parser.parse_args()
    scenes = [Scene(folder, _SIDES.get(options.stage)) for folder in options.sets]
    _keep("_votes", "_CELLS _BAND _BEHIND _SURE")
    _keep("_least_surface", "_CELLS _TENSION _STEPS")

    def score() -> str:
        first, second = np.mean([getattr(scene, options.stage)() for scene in scenes], 0)
        return f"{first:.3f}, {second:.3f}"

    table(_STAGES[options.stage], score)


def _keep(name: str, constants: str) -> None:
    """Let a function of `solid` keep its results, as most constants do not change its arguments."""
    function, kept = getattr(solid, name), dict[tuple[object, ...], np.ndarray]()

    def call(*parts: Any) -> np.ndarray:
        key = (*map(_identity, parts), *(getattr(solid, constant) for constant in constants.split()))
        if key not in kept:
            kept[key] = function(*parts)
        return kept[key]

    setattr(solid, name, call)


def _identity(part: Any) -> object:
    if isinstance(part, depth.DepthMaps):
        return id(part.depth), part.others is not None and hash(part.others.numpy().tobytes())
    return hash(part.tobytes()) if isinstance(part, np.ndarray) else id(part)


class Scene:
    """Photographs with the cameras and the depth that were found, and the true mesh in their world."""

    def __init__(self, folder: Path, side: int | None) -> None:
        found, true = (read_camera_file(folder / name) for name in ("alone/sparse/0/images.bin", "cameras.json"))
        names = [entry.name for entry in found.images]
        known = read_depth(folder / "alone", names)
        if known is None or found.points is None:
            raise ValueError(f"{folder}: expected a fit of photographs alone, got none")
        self.maps, self.points = known[0], found.points
        files, longer = [folder / "alone/images" / name for name in names], side or max(self.maps.depth.shape[1:])
        pictures = (load_reduced(file, least=longer)[0][..., :3].permute(2, 0, 1) for file in files)
        photos = torch.stack([downscale(picture, longer) for picture in pictures])
        size = (photos.shape[2], photos.shape[3])
        camera = found.cameras(size)
        motion = Similarity.between(in_order(true, names, size), camera)
        self.views = Views(camera, torch.ones(len(photos), *size), photos)
        if side is not None:
            eyes = self.views.eyes()[0]
            self.views = self.views[(eyes - eyes[0]).norm(dim=1).argsort()[:_FEW].tolist()]
        mesh = nr.Mesh.load(folder / "truth.ply", texture_size=2).merge_vertices()
        self.truth = motion.points(mesh.vertices.detach()), mesh.faces.long()
        self.side = float((self.truth[0].amax(0) - self.truth[0].amin(0)).max())
        self.tree = cKDTree(self.truth[0].numpy())
        self.true_depth = self._depth_of(*self.truth)

    def _depth_of(self, vertices: Tensor, faces: Tensor) -> Tensor:
        """Draw the depth [N, H, W] of a mesh; pixels that do not show it are NaN."""
        images = nr.render(
            *((vertices, faces), self.views.camera, self.views.size), outputs=("depth", "alpha"), near=1e-3, far=1e4
        )
        return torch.where(images.alpha > 0.99, images.depth, torch.nan)

    def depth(self) -> tuple[float, float]:
        maps = depth.find_depth(self.views, self.points, _quiet)
        if maps is None:
            return 0.0, 0.0
        return self._compared(torch.where(solid.supported(maps), maps.depth, torch.nan))

    def surface(self) -> tuple[float, float]:
        return self._compared(self._depth_of(*surface.find_surface(self.views, self.points, _quiet)))

    def _compared(self, found: Tensor) -> tuple[float, float]:
        true, known = self.true_depth, torch.isfinite(self.true_depth)
        both = known & torch.isfinite(found)
        right = ((found / true - 1).abs() < 0.01)[both].float().mean()
        return float(both.sum() / known.sum()), float(right)

    def solid(self, target: solid.Target | None = None) -> tuple[float, float]:
        found = solid.find_solid(self.views, self.maps, target)
        if isinstance(found, str):
            return 0.0, float("nan")
        drawn, true = draw(found, self.views.camera, self.views.size) > 0.5, torch.isfinite(self.true_depth).numpy()
        iou = ((drawn & true).sum((1, 2)) / (drawn | true).sum((1, 2))).mean()
        return float(iou), 100 * float(self.tree.query(found.vertices.numpy())[0].mean()) / self.side

    def cut(self) -> tuple[float, float]:
        inside = torch.isfinite(self.true_depth[0]).nonzero()
        low, high = (inside.amin(0) - 2).tolist(), (inside.amax(0) + 3).tolist()
        height, width = self.views.size
        return self.solid((0, (low[1] / width, low[0] / height, high[1] / width, high[0] / height)))


def _quiet(_: str, __: int, ___: int) -> None: ...


if __name__ == "__main__":
    main()
