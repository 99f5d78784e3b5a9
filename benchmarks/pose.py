"""Poses of known objects from one picture: ``python -m benchmarks.pose [--poses 50] [--only photo hidden]``.

Each object is drawn at 256² from random sides, at a distance of 4 to 7 of its radii, with a viewing angle of 20° and
smooth shading under a random light; `nr.find_pose` knows neither pose nor light. A pose is right if its rotation is
within 1° and its place within 1 % of the distance. For silhouettes, a pose that shows the same silhouette, to an IoU
of 0.995, is right, too: the picture does not tell which one it is. Seconds are processor time on one thread.
"""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from pathlib import Path

import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.fit import MaskRule
from neural_renderer.optim import metrics

_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_OBJECTS = {
    "spot": "meshes/standard/spot_triangulated.obj",
    "teapot": "meshes/standard/teapot_kato.obj",
    "suzanne": "meshes/standard/suzanne.obj",
    "bunny": "meshes/standard/bunny_kato.obj",
    "car": "models/car/gazebo__hatchback.obj",
    "chair": "models/chair/kaykit_furniture__chair_A.obj",
}
_CONDITIONS = ("photo", "clutter", "plain", "silhouette", "focal", "hidden")
_ANGLE, _SIZE = 20.0, 256
_NOISE = 0.01  # standard deviation of that of photos on white


def scene(mesh: nr.UVMesh, random: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Draw a mesh of radius about 1 in a random pose: return the pose [4, 4], the photo and the mask."""
    pose = torch.eye(4)
    pose[:3, :3] = nr.rotations.from_quaternion(torch.randn(4, generator=random))
    depth = 4 + 3 * torch.rand(1, generator=random)
    shift = (torch.rand(2, generator=random) - 0.5) * 0.24 * depth
    pose[:3, 3] = torch.cat((shift, depth))
    camera = nr.Camera.from_matrix(world_to_camera=pose, viewing_angle=_ANGLE)
    beam = torch.nn.functional.normalize(torch.randn(3, generator=random), dim=0)
    beam = pose[:3, :3].T @ torch.tensor([0.7 * beam[0], 0.7 * beam[1] - 0.3, -0.8])
    light = nr.Light(direction=tuple(torch.nn.functional.normalize(beam, dim=0).tolist()))
    with torch.no_grad():
        images = nr.render(mesh, camera, _SIZE, light=light, shading="smooth")
    return pose, images.rgb[0].clamp(0, 1), images.alpha[0]


def clutter(data: Path, random: torch.Generator) -> Tensor:
    """Cut a square from a painting."""
    files = sorted((data / "styles").glob("*.jpg"))
    picture = nr.load_image(files[int(torch.randint(len(files), (1,), generator=random))])[..., :3].permute(2, 0, 1)
    picture = torch.nn.functional.interpolate(picture[None], (2 * _SIZE, 2 * _SIZE), mode="area")[0]
    top, left = torch.randint(_SIZE, (2,), generator=random).tolist()
    return picture[:, top : top + _SIZE, left : left + _SIZE]


def hiding(mask: Tensor, random: torch.Generator) -> Tensor:
    """Cover half of the object by a plane with a straight edge, [H, W] of 0 and 1."""
    at = torch.arange(_SIZE) + 0.5
    angle = 2 * math.pi * float(torch.rand(1, generator=random))
    along = at[None] * math.cos(angle) + at[:, None] * math.sin(angle)
    return (along > along[mask > 0.5].median()).float()


def run(data: Path, mesh: nr.UVMesh, condition: str, random: torch.Generator) -> tuple[bool, float]:
    """Find one pose; return whether it is right, and the seconds."""
    pose, photo, mask = scene(mesh, random)
    angle = _ANGLE
    if condition == "clutter":
        photo = photo + (1 - mask) * clutter(data, random)
    if condition == "hidden":
        cover = hiding(mask, random)
        photo, mask = photo * (1 - cover) + cover * clutter(data, random), mask * (1 - cover)
    if condition == "focal":
        angle = math.degrees(math.atan(1.2 * math.tan(math.radians(angle))))
    if condition == "plain":
        photo = (photo + 1 - mask + _NOISE * torch.randn(photo.shape, generator=random)).clamp(0, 1)
    photo, mask = ((255 * image).round() / 255 for image in (photo, mask))
    begun = time.process_time()
    if condition == "plain":
        mask = MaskRule().find(photo.permute(1, 2, 0))
    found = nr.find_pose(
        mesh,
        None if condition == "silhouette" else photo,
        mask,
        viewing_angle=angle,
        fit_focal=condition == "focal",
        hidden=condition == "hidden",
    )
    seconds = time.process_time() - begun
    turn = nr.rotations.to_axis_angle(found.matrix[:3, :3] @ pose[:3, :3].T).norm()
    away = (found.matrix[:3, 3] - pose[:3, 3]).norm() / pose[:3, 3].norm()
    right = math.degrees(float(turn)) < 1 and float(away) < 0.01
    if not right and condition == "silhouette":
        alpha = nr.render(mesh, found.camera, _SIZE, outputs=("alpha",)).alpha
        right = float(metrics.silhouette_iou(alpha, mask[None])) > 0.995
    return right, seconds


def interval(right: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Compute Wilson's interval of a share, of 95 %."""
    middle = (right + z * z / 2) / (count + z * z)
    half = z * math.sqrt(right * (count - right) / count + z * z / 4) / (count + z * z)
    return middle - half, middle + half


def main() -> None:
    """Print the table, a row for each condition and object; and each pose to the log, as it is found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=50)
    parser.add_argument("--first", type=int, default=1000, help="seed of the first pose; none of them was tuned on")
    parser.add_argument("--only", nargs="+", choices=_CONDITIONS, default=_CONDITIONS)
    parser.add_argument("--objects", nargs="+", choices=_OBJECTS, default=list(_OBJECTS))
    parser.add_argument("--data", type=Path, default=_DATA, help="folder with meshes, models and styles")
    options = parser.parse_args()
    torch.set_num_threads(1)
    meshes = {name: nr.UVMesh.load(options.data / _OBJECTS[name]).normalize() for name in options.objects}
    for condition in options.only:
        found: dict[str, list[tuple[bool, float]]] = {name: [] for name in meshes}
        for seed in range(options.first, options.first + options.poses):  # all objects, if a run ends early
            for name, mesh in meshes.items():
                right, seconds = run(options.data, mesh, condition, torch.Generator().manual_seed(seed))
                found[name].append((right, seconds))
                print(f"{condition} {name} {seed}: {right} {seconds:.2f}", file=sys.stderr, flush=True)
        every = [each for own in found.values() for each in own]
        print("| picture | object | right | 95 % interval | median seconds |\n|---|---|---|---|---|")
        for name, own in (*found.items(), ("all", every)):
            right, seconds = sum(good for good, _ in own), statistics.median(spent for _, spent in own)
            low, high = interval(right, len(own))
            print(
                f"| {condition} | {name} | {right} of {len(own)} | {low:.1%} to {high:.1%} | {seconds:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
