"""Fits to photographs by a path tracer: ``python -m benchmarks.path_traced MESHES FOLDER`` (needs Mitsuba 3).

Six objects stand on a textured floor under a sky with two windows, so that there are cast shadows, interreflections and
highlights, none of which `neural_renderer` computes. Each gets a folder with ``cameras.json``, photographs, masks, and
``truth.ply`` in the world of the cameras; a folder that exists is not drawn again. Cameras stand on two rings, 14° and
42° above the floor. Mitsuba draws the masks, too, without the floor.

Every seventh view is held out. Each object is fitted with cameras and masks, from outlines alone and with each light,
or with ``--light alone`` from the photographs alone, and brought to the truth by a similarity. After that,
``found-masks`` takes the masks that were found, with the true cameras, and ``found-cameras`` the reverse.
Prints the RMS and the mean of the distances between the surfaces in units of the longest side, and the mean angle
between normals in degrees, from 20,000 points that the fitted views show of each surface to the nearest points of the
other; the quality on held-out views; and processor seconds.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.fit import DetailSettings, MeshFit, Views, load_views
from neural_renderer.apps.fit.cameras import Similarity
from neural_renderer.camera.files import read_camera_file
from neural_renderer.camera.files.opencv import save_cameras

from .fit_quality import angle, views_points

_ANGLE, _DISTANCE = 17.0, 5.0  # half the field of view in degrees; objects are two units long
# File → levels of subdivision, contrast of the pattern, roughness of the gloss (0: none)
OBJECTS = {
    "spot_triangulated.obj": (2, 0.0, 0.4),  # has a texture of its own
    "stanford-bunny.obj": (0, 0.8, 0.0),
    "armadillo_29k.obj": (0, 0.35, 0.5),
    "suzanne.obj": (3, 0.8, 0.0),
    "goathead.obj": (2, 0.35, 0.0),
    "teapot_newell_3parts.obj": (2, 0.8, 0.3),
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.path_traced", description=__doc__)
    parser.add_argument("meshes", type=Path, help="folder of meshes")
    parser.add_argument("folder", type=Path, help="folder for the photographs")
    parser.add_argument("--names", nargs="*", default=list(OBJECTS), help="files in it")
    parser.add_argument("--views", type=int, default=28, help="an even number")
    parser.add_argument("--size", type=int, default=448)
    parser.add_argument("--samples", type=int, default=25, help="paths of each pixel, a square")
    parser.add_argument("--light", nargs="*", default=["outlines", "none", "fitted"], help="fits to measure")
    parser.add_argument("--fit-size", type=int, default=256)
    options = parser.parse_args()
    rows = []
    for name in options.names:
        folder = options.folder / Path(name).stem
        if not folder.exists():
            begun = time.process_time()
            photograph(options.meshes / name, folder, options)
            print(name, f"{time.process_time() - begun:.0f} processor seconds", flush=True)
        for light in options.light:
            alone = light == "alone" or light.startswith("found-")
            rows.append(measure_alone(folder, light) if alone else measure(folder, light, options.fit_size))
            print(rows[-1], flush=True)
    for light in options.light:
        means = {key: [row[key] for row in rows if row["fit"] == light] for key in ("RMS", "mean", "normals, °")}
        print(light, {key: sum(values) / len(values) for key, values in means.items()})


def measure(folder: Path, light: str, size: int) -> dict[str, Any]:
    """Fit an object with its cameras and masks, and measure the result."""
    views = load_views(folder, size=size, masks=folder / "masks")
    kept = [row for row in range(len(views)) if row % 7 < 6]
    known = views[kept]
    begun = time.process_time()
    fit = MeshFit(known, detail=DetailSettings(light=None if light == "outlines" else light))  # type: ignore[arg-type]
    result = fit.run(views[[row for row in range(len(views)) if row % 7 == 6]])
    seconds = time.process_time() - begun
    truth = nr.Mesh.load(folder / "truth.ply", texture_size=2).merge_vertices()
    result.mesh.save(folder / f"{light}.glb")
    away, angles = visible_error(known, result.mesh, truth)
    return {
        "mesh": folder.name,
        "fit": light,
        "faces": len(result.mesh.faces),
        "RMS": away.square().mean().sqrt().item() / 2,
        "mean": away.mean().item() / 2,
        "normals, °": angles.mean().item(),
        **{f"held-out {name}": values.mean().item() for name, values in (result.held_out or {}).items()},
        "seconds": round(seconds),
    }


def measure_alone(folder: Path, fit: str) -> dict[str, Any]:
    """Fit an object to its photographs alone, or with the true cameras or masks, by the command, and measure it."""
    output = folder / fit
    begun = time.process_time()
    source = {
        "alone": [folder / "images", "--held-out", "7"],
        "found-masks": [folder, "--held-out", "7", "--masks", folder / "alone/masks"],
        "found-cameras": [folder / "alone/cameras.json", "--masks", folder / "masks"],
    }[fit]
    light = [] if fit == "alone" else ["--light", "fitted", "--no-check"]
    cli.main(["fit", *map(str, source), "-o", str(output), "--turntable", "0", "--force", *light])
    seconds = time.process_time() - begun
    return {"mesh": folder.name, "fit": fit, **alone_error(folder, output), "seconds": round(seconds)}


def alone_error(folder: Path, output: Path) -> dict[str, float]:
    """Compare the result of photographs alone with the truth: cameras, masks, surface and held-out views."""
    views = load_views(folder, masks=folder / "masks")
    cameras = folder / "cameras.json" if output.name == "found-masks" else folder / "alone/cameras.json"
    found = read_camera_file(cameras if cameras.is_file() else output / "sparse/0/images.bin")
    places = {Path(entry.name).name: row for row, entry in enumerate(read_camera_file(folder / "cameras.json").images)}
    rows = [places[Path(entry.name).name] for entry in found.images]
    true, cameras = views.camera[rows], found.cameras(views.size)
    motion = Similarity.between(cameras, true)
    turns = torch.einsum("bij,bij->b", motion.cameras(cameras).rotation, true.rotation)
    eyes = [Views(camera, views.masks[rows]).eyes()[0] for camera in (motion.cameras(cameras), true)]
    truth = nr.Mesh.load(folder / "truth.ply", texture_size=2).merge_vertices()
    mesh = nr.Mesh.load(output / "mesh.glb", texture_size=2).merge_vertices()
    moved = nearest(views, nr.Mesh(motion.points(mesh.vertices.detach()), mesh.faces), truth)
    away, angles = visible_error(views, moved, truth)
    report = json.loads((output / "report.json").read_text()).get("held_out") or {}
    masks = [
        [nr.load_image(place) for place in (folder / "masks" / f"{name}", output / "masks" / f"{name}.png")]
        for name in places
        if (output / "masks" / f"{name}.png").is_file()
    ]
    inside = [(one[..., 0] > 0.5, other[..., 0] > 0.5) for one, other in masks]
    left = views[[row for row in range(len(views)) if row % 7 == 6]]
    return {
        "placed": len(found.images),
        "cameras, °": torch.rad2deg(((turns - 1) / 2).clamp(-1, 1).acos()).mean().item(),
        "cameras, %": 100 * ((eyes[0] - eyes[1]).norm(dim=1).mean() / _DISTANCE).item(),
        "masks": sum(float((a & b).sum() / (a | b).sum()) for a, b in inside) / max(1, len(inside)),
        "RMS": away.square().mean().sqrt().item() / 2,
        "mean": away.mean().item() / 2,
        "normals, °": angles.mean().item(),
        "held-out iou": left.quality((moved.vertices, moved.faces))["iou"].mean().item(),
        "held-out psnr": report.get("psnr", {}).get("mean", math.nan),
    }


def nearest(views: Views, mesh: nr.Mesh, truth: nr.Mesh, steps: int = 12) -> nr.Mesh:
    """Bring the visible surface of a mesh as near as possible to another, by a similarity of its closest points."""
    goal = truth.vertices.detach(), truth.faces
    for _ in range(steps):
        points = views_points(views, (mesh.vertices, mesh.faces)).points
        near = nr.closest_points(goal, points).points
        away = (near - points).norm(dim=1)
        close = away <= away.quantile(0.9)
        points, near = points[close].double(), near[close].double()
        around, goals = points - points.mean(0), near - near.mean(0)
        left, sizes, right = torch.linalg.svd(goals.t() @ around)
        signs = torch.tensor([1.0, 1.0, float(torch.linalg.det(left @ right))]).double()
        scale = float((sizes * signs).sum() / around.square().sum())
        vertices = scale * (mesh.vertices.double() - points.mean(0)) @ (left * signs @ right).t() + near.mean(0)
        mesh = nr.Mesh(vertices.float(), mesh.faces)
    return mesh


def visible_error(views: Views, mesh: nr.Mesh, truth: nr.Mesh) -> tuple[Tensor, Tensor]:
    """Measure from points that views show of each surface to the closest ones of the other: distances and angles."""
    found = []
    shapes = [(each.vertices.detach(), each.faces) for each in (mesh, truth)]
    for shape, other in (shapes, shapes[::-1]):
        seen = views_points(views, shape)
        near = nr.closest_points(other, seen.points)
        found.append(((near.points - seen.points).norm(dim=1), angle(near.normals, seen.normals)))
    return torch.cat([away for away, _ in found]), torch.cat([angles for _, angles in found])


def photograph(source: Path, folder: Path, options: argparse.Namespace) -> None:
    """Draw the photographs and masks of an object, and write its cameras and its true surface."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    levels, contrast, roughness = OBJECTS[source.name]
    mesh = nr.UVMesh.load(source).normalize()
    mesh = mesh.subdivide(levels, "loop") if levels else mesh
    vertices, faces = mesh.vertices.detach(), mesh.faces.long()
    colors = pattern(vertices, contrast) if contrast else own_colors(mesh)
    folder.mkdir(parents=True)
    for part in ("images", "masks"):
        (folder / part).mkdir()
    nr.Mesh(vertices, faces).save(folder / "truth.ply")
    rings = torch.arange(options.views) % 2
    azimuth = torch.arange(options.views) * 360.0 / options.views
    eyes = nr.get_points_from_angles(_DISTANCE, 14.0 + 28.0 * rings, azimuth)
    names = [f"images/{number:03d}.png" for number in range(options.views)]
    save_cameras(
        folder / "cameras.json", nr.Camera.look_at(eyes, viewing_angle=_ANGLE), names, (options.size, options.size)
    )
    with tempfile.TemporaryDirectory() as place:
        shape = scene_mesh(vertices, faces, colors, Path(place) / "object.ply", roughness)
        ground = float(vertices[:, 1].min())
        full = mi.load_dict(
            {"type": "scene", "integrator": {"type": "path", "max_depth": 4}, **surroundings(ground), **shape}
        )
        alone = mi.load_dict({"type": "scene", "integrator": {"type": "direct", "hide_emitters": True}, **shape})
        for number, eye in enumerate(eyes.tolist()):
            radiance = np.array(
                mi.render(full, sensor=sensor(eye, options.size, options.samples), spp=options.samples, seed=number)
            )
            image = nr.linear_to_srgb(torch.from_numpy(radiance[..., :3]).clamp(0, 1)).movedim(2, 0)
            nr.save_image(folder / names[number], image)
            mask = np.array(mi.render(alone, sensor=sensor(eye, options.size, 16), spp=16, seed=number))[..., 3]
            nr.save_image(folder / "masks" / Path(names[number]).name, torch.from_numpy(mask).clamp(0, 1))


