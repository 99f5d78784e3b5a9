"""Half and double of constants of a fit: ``python -m benchmarks.shape_constants STAGE SET …``.

A set is a folder of `benchmarks.path_traced`: photographs with true cameras, masks and surface, reduced to 96 pixels.
Each number is a mean of the sets. ``detail`` fits details from colours in 60 steps to a hull, ``shape`` outlines and
colours in 40: RMS of the distances from the true surface, in percent of the longest side, and mean angle between
normals in degrees. ``cameras`` perturbs cameras as `benchmarks.fit_quality` does and refines them with a coarse shape,
in 40 steps, and ``locate`` with the true surface and its outlines: mean angle in degrees from the true cameras.
``refined`` adds 40 steps for the shape: IoU with the masks, too. ``start`` fits outlines in 40 steps to a sphere: IoU.
``texture``: PSNR of every seventh view with the hull's texture from the others. ``agree``: mismatch of the hull's
colours in neighbouring views, relative to that of the true surface. ``hull`` has no sets: mean, over three drawn
objects with holes, of the share of enclosed background that hulls leave open, and IoU with masks.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.fit import (
    DetailFit,
    DetailWeights,
    FitWeights,
    MeshFit,
    ShapeFit,
    TextureFit,
    Views,
    cameras,
    descent,
    hull,
    load_views,
    mesh,
    shape,
    texture,
)
from neural_renderer.apps.fit.cameras import CameraRefinement, Similarity, locate_cameras
from neural_renderer.apps.fit.detail import adaptive_descent, color_model, consistency, detail_fit, pyramid, whole
from neural_renderer.apps.fit.settings import DescentSettings

from .fit_holes import OBJECTS, left_open
from .fit_quality import angle, around, perturbed, views_points
from .half_and_double import table, table_of_defaults

_SIZE, _POINTS = 96, 5000  # longer side in pixels; points of a surface whose distance is measured
_STAGES: dict[str, dict[ModuleType, tuple[str, ...]]] = {
    "detail": {
        adaptive_descent: ("_DECAYS", "_STEADY", "_GAIN", "_EVERY", "_BORDER", "_RELAX"),
        color_model: ("_DECAY", "_EXACT", "_RIDGE"),
        detail_fit: (
            *("_LONGEST", "_DECAY_FROM", "_FLAT_FROM", "_COLOR_RATE", "_SETTLE", "_FLOOR", "_REACH"),
            *("_SMOOTHER", "_FINER", "_SMOOTH_FROM"),
        ),
        pyramid: ("_EDGE_PIXELS",),
    },
    "shape": {
        shape: ("_TYPICAL_VERTICES", "_COLOR_RATE", "_COLOR_SMOOTH"),
        descent: ("_MOMENTUM", "_DECAY"),
    },
    "cameras": {
        shape: ("_COARSE_CELLS", "_MISSED", "_COARSE_LAPLACIAN", "_COARSE_RATE", "COARSE_RATE"),
        cameras: ("_FOCAL_RATE", "_PRIOR"),
        pyramid: ("_COARSE_SIZE",),
    },
    "locate": {cameras: ("COARSE_RATE",), pyramid: ("_COARSE_SIZE",)},
    "refined": {mesh: ("_REFINED_SCALE", "_REFINED_COLOR_FROM")},
    "start": {mesh: ("_SPHERE_RADIUS", "_SPHERE_PACE")},
    "texture": {whole: ("_STEPS",), texture: ("_OUTLINE",)},
    "agree": {consistency: ("_NEAREST", "_WINDOW", "_NOISE", "_SHARED")},
    "hull": {
        hull: (
            *("_HALF", "_POINTS", "_LEAST_COMPONENT", "LEVELS", "_LEAST_COVERED", "_LEAST_VIEWS"),
            "_MOST_LEFT",
        )
    },
}

_DEFAULTS: dict[str, dict[Any, str]] = {
    "detail": {DetailFit: "rate", DetailWeights: "photometric albedo smooth"},
    "shape": {ShapeFit: "rate smooth", FitWeights: "photometric laplacian normal_consistency"},
    "refined": {ShapeFit: "camera_rate"},
    "locate": {locate_cameras: "steps"},
    "texture": {TextureFit: "smooth"},
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.shape_constants", description=__doc__)
    parser.add_argument("stage", choices=_STAGES)
    parser.add_argument("sets", type=Path, nargs="*", help="folders of photographs with cameras and masks")
    options = parser.parse_args()
    if options.stage == "hull":
        light = nr.Light()
        scenes = [Drawn(Views.of(make(), around(24), 2 * _SIZE, light=light)) for make in OBJECTS.values()]
        measures: list[Callable[[], tuple[float, ...]]] = [scene.hull for scene in scenes]
    else:
        measures = [getattr(Known(folder), options.stage) for folder in options.sets]

    def score() -> str:
        return ", ".join(f"{value:.3f}" for value in np.mean([measure() for measure in measures], 0))

    table(_STAGES[options.stage], score)
    table_of_defaults(_DEFAULTS.get(options.stage, {}), score)


class Drawn:
    """Drawings of an object with holes."""

    def __init__(self, views: Views) -> None:
        self.views = views

    def hull(self) -> tuple[float, float]:
        views = self.views.normalized(*hull.object_bounds(self.views))
        found = hull.carve_levels(views, hull.LEVELS)
        return left_open(views, found), float(views.quality(found)["iou"].mean())


class Known:
    """Photographs with true cameras and masks, and the true surface, in a world where the object is about two long."""

    def __init__(self, folder: Path) -> None:
        views = load_views(folder, size=_SIZE, masks=folder / "masks")
        center, half = hull.object_bounds(views)
        self.views = views.normalized(center, half)
        true = nr.Mesh.load(folder / "truth.ply", texture_size=2).merge_vertices()
        self.truth = (true.vertices.detach() - center) / half, true.faces.long()
        self.shown = views_points(self.views, self.truth, _POINTS)
        self.hull = hull.carve(self.views, 48)

    def detail(self) -> tuple[float, float]:
        fit = DetailFit(self.views, *self.hull, steps=60, light="fitted", weights=DetailWeights())
        while not fit.done:
            fit.advance()
        return self._errors(fit.shape)

    def shape(self) -> tuple[float, float]:
        fit = ShapeFit(self.views, *self.hull, steps=40, color_from=0.5, weights=FitWeights())
        while not fit.done:
            fit.advance()
        return self._errors(fit.shape)

    def cameras(self) -> tuple[float]:
        views = replace(self.views, camera=perturbed(self.views.camera))
        refinement = CameraRefinement(views.camera)
        fit = shape.coarse_fit(views, *shape.coarse_hull(views), refinement, 40, DescentSettings())
        while not fit.done:
            fit.advance()
        return (self._angle(refinement.camera),)

    def locate(self) -> tuple[float]:
        some = self.views[list(range(0, len(self.views), 7))].silhouettes()
        views = replace(some, camera=perturbed(some.camera))
        return (self._angle(locate_cameras(views, self.truth).camera, some.camera),)

    def refined(self) -> tuple[float, float]:
        views = replace(self.views, camera=perturbed(self.views.camera))
        fit = MeshFit(views, steps=40, camera_steps=40, refine_cameras=True)
        while fit.phase != "texture":
            fit.advance()
        return self._angle(fit.cameras()), float(fit.views.quality(fit.shape[:2])["iou"].mean())

    def start(self) -> tuple[float]:
        fit = MeshFit(self.views.silhouettes(), start="sphere", steps=40)
        while not fit.done:
            fit.advance()
        return (float(fit.views.quality(fit.shape[:2])["iou"].mean()),)

    def texture(self) -> tuple[float]:
        tests = list(range(0, len(self.views), 7))
        known = self.views[[row for row in range(len(self.views)) if row not in tests]]
        fit = TextureFit(known, *self.hull, steps=whole._STEPS)
        while not fit.done:
            fit.advance()
        return (float(self.views[tests].quality(tuple(part.detach() for part in fit.shape))["psnr"].mean()),)

    def agree(self) -> tuple[float]:
        rows = list(range(0, len(self.views), 4))
        wrong, right = (consistency.mismatch(self.views, rows, *one) for one in (self.hull, self.truth))
        return (wrong / right,)

    def _errors(self, found: tuple[Tensor, ...]) -> tuple[float, float]:
        near = nr.closest_points(found[:2], self.shown.points)
        away = (near.points - self.shown.points).norm(dim=1)
        return 100 * float(away.square().mean().sqrt()) / 2, float(angle(near.normals, self.shown.normals).mean())

    def _angle(self, camera: nr.Camera, true: nr.Camera | None = None) -> float:
        true = self.views.camera if true is None else true
        moved = Similarity.between(camera, true).cameras(camera)
        turns = torch.einsum("bij,bij->b", moved.rotation, true.rotation)
        return float(torch.rad2deg(((turns - 1) / 2).clamp(-1, 1).acos()).mean())


if __name__ == "__main__":
    main()
