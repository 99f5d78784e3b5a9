"""Quality of fits: ``python -m benchmarks.fit_quality MESHES --gradient nmr edge``.

For each mesh in a folder, 24 views of 256² are drawn with a fixed light and fitted; 12 other views are held out.
Prints a table and JSON: mean silhouette IoU (fitted and held-out views), PSNR of whole held-out images on black in
decibels, the mean distance between the surfaces in hundredths of half the longest side, seconds, and processor seconds
of all cores.

With ``--cameras``: cameras that are turned by 1° around themselves, moved by 1 % of their distance, and have a focal
length that is 1 % too long: exact cameras, these, and these refined. Held-out views are located on the result first, in
all three cases; the surface is brought to the truth by the similarity of the cameras.

With ``--lit fitted none``: 24 lit views without maps; outlines alone, and details from colours, with each of these.
Prints the distances and angles of ``--maps``, the quality on held-out views, processor seconds, and the largest
resident memory of the process so far in MB, so fit one mesh at a time to measure that.

With ``--maps``: `DetailFit` with maps of normals, from a sphere and from the fit of outlines, on 16 views. Prints the
RMS, the mean and the 95th percentile of the distances between the surfaces, in units of the longest side, and the
mean angle between normals in degrees, from 20,000 points on each surface to the nearest points of the other; the same
from points that the views show; and the processor seconds after which they were measured.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time
from dataclasses import replace
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor
from torch.nn import functional

import neural_renderer as nr
from neural_renderer.apps.fit import DetailFit, MeshFit, Views
from neural_renderer.apps.fit.cameras import Similarity, change_cameras, locate_cameras


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fit_quality", description=__doc__)
    parser.add_argument("meshes", type=Path, help="folder of meshes")
    parser.add_argument("--names", nargs="*", help="files in it (default: all OBJ files)")
    parser.add_argument("--gradient", nargs="*", default=["nmr"], help="estimators")
    parser.add_argument("--start", nargs="*", default=["hull"], help="hull, sphere")
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--cameras", action="store_true", help="perturb the cameras, and refine them")
    parser.add_argument("--maps", action="store_true", help="follow maps of normals instead")
    parser.add_argument("--lit", nargs="+", choices=("fitted", "none"), help="details from colours instead")
    parser.add_argument("--json", type=Path, help="also write the JSON here")
    parser.add_argument("--save", type=Path, help="folder for the fitted meshes")
    options = parser.parse_args()
    names = options.names or sorted(path.name for path in options.meshes.glob("*.obj"))
    rows = []
    for name in names:
        mesh = nr.Mesh.load(options.meshes / name, texture_size=6, normalize=True)
        for gradient in options.gradient:
            if options.maps:
                rows += [row for start in options.start for row in maps(name, options, start)]
                continue
            if options.lit:
                rows += lit(name, mesh, gradient, options)
                continue
            if options.cameras:
                rows += cameras(name, mesh, gradient, options)
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


def cameras(name: str, mesh: nr.Mesh, gradient: str, options: argparse.Namespace) -> list[dict[str, object]]:
    """Fit with exact cameras, with perturbed ones, and with these refined."""
    light = nr.Light(ambient=0.6, directional=0.4, direction=(0.4, 0.8, -0.45))
    exact = Views.of(mesh, around(24), options.size, light=light)
    held_out = Views.of(mesh, around(12, 61.0), options.size, light=light)
    off = replace(exact, camera=perturbed(exact.camera))
    rows = []
    for what, views in (("exact", exact), ("perturbed", off), ("refined", off)):
        begun = time.perf_counter()
        fit = MeshFit(views, gradient=gradient, steps=options.steps, refine_cameras=what == "refined")
        while not fit.done:
            fit.advance()
        seconds = time.perf_counter() - begun
        quality = locate_cameras(fit.normalize(held_out), fit.shape).quality(fit.shape)
        back, found = Similarity.between(fit.cameras(), exact.camera), fit.mesh()
        trace = torch.einsum("bij,bij->b", back.cameras(fit.cameras()).rotation, exact.camera.rotation)
        angles = torch.rad2deg(torch.acos(((trace - 1) / 2).clamp(-1, 1)))
        away, _ = surface_error((back.points(found.vertices.detach()), found.faces), (mesh.vertices, mesh.faces))
        if options.save:
            found.save(options.save / f"{Path(name).stem}_{what}.glb")
        rows.append(
            {
                "mesh": name,
                "cameras": what,
                "fitted IoU": fit.views.quality(fit.shape)["iou"].mean().item(),
                "held-out IoU": quality["iou"].mean().item(),
                "held-out PSNR": quality["psnr"].mean().item(),
                "mean": away.mean().item() / 2,
                "RMS": away.square().mean().sqrt().item() / 2,
                "cameras, °": angles.mean().item(),
                "seconds": round(seconds, 1),
            }
        )
        print(rows[-1], flush=True)
    return rows


def perturbed(camera: nr.Camera, degrees: float = 1.0, share: float = 0.01) -> nr.Camera:
    """Turn cameras around themselves, move them by a share of their distance, and lengthen the lens by as much."""
    random = torch.Generator().manual_seed(0)
    axes = functional.normalize(torch.randn(len(camera), 3, generator=random), dim=1) * math.radians(degrees)
    moves = functional.normalize(torch.randn(len(camera), 3, generator=random), dim=1) * share
    here = replace(camera, origin=torch.zeros_like(camera.origin))
    poses = torch.cat((axes, torch.zeros_like(axes)), 1)
    changed = change_cameras(here, poses, torch.full((1,), math.log1p(share)))
    return replace(changed, origin=camera.origin + camera.origin.norm(dim=1, keepdim=True) * moves)


def turned(cameras: nr.Camera, camera: nr.Camera) -> Tensor:
    """Compute the angles [S] in degrees between the rotations of S cameras and of another camera."""
    trace = torch.einsum("bij,ij->b", cameras.rotation, camera.rotation[0])
    return torch.rad2deg(torch.acos(((trace - 1) / 2).clamp(-1, 1)))


def maps(name: str, options: argparse.Namespace, start: str) -> list[dict[str, object]]:
    """Fit a mesh to outlines and normals; measure three times."""
    mesh = nr.Mesh.load(options.meshes / name, texture_size=2, normalize=True).merge_vertices()
    truth = mesh.vertices.detach(), mesh.faces
    views = replace(Views.of(mesh, around(16), options.size, normals=True), photos=None)
    shape: tuple[Tensor, ...] = nr.icosphere(3, radius=0.6)
    rows = []
    begun = time.process_time()
    if start == "hull":
        outlines = MeshFit(views, start, steps=150, detail_steps=0)
        while not outlines.done:
            outlines.advance()
        found = outlines.mesh()
        shape = found.vertices.detach(), found.faces
        rows.append(measured(name, "outlines", views, shape, truth, time.process_time() - begun))
    fit = DetailFit(views, *shape, steps=options.steps)
    while not fit.done:
        fit.advance()
        if fit.step in (fit.steps // 2, fit.steps):
            spent = time.process_time()
            rows.append(measured(name, f"{start}, step {fit.step}", views, fit.shape, truth, spent - begun))
            begun += time.process_time() - spent
    if options.save:
        nr.Mesh(*fit.shape).save(options.save / f"{Path(name).stem}_{start}_normals.glb")
    return rows


def lit(name: str, mesh: nr.Mesh, gradient: str, options: argparse.Namespace) -> list[dict[str, object]]:
    """Fit outlines alone, and details from colours."""
    light = nr.Light(ambient=0.6, directional=0.4, direction=(0.4, 0.8, -0.45))
    views = Views.of(mesh, around(24), options.size, light=light)
    held_out = Views.of(mesh, around(12, 61.0), options.size, light=light)
    truth = mesh.vertices.detach(), mesh.faces
    rows = []
    for what in (None, *options.lit):
        begun = time.process_time()
        fit = MeshFit(views, gradient=gradient, steps=options.steps, light=what)  # type: ignore[arg-type]
        while not fit.done:
            fit.advance()
        found = fit.mesh()
        spent = time.process_time() - begun
        quality = fit.normalize(held_out).quality(fit.shape)
        kind = "outlines" if what is None else f"light {what}"
        row = measured(name, kind, views, (found.vertices.detach(), found.faces), truth, spent)
        row["held-out IoU"] = quality["iou"].mean().item()
        row["held-out PSNR"] = quality["psnr"].mean().item()
        row["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        if options.save:
            found.save(options.save / f"{Path(name).stem}_{kind.replace(' ', '_')}.glb")
        rows.append(row)
    return rows


def measured(
    name: str, what: str, views: Views, shape: tuple[Tensor, ...], truth: tuple[Tensor, ...], seconds: float
) -> dict[str, object]:
    """Make a row of a table: distances of a shape from the truth, which is two units long."""
    away, angles = surface_error(shape, truth)
    seen = views_points(views, truth)
    hidden = nr.closest_points(shape, seen.points)
    row = {
        "mesh": name,
        "fit": what,
        "faces": len(shape[1]),
        "IoU": views.quality(shape[:2])["iou"].mean().item(),
        "RMS": away.square().mean().sqrt().item() / 2,
        "mean": away.mean().item() / 2,
        "95 %": away.quantile(0.95).item() / 2,
        "normals, °": angles.mean().item(),
        "RMS, visible": (hidden.points - seen.points).square().sum(1).mean().sqrt().item() / 2,
        "normals, visible": angle(hidden.normals, seen.normals).mean().item(),
        "seconds": round(seconds, 1),
    }
    print(row, flush=True)
    return row


def surface_error(shape: tuple[Tensor, ...], other: tuple[Tensor, ...], count: int = 20000) -> tuple[Tensor, Tensor]:
    """Measure from points on each surface to the closest ones on the other: distances, and angles between normals."""
    found = []
    for a, b in ((shape, other), (other, shape)):
        points = nr.sample_points(a[:2], count, torch.Generator().manual_seed(0))
        near = nr.closest_points(b[:2], points.points)
        found.append(((near.points - points.points).norm(dim=1), angle(near.normals, points.normals)))
    return torch.cat([away for away, _ in found]), torch.cat([angles for _, angles in found])


def views_points(views: Views, truth: tuple[Tensor, ...], count: int = 20000) -> nr.SurfacePoints:
    """Choose points of a surface that views show, evenly over the pixels."""
    with torch.no_grad():
        outputs = ("position", "face_index")
        images = nr.render(truth, views.camera, views.size, light=None, outputs=outputs, anti_aliasing=False)
    points = images.position.movedim(1, 3)[images.face_index >= 0]
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))
    return nr.closest_points(truth, points[order[:count]])


def angle(normals: Tensor, others: Tensor) -> Tensor:
    """Compute the angles [N] in degrees between unit vectors [N, 3]."""
    return torch.rad2deg(torch.acos((normals * others).sum(1).clamp(-1, 1)))


def distance(mesh: nr.Mesh, other: nr.Mesh) -> float:
    """Compute the mean distance from points on one surface to the nearest points on the other, in both directions."""
    both = ((each.vertices.detach(), each.faces) for each in (mesh, other))
    return float(surface_error(*both)[0].mean())


if __name__ == "__main__":
    main()
