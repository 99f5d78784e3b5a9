"""`neural-renderer demo`: what the package does, in pictures, in less than a minute."""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from torch import Tensor

from ..camera import Camera, get_points_from_angles
from ..io import save_animation, save_image
from ..io.obj_writer import check_own
from ..meshes.mesh import Mesh
from ..meshes.primitives import icosphere
from ..pictures.clay import clay_mesh
from ..pictures.photograph import lowest_point, photograph
from ..pictures.sheet import sheet
from ..tasks.fit import ShapeFit, TextureFit, Views
from .common import checked_count, chosen_device
from .demo_models import duck, knot
from .options.demo import DemoOptions

_ANGLES = (145.0, 90.0, 180.0, 250.0, 20.0)


@dataclass(frozen=True)
class Demo(DemoOptions):
    """Makes the pictures."""

    def run(self) -> int:
        """Make everything; returns the exit code 0."""
        start = time.perf_counter()
        limits = {"frames": 1, "size": 32, "iterations": 1, "views": 1, "view_size": 16}
        for name, least in limits.items():
            checked_count(name, getattr(self, name), least)
        check_own(self.output / "fitted.obj", None, "-o names another folder")
        device = chosen_device(self.device)
        console = Console()
        torch.manual_seed(self.seed)
        label, note = TextColumn("{task.description:<28}"), TextColumn("{task.fields[note]}")
        columns = (label, BarColumn(), note, TimeElapsedColumn())
        with Progress(*columns, console=console) as progress:
            self._turntable(knot().to(device), progress)
            iou = self._fit(duck().to(device), progress)
        console.print(
            f"Silhouette IoU over {self.views} views: [bold]{iou.mean():.3f}[/bold] (least {iou.min():.3f}); "
            f"{time.perf_counter() - start:.0f} s in all."
        )
        console.print("Now look at:")
        for name, what in (
            ("turntable.gif", "a lit, textured mesh (.mp4 too)"),
            ("fit.png", "from a sphere to a duck"),
            ("fit.gif", "the same as it happens, beside the target"),
            ("fitted.obj", "the result, with its material and texture"),
        ):
            console.print(f"  {self.output / name}  [dim]{what}[/dim]", highlight=False, soft_wrap=True)
        return 0

    def _turntable(self, mesh: Mesh, progress: Progress) -> None:
        task = progress.add_task("Turntable", total=self.frames, note="compiling kernels at the first run")
        pictures = []
        for index in range(self.frames):
            pictures.append(photograph(mesh, 180 + 360 * index / self.frames, size=self.size).cpu())
            progress.update(task, advance=1, note=f"{index + 1} of {self.frames} pictures")
        save_animation(self.output / "turntable.gif", pictures, fps=20)
        save_animation(self.output / "turntable.mp4", pictures, fps=20)

    def _fit(self, target: Mesh, progress: Progress) -> Tensor:
        cameras = around(self.views, target.vertices.device)
        views = Views.of(target, cameras, self.view_size)
        fit = ball(views, self.iterations, self.seed)
        vertices, faces = fit.shape[:2]
        history = [vertices]
        task = progress.add_task("Sphere to duck: shape", total=fit.steps, note="")
        while not fit.done:
            row = fit.advance()
            if fit.step % max(self.iterations // 24, 1) == 0:
                history.append(fit.shape[0].detach())
            progress.update(task, advance=1, note=f"loss {row['loss']:.3f}  IoU {row['iou']:.3f}")
        iou = views.quality(fit.shape)["iou"]
        progress.update(task, note=f"IoU {iou.mean():.3f}")

        photos = Views.of(target, cameras, 2 * self.view_size)
        paint = TextureFit(photos, fit.shape[0], faces, size=8, steps=min(20, self.iterations), batch=8)
        task = progress.add_task("Sphere to duck: colours", total=paint.steps, note="")
        while not paint.done:
            progress.update(task, advance=1, note=f"loss {paint.advance()['loss']:.4f}")
        fitted = Mesh(*paint.shape)
        fitted.save(self.output / "fitted.obj")
        self._draw([clay_mesh(v, faces) for v in history], fitted, target, progress)
        return iou

    def _draw(self, history: list[Mesh], fitted: Mesh, target: Mesh, progress: Progress) -> None:
        """fit.png, a sheet of stages by angles, and fit.gif, the stages beside the target."""
        stages = stages_of(history, fitted, target)
        last = [fitted] * max(len(history) // 3, 1)
        task = progress.add_task("Pictures", total=len(stages) * len(_ANGLES) + len(history) + len(last), note="")
        floor = lowest_point(target)

        def picture(mesh: Mesh, angle: float, size: int) -> Tensor:
            return photograph(mesh, angle, size=size, floor=floor)

        rows = []
        for mesh in stages.values():
            rows.append([picture(mesh, angle, self.size * 3 // 4) for angle in _ANGLES])
            progress.update(task, advance=len(_ANGLES))
        save_image(self.output / "fit.png", sheet(rows, list(stages)))
        frames = []
        for index, mesh in enumerate(history + last):
            angle = 145 + 360 * index / len(history + last)
            frames.append(sheet([[picture(m, angle, self.size * 5 // 8) for m in (mesh, target)]]))
            progress.update(task, advance=1)
        save_animation(self.output / "fit.gif", frames, fps=12)


def around(count: int, device: torch.device) -> Camera:
    """Cameras whose azimuths go round evenly and whose elevations take turns at three heights."""
    index = torch.arange(count)
    elevation = torch.tensor([-25.0, 10.0, 40.0])[index % 3]
    eye = get_points_from_angles(3.2, elevation, 360 / count * index).to(device)
    return Camera.look_at(eye, viewing_angle=25.0)


def ball(views: Views, steps: int, seed: int = 0) -> ShapeFit:
    """The fit of a sphere of 1280 faces to silhouettes."""
    vertices, faces = (part.to(views.masks.device) for part in icosphere(3, radius=0.5))
    return ShapeFit(views, vertices, faces, steps=steps, batch=8, rate=0.02, smooth=1.0, seed=seed)


def stages_of(history: list[Mesh], fitted: Mesh, target: Mesh) -> dict[str, Mesh]:
    """The rows of the sheet: label and mesh."""
    early, late = history[len(history) // 8], history[len(history) // 3]
    plain = clay_mesh(fitted.vertices, fitted.faces)
    return {
        "start": history[0],
        "at first": early,
        "half-way": late,
        "shape": plain,
        "shape and colours": fitted,
        "target": target,
    }
