"""`neural-renderer demo`: a turntable, a sphere fitted to a duck, and a mesh from one picture."""

from __future__ import annotations

import time

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from torch import Tensor

from ...camera import Camera, get_points_from_angles
from ...io import save_image
from ...io.obj.writer import check_own
from ...meshes.mesh import Mesh
from ...meshes.primitives import icosphere
from ..common.command import choose_device, say
from ..common.pictures.animation import save_animation
from ..common.pictures.clay import clay_mesh
from ..common.pictures.photograph import FIRST_AZIMUTH, lowest_point, photograph, turntable
from ..common.pictures.sheet import sheet
from ..fit import DescentSettings, ShapeFit, TextureFit, Views
from ..reconstruct.evaluation.picture import STEPS, reconstruct
from ..reconstruct.shapes.shapes import Shapes
from .models import duck, knot
from .options import DemoOptions

_AZIMUTHS = (FIRST_AZIMUTH, 90.0, 180.0, 250.0, 20.0)  # columns of the sheet, in degrees
_ELEVATIONS, _DISTANCE, _VIEWING_ANGLE = (-25.0, 10.0, 40.0), 3.2, 25.0  # cameras of the fit
_STAGES = 24  # stages of the fit in the animation
_RATE, _SMOOTH = 0.02, 1.0  # settings of the shape fit
# An unseen shape made without booleans, for which a plain installation has no library, and its azimuth.
_GENERATED, _SIDE = 1, 215.0
_TEXTURE_SIZE, _TEXTURE_STEPS, _BATCH = 8, 20, 8
_RESULTS = {
    "knot.png": "a lit, textured mesh",
    "turntable.gif": "the same from all sides (.mp4 too)",
    "fit.png": "from a sphere to a duck",
    "fit.gif": "the fit as an animation, next to the target",
    "fitted.obj": "the result, with material and texture",
    "picture.png": "one picture, and its reconstruction by a network, from three sides",
}


def run(options: DemoOptions) -> int:
    """Make all pictures; return the exit code."""
    start = time.perf_counter()
    check_own(options.output / "fitted.obj", None, "-o names another folder")
    device = choose_device(options.device)
    torch.manual_seed(options.seed)
    say(f"Draws a knot, then fits a sphere to silhouettes of a duck; pictures go to {options.output}.")
    say("The first picture takes longest: kernels are compiled once for this machine.")
    mesh = knot().to(device)
    first = options.output / "knot.png"
    save_image(first, photograph(mesh, FIRST_AZIMUTH, size=options.size))
    say(f"{first} after {time.perf_counter() - start:.0f} s")
    label, note = TextColumn("{task.description:<28}"), TextColumn("{task.fields[note]}")
    columns = (label, BarColumn(), note, TimeElapsedColumn())
    with Progress(*columns, console=Console()) as progress:
        _make_turntable(options, mesh, progress)
        iou = _fit_sphere(options, duck().to(device), progress)
        _reconstruct(options, progress)
    seconds = time.perf_counter() - start
    numbers = f"[bold]{iou.mean():.3f}[/bold] (least {iou.min():.3f}); {seconds:.0f} s in total."
    say(f"Silhouette IoU over {options.views} views: {numbers}", markup=True)
    say("Results:")
    for name, description in _RESULTS.items():
        say(f"  {options.output / name}  {description}")
    return 0


def _make_turntable(options: DemoOptions, mesh: Mesh, progress: Progress) -> None:
    task = progress.add_task("Turntable", total=options.frames, note="")
    pictures = []
    for picture in turntable(mesh, options.frames, 180, size=options.size):
        pictures.append(picture)
        progress.update(task, advance=1, note=f"{len(pictures)} of {options.frames} pictures")
    save_animation(options.output / "turntable.gif", pictures, fps=20)
    save_animation(options.output / "turntable.mp4", pictures, fps=20)