def sensor(eye: list[float], size: int, samples: int) -> Any:
    """Make Mitsuba's camera that looks from ``eye`` at the origin."""
    import mitsuba as mi

    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgba"}
    place = mi.ScalarTransform4f().look_at(eye, [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    sampler = {"type": "multijitter", "sample_count": samples}  # half the noise of independent samples
    return mi.load_dict({"type": "perspective", "fov": 2 * _ANGLE, "to_world": place, "film": film, "sampler": sampler})


def scene_mesh(vertices: Tensor, faces: Tensor, colors: Tensor, path: Path, roughness: float) -> dict[str, Any]:
    """Make Mitsuba's dictionary of a mesh with colours of vertices, linear RGB [V, 3]."""
    import mitsuba as mi

    mesh = mi.Mesh("object", len(vertices), len(faces))
    mesh.add_attribute("vertex_color", 3, colors.flatten().numpy())
    parts = mi.traverse(mesh)
    parts["vertex_positions"], parts["faces"] = vertices.flatten().numpy(), faces.flatten().int().numpy()
    parts.update()
    mesh.write_ply(str(path))
    color = {"type": "mesh_attribute", "name": "vertex_color"}
    surface: dict[str, Any] = {"type": "diffuse", "reflectance": color}
    if roughness:
        surface = {"type": "principled", "base_color": color, "roughness": roughness, "specular": 0.5}
    return {
        "object": {
            "type": "ply",
            "filename": str(path),
            "face_normals": True,
            "bsdf": {"type": "twosided", "bsdf": surface},
        }
    }


def surroundings(ground: float) -> dict[str, Any]:
    """Make Mitsuba's dictionary of the floor and the light."""
    import mitsuba as mi

    place = mi.ScalarTransform4f()
    high, wide = torch.meshgrid(torch.linspace(1, -1, 64), torch.linspace(-1, 1, 128), indexing="ij")
    sky = 0.35 + 0.25 * high[..., None] * torch.tensor([0.6, 0.8, 1.0])
    for column, row, strength in ((-0.5, 0.45, 9.0), (0.35, 0.6, 5.0)):  # two windows
        inside = ((wide - column).abs() < 0.09) & ((high - row).abs() < 0.2)
        sky = torch.where(inside[..., None], strength * torch.tensor([1.0, 0.95, 0.85]), sky)
    points = torch.cartesian_prod(torch.linspace(-1, 1, 256), torch.linspace(-1, 1, 256))
    checks = pattern(torch.cat((12 * points, torch.zeros(len(points), 1)), 1), 0.6).view(256, 256, 3)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(checks.numpy()), "raw": True}
    floor = place.translate([0, ground, 0]).rotate([1, 0, 0], -90).scale(12)
    return {
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(sky.numpy())},
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": {"type": "diffuse", "reflectance": texture}},
    }


