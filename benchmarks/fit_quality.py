"""Quality of fits: ``python -m benchmarks.fit_quality MESHES --gradient nmr edge``.

For each mesh in a folder, 24 views of 256² are drawn with a fixed light and fitted; 12 other views are held out.
Prints a table and JSON: mean silhouette IoU (fitted and held-out views), PSNR of whole held-out images on black in
decibels, the mean distance between the surfaces in hundredths of half the longest side, seconds, and processor seconds
of all cores. With ``--poses N`` instead: the number of N random cameras that end within 5° of the true camera of one
image, and whether the camera with the least loss is right.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

import neural_renderer as nr
from neural_renderer.tasks.fit import CameraFit, MeshFit, Views


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fit_quality", description=__doc__)
    parser.add_argument("meshes", type=Path, help="folder of meshes")
    parser.add_argument("--names", nargs="*", help="files in it (default: all OBJ files)")
    parser.add_argument("--gradient", nargs="*", default=["nmr"], help="estimators")
    parser.add_argument("--start", nargs="*", default=["hull"], help="hull, sphere")
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--poses", type=int, default=0, help="recover cameras from so many starts instead")
    parser.add_argument("--json", type=Path, help="also write the JSON here")
    parser.add_argument("--save", type=Path, help="folder for the fitted meshes")
    options = parser.parse_args()
    names = options.names or sorted(path.name for path in options.meshes.glob("*.obj"))
    rows = []
    for name in names:
        mesh = nr.Mesh.load(options.meshes / name, texture_size=6, normalize=True)
        for gradient in options.gradient:
            if options.poses:
                rows += [pose(name, mesh, gradient, options.poses, options.steps, photo) for photo in (True, False)]
                print(rows[-2:], flush=True)
                continue
            for start in options.start:
                rows.append(shape(name, mesh, gradient, start, options))
                print(rows[-1], flush=True)
    table = Table()
    for column in rows[0]:
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(width=140).print(table)
    text = json.dumps(rows, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n", encoding="utf-8")


def around(count: int, turn: float = 0.0) -> nr.Camera:
    """Make cameras at evenly spaced heights from 40° below to 60° above, in steps of the golden angle."""
    place = (torch.arange(count) + 0.5) / count
    low, high = math.sin(math.radians(-40)), math.sin(math.radians(60))
    elevation = torch.rad2deg(torch.asin(low + (high - low) * place))
    azimuth = (torch.arange(count) * 137.50776 + turn) % 360
    return nr.Camera.look_at(nr.get_points_from_angles(3.2, elevation, azimuth), viewing_angle=25.0)


def shape(name: str, mesh: nr.Mesh, gradient: str, start: str, options: argparse.Namespace) -> dict[str, object]:
    light = nr.Light(ambient=0.6, directional=0.4, direction=(0.4, 0.8, -0.45))
    fitted = Views.of(mesh, around(24), options.size, light=light)
    held_out = Views.of(mesh, around(12, 61.0), options.size, light=light)
    begun = time.perf_counter(), time.process_time()
    fit = MeshFit(fitted, start, gradient=gradient, steps=options.steps)
    while not fit.done:
        fit.advance()
    seconds, work = time.perf_counter() - begun[0], time.process_time() - begun[1]
    fitted_quality, quality = fit.views.quality(fit.shape), fit.normalize(held_out).quality(fit.shape)
    if options.save:
        fit.mesh().save(options.save / f"{Path(name).stem}_{start}_{gradient}.glb")
    return {
        "mesh": name,
        "start": start,
        "gradient": gradient,
        "faces": len(fit.shape[1]),
        "fitted IoU": fitted_quality["iou"].mean().item(),
        "held-out IoU": quality["iou"].mean().item(),
        "least": quality["iou"].min().item(),
        "held-out PSNR": quality["psnr"].mean().item(),
        "distance": 100 * distance(fit.mesh(), mesh),
        "seconds": round(seconds, 1),
        "of processors": round(work, 1),
    }


def pose(name: str, mesh: nr.Mesh, gradient: str, starts: int, steps: int, photo: bool) -> dict[str, object]:
    camera = nr.Camera.look_at(nr.get_points_from_angles(3.0, 20.0, 215.0), viewing_angle=25.0)
    view = Views.of(mesh, camera, 128)
    whole = (mesh.vertices, mesh.faces, mesh.textures)
    begun = time.perf_counter()
    fit = CameraFit(
        whole if photo else whole[:2],
        view.masks[0],
        view.photos[0] if photo and view.photos is not None else None,
        viewing_angle=25.0,
        starts=starts,
        steps=steps,
        gradient=gradient,
    )
    before = turned(fit.cameras(), camera)
    while not fit.done:
        fit.advance()
    after = turned(fit.cameras(), camera)
    near = before < 60
    return {
        "mesh": name,
        "image": "photo" if photo else "silhouette",
        "gradient": gradient,
        "found of all": f"{int((after < 5).sum())} of {starts}",
        "of starts within 60°": f"{int((after < 5)[near].sum())} of {int(near.sum())}",
        "error of the best, °": after[fit.losses().argmin()].item(),
        "seconds": round(time.perf_counter() - begun, 1),
    }


def turned(cameras: nr.Camera, camera: nr.Camera) -> Tensor:
    """Compute the angles [S] in degrees between the rotations of S cameras and of another camera."""
    trace = torch.einsum("bij,ij->b", cameras.rotation, camera.rotation[0])
    return torch.rad2deg(torch.acos(((trace - 1) / 2).clamp(-1, 1)))


def distance(mesh: nr.Mesh, other: nr.Mesh, count: int = 8000) -> float:
    """Compute the mean distance from points on one surface to the nearest points on the other, in both directions."""
    between = torch.cdist(points(mesh, count), points(other, count))
    return float(between.amin(0).mean() + between.amin(1).mean()) / 2


def points(mesh: nr.Mesh, count: int) -> Tensor:
    """Sample points [count, 3] evenly on a surface, always the same points."""
    generator = torch.Generator().manual_seed(0)
    corners = mesh.vertices.detach()[mesh.faces.long()]
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=1)
    chosen = corners[torch.multinomial(area, count, True, generator=generator)]
    a, b = torch.rand(2, count, 1, generator=generator)
    return chosen[:, 0] * (1 - a.sqrt()) + chosen[:, 1] * a.sqrt() * (1 - b) + chosen[:, 2] * a.sqrt() * b


if __name__ == "__main__":
    main()
