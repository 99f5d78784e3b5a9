"""Half and double of constants of `find_pose`: ``python -m benchmarks.pose_constants [STAGE …]``.

Spot, the teapot and Suzanne are drawn from random sides, as in `benchmarks.pose`. Stages, each with processor seconds:

- shown: right poses of 12, two photos on black and two silhouettes of each object.
- hidden: right poses of 6, two half-hidden photos of each.
- depth: a photo's depth with noise of 0.2 %, without colours: error of each pose in degrees and in percent.
- lens: right rotations of 3 photos without a viewing angle, which are drawn with 10°, 20° and 40°.
- rig: five poses of a rig of three joints that are bent by 0.6 in the mean, in three masks of 96²: mean error of
  vertices of each, in percent of half the length of the rig.
- alike: photos that are called ambiguous: of nine of the objects, and of six of a cube and of a torus of one colour.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from functools import cache

import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.pose import descent, find, model, rig_fit, search, target

from .half_and_double import Stage, run_stages
from .pose import _ANGLE, _DATA, _OBJECTS, _SIZE, run, scene

_NAMES = "spot", "teapot", "suzanne"


def main() -> None:
    run_stages("python -m benchmarks.pose_constants", __doc__, _STAGES)


@cache
def objects() -> dict[str, nr.UVMesh]:
    return {name: nr.UVMesh.load(_DATA / _OBJECTS[name]).normalize() for name in _NAMES}


def score_runs(conditions: tuple[str, ...], poses: int) -> str:
    right, seconds, count = 0, 0.0, 0
    for mesh in objects().values():
        for seed in range(5000, 5000 + poses):
            for condition in conditions:
                good, took = run(_DATA, mesh, condition, torch.Generator().manual_seed(seed))
                right, seconds, count = right + good, seconds + took, count + 1
    return f"{right} of {count}, {seconds:.0f} s"


def errors(matrix: Tensor, pose: Tensor) -> tuple[float, float]:
    """Measure the angle in degrees and the distance, in percent of that from the camera, between two poses."""
    turn = nr.rotations.to_axis_angle(matrix[:3, :3] @ pose[:3, :3].T).norm()
    return math.degrees(float(turn)), 100 * float((matrix[:3, 3] - pose[:3, 3]).norm() / pose[:3, 3].norm())


def score_depth() -> str:
    found, begun = [], time.process_time()
    for mesh in objects().values():
        random = torch.Generator().manual_seed(5003)
        pose, _, mask = scene(mesh, random)
        camera = nr.Camera.from_matrix(world_to_camera=pose, viewing_angle=_ANGLE)
        drawn = nr.render(mesh, camera, _SIZE, outputs=("depth", "alpha"))
        depth = torch.where(drawn.alpha[0] > 0.999, drawn.depth[0], 0.0)
        depth = depth * (1 + 0.002 * torch.randn(depth.shape, generator=random))
        found.append(errors(nr.find_pose(mesh, None, mask, depth, viewing_angle=_ANGLE).matrix, pose))
    return ", ".join(f"{turn:.2f}° {away:.2f} %" for turn, away in found) + f", {time.process_time() - begun:.0f} s"


def score_lens() -> str:
    right, begun = [], time.process_time()
    for angle, mesh in zip((10.0, 20.0, 40.0), objects().values(), strict=True):
        random = torch.Generator().manual_seed(5004)
        pose, *_ = scene(mesh, random)
        pose[:3, 3] *= math.tan(math.radians(_ANGLE)) / math.tan(math.radians(angle))
        camera = nr.Camera.from_matrix(world_to_camera=pose, viewing_angle=angle)
        drawn = nr.render(mesh, camera, _SIZE, light=nr.CameraLight(), shading="smooth")
        found = nr.find_pose(mesh, drawn.rgb[0].clamp(0, 1), drawn.alpha[0])
        right.append(f"{errors(found.matrix, pose)[0]:.2f}° at {found.viewing_angle:.1f}°")
    return ", ".join(right) + f", {time.process_time() - begun:.0f} s"


@cache
def judged() -> tuple[list[list[float]], list[list[float]]]:
    """Find poses of objects and of symmetric shapes: residuals of all poses that were refined, from the best."""
    symmetric = []
    for vertices, faces in (nr.cube()[:2], nr.torus(0.7, 0.28, 32, 16)):
        textures = torch.full((len(faces), 2, 2, 2, 3), 0.6)
        symmetric.append(nr.Mesh(vertices / vertices.norm(dim=1).max(), faces, textures))
    found = []
    for meshes in (objects().values(), symmetric):
        each = []
        for seed in (5000, 5001, 5002):
            for mesh in meshes:
                _, photo, mask = scene(mesh, torch.Generator().manual_seed(seed))  # type: ignore[arg-type]
                pose = nr.find_pose(mesh, photo, mask, viewing_angle=_ANGLE)
                each.append([pose.residual, *pose.other_residuals.tolist()])
        found.append(each)
    return found[0], found[1]


def score_alike() -> str:
    factor, more = find._ALIKE
    counts = [sum(any(other < factor * best + more for other in others) for best, *others in one) for one in judged()]
    return f"{counts[0]} of 9, {counts[1]} of 6"


@cache
def bent() -> tuple[nr.Rig, nr.Camera, list[tuple[Tensor, Tensor]]]:
    """Make a rig of three boxes in a row, cameras, and the vertices and masks of five poses."""
    vertices, faces = nr.cube()
    sides = torch.tensor([[0.3, 0.45, 0.2], [0.15, 0.45, 0.3], [0.2, 0.45, 0.1]])
    places = torch.tensor([[0.0, -1.5, 0.0], [0.0, -0.5, 0.0], [0.0, 0.5, 0.0]])
    boxes = [vertices * side + place + torch.tensor([0.0, 0.5, 0.0]) for side, place in zip(sides, places, strict=True)]
    mesh = nr.Mesh(torch.cat(boxes), torch.cat([faces + 8 * row for row in range(3)]))
    rig = nr.Rig(mesh, (-1, 0, 1), places, torch.eye(3).repeat_interleave(8, 0))
    eyes = nr.get_points_from_angles(8.0, 20.0, torch.tensor([0.0, 60.0, 130.0]))
    camera = nr.Camera.look_at(eyes, viewing_angle=20)
    random, found = torch.Generator().manual_seed(0), []
    for _ in range(5):
        axes = torch.nn.functional.normalize(torch.randn(3, 3, generator=random), dim=1)
        pose = rig.pose(axes * 1.2 * torch.rand(3, 1, generator=random))
        found.append((rig.vertices(pose), nr.render(rig.posed(pose), camera, 96, outputs=("alpha",)).alpha))
    return rig, camera, found


def score_rig() -> str:
    rig, camera, poses = bent()
    away, begun = [], time.process_time()
    for vertices, masks in poses:
        fit = nr.fit_rig(rig, camera, masks)
        away.append(float((rig.vertices(fit.pose) - vertices).norm(dim=1).mean()) / 1.5)
    return " ".join(f"{one:.1%}" for one in away) + f", {time.process_time() - begun:.0f} s"


_STAGES: Mapping[str, Stage] = {
    "shown": (
        {
            find: "_SIZES _FACES _CANDIDATES _REFINED _COMPARED _BLOCK _LEAST_COLOR _HOPELESS _OTHER _SURE "
            "_CONTRAST _MOST_COLOR _MOSTLY _LAST_STEPS",
            search: "_TEMPLATE _RADII _ANGLES _REACH _SIDES _USUAL_SPREAD _NEAREST _FILLED _STEEP",
            descent: "_FIRST_DAMPING _LESS_DAMPING _MORE_DAMPING _LEAST_NOISE _LEAST_PRECISION _SCALE _SHORTEST "
            "_FARTHEST _LEAST_GAIN _PATIENCE",
            model: "_CELLS _COARSER _FEWEST _AWAY _LEAST_DEPTH RIDGE",
        },
        lambda: score_runs(("photo", "silhouette"), 2),
    ),
    "hidden": (
        {
            find: "_SETTLING _SETTLED FAR_PRICE _FIRST_KEPT _HIDDEN_COLOR",
            search: "_SHIFTS",
            descent: "_BLOCKS _LEFT_OUT",
            target: "_CLOSE _CLOSE_PRICE",
        },
        lambda: score_runs(("hidden",), 2),
    ),
    "depth": ({descent: "_DEEP"}, score_depth),
    "lens": ({find: "_USUAL_ANGLE"}, score_lens),
    "alike": ({find: "_ALIKE"}, score_alike),
    "rig": (
        {rig_fit: "_LEVELS _COARSEST _SAMPLES _REACH _TRIALS _REFINED _NEAR _LEAST_GAIN _WIDEST _CONVERGED"},
        score_rig,
    ),
}

if __name__ == "__main__":
    main()