def _fit_sphere(options: DemoOptions, target: Mesh, progress: Progress) -> Tensor:
    """Fit a sphere to silhouettes of the target, then its texture; write results and return the IoU of each view."""
    cameras = make_cameras(options.views, target.vertices.device)
    views = Views.of(target, cameras, options.view_size)
    fit = sphere_fit(views, options.steps, options.seed)
    vertices, faces = fit.shape[:2]
    history = [vertices]
    task = progress.add_task("Sphere to duck: shape", total=fit.steps, note="")
    while not fit.done:
        row = fit.advance()
        if fit.step % max(options.steps // _STAGES, 1) == 0:
            history.append(fit.shape[0].detach())
        progress.update(task, advance=1, note=f"loss {row['loss']:.3f}  IoU {row['iou']:.3f}")
    iou = views.quality(fit.shape)["iou"]
    progress.update(task, note=f"IoU {iou.mean():.3f}")

    photos = Views.of(target, cameras, 2 * options.view_size)
    steps = min(_TEXTURE_STEPS, options.steps)
    texture = TextureFit(photos, fit.shape[0], faces, size=_TEXTURE_SIZE, steps=steps, batch=_BATCH)
    task = progress.add_task("Sphere to duck: colours", total=texture.steps, note="")
    while not texture.done:
        progress.update(task, advance=1, note=f"loss {texture.advance()['loss']:.4f}")
    fitted = Mesh(*texture.shape)
    fitted.save(options.output / "fitted.obj")
    _draw_stages(options, [clay_mesh(v, faces) for v in history], fitted, target, progress)
    return iou


def _draw_stages(options: DemoOptions, history: list[Mesh], fitted: Mesh, target: Mesh, progress: Progress) -> None:
    """Write fit.png, a table of stages by azimuths, and fit.gif, which shows each stage next to the target."""
    stages = label_stages(history, fitted, target)
    still = [fitted] * max(len(history) // 3, 1)
    task = progress.add_task("Pictures", total=len(stages) * len(_AZIMUTHS) + len(history) + len(still), note="")
    floor = lowest_point(target)

    def picture(mesh: Mesh, azimuth: float, size: int) -> Tensor:
        return photograph(mesh, azimuth, size=size, floor=floor)

    rows = []
    for mesh in stages.values():
        rows.append([picture(mesh, azimuth, options.size * 3 // 4) for azimuth in _AZIMUTHS])
        progress.update(task, advance=len(_AZIMUTHS))
    save_image(options.output / "fit.png", sheet(rows, list(stages)))
    frames = []
    for index, mesh in enumerate(history + still):
        azimuth = FIRST_AZIMUTH + 360 * index / len(history + still)
        frames.append(sheet([[picture(m, azimuth, options.size * 5 // 8) for m in (mesh, target)]]))
        progress.update(task, advance=1)
    save_animation(options.output / "fit.gif", frames, fps=12)


def _reconstruct(options: DemoOptions, progress: Progress) -> None:
    """Write picture.png: a generated object, and the mesh that `reconstruct` makes of one picture of it."""
    task = progress.add_task("One picture to a mesh", total=(steps := min(STEPS, options.steps)), note="")
    shape = Shapes(seed=2024)(_GENERATED)
    mesh = Mesh(2 * shape.vertices, shape.faces, face_colors=shape.colors)
    given = photograph(
        mesh, _SIDE, 20, options.size, floor=-100.0
    )  # without a shadow, which would be part of the object
    found = reconstruct(given.permute(1, 2, 0), steps=steps, observe=lambda *_: progress.advance(task))
    progress.update(task, note=found.category)
    mesh = found.mesh.normalize()
    views = [photograph(mesh, _SIDE + turn, 20, options.size) for turn in (0, 90, 180)]
    save_image(options.output / "picture.png", sheet([[given, *views]]))


def make_cameras(count: int, device: torch.device) -> Camera:
    """Make cameras with evenly spaced azimuths and three alternating elevations."""
    index = torch.arange(count)
    elevation = torch.tensor(_ELEVATIONS)[index % len(_ELEVATIONS)]
    eye = get_points_from_angles(_DISTANCE, elevation, 360 / count * index).to(device)
    return Camera.look_at(eye, viewing_angle=_VIEWING_ANGLE)


def sphere_fit(views: Views, steps: int, seed: int = 0) -> ShapeFit:
    """Make the fit of a sphere with 1280 faces to silhouettes."""
    vertices, faces = (part.to(views.masks.device) for part in icosphere(3, radius=0.5))
    descent = DescentSettings(_BATCH, seed=seed)
    return ShapeFit(views, vertices, faces, steps=steps, rate=_RATE, smooth=_SMOOTH, descent=descent)


def label_stages(history: list[Mesh], fitted: Mesh, target: Mesh) -> dict[str, Mesh]:
    """Select the rows of the sheet: label → mesh."""
    return {
        "start": history[0],
        "at first": history[len(history) // 8],
        "half-way": history[len(history) // 3],
        "shape": clay_mesh(fitted.vertices, fitted.faces),
        "shape and colours": fitted,
        "target": target,
    }