def pattern(points: Tensor, contrast: float) -> Tensor:
    """Compute colours [P, 3] in [0, 1] of points [P, 3]: waves in random directions, finer ones weaker."""
    random = torch.Generator().manual_seed(1)
    lengths = 2 ** (1.5 + 4 * torch.rand(96, 1, generator=random))  # radians per unit
    waves = lengths * functional.normalize(torch.randn(96, 3, generator=random), dim=1)
    phases = 2 * math.pi * torch.rand(96, generator=random)
    sizes = (torch.randn(96, 1, generator=random) + 0.5 * torch.randn(96, 3, generator=random)) * lengths**-0.5
    values = torch.cos(points @ waves.t() + phases) @ sizes
    return (0.45 + contrast * 0.35 * torch.tanh(2 * values / values.std())).clamp(0.02, 0.95)


def own_colors(mesh: nr.UVMesh) -> Tensor:
    """Look up the texture of a mesh at its vertices, [V, 3] linear RGB."""
    places = mesh.vertices.new_zeros(len(mesh.vertices), 2)
    places[mesh.faces.flatten().long()] = mesh.uv.detach().flatten(0, 1)
    grid = torch.stack((2 * places[:, 0] - 1, 1 - 2 * places[:, 1]), 1)[None, None]
    image = mesh.images[0].detach().movedim(-1, 0)[None]
    return nr.srgb_to_linear(functional.grid_sample(image, grid, align_corners=False)[0, :, 0].t())


if __name__ == "__main__":
    main()
