"""`neural-renderer demo`: what the package does, in pictures, in less than a minute."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import torch
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from torch import Tensor

from ..io import save_animation, save_image
from ..mesh import Mesh
from . import sculpt
from .common import checked_count, chosen_device
from .shapes import duck, knot
from .studio import lowest, photograph, sheet

_ANGLES = (145.0, 90.0, 180.0, 250.0, 20.0)


@dataclass(frozen=True)
class Demo:
    """Render a textured knot as a turntable, and sculpt a sphere into a duck from 24 silhouettes. No downloads.

    Example: neural-renderer demo -o out
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """Folder for the files; it is made if missing."""
    frames: int = 48
    """Pictures of the turntable, at least 1."""
    size: int = 320
    """Side of the pictures in pixels, at least 32."""
    iterations: int = 300
    """Steps of gradient descent for the shape, at least 1."""
    views: int = 24
    """Silhouettes that the sphere is fitted to, at least 1."""
    view_size: int = 96
    """Side of these silhouettes in pixels, at least 16."""
    seed: int = 0
    """Seed of the order in which the views are used."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""

    def run(self) -> int:
        """Make everything; returns the exit code 0."""
        start = time.perf_counter()
        limits = {"frames": 1, "size": 32, "iterations": 1, "views": 1, "view_size": 16}
        for name, least in limits.items():
            checked_count(name, getattr(self, name), least)
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
        views = sculpt.Views.of(target, self.views, self.view_size)
        every = max(self.iterations // 24, 1)
        history: list[Tensor] = []
        task = progress.add_task("Sphere to duck: shape", total=self.iterations, note="")
        note = ""

        def on_shape(step: int, loss: float, vertices: Tensor) -> None:
            nonlocal note
            if step % every == every - 1:
                history.append(vertices)
                note = f"IoU {views.iou(vertices, faces).mean():.3f}"
            progress.update(task, advance=1, note=f"loss {loss:.3f}  {note}")

        vertices, faces = sculpt.sphere(target.vertices.device)
        history.append(vertices)
        vertices = sculpt.sculpt(views, vertices, faces, self.iterations, on_shape)
        iou = views.iou(vertices, faces)
        progress.update(task, note=f"IoU {iou.mean():.3f}")

        steps = max(self.iterations // 4, 1)
        colours = progress.add_task("Sphere to duck: colours", total=steps, note="")

        def on_colour(step: int, loss: float, textures: Tensor) -> None:
            progress.update(colours, advance=1, note=f"loss {loss:.4f}")

        fitted = sculpt.paint(views, vertices, faces, steps, on_colour)
        fitted.save(self.output / "fitted.obj")
        self._draw([clay(v, faces) for v in history], fitted, target, progress)
        return iou

    def _draw(self, history: list[Mesh], fitted: Mesh, target: Mesh, progress: Progress) -> None:
        """fit.png, a sheet of stages by angles, and fit.gif, the stages beside the target."""
        stages = stages_of(history, fitted, target)
        last = [fitted] * max(len(history) // 3, 1)
        task = progress.add_task("Pictures", total=len(stages) * len(_ANGLES) + len(history) + len(last), note="")
        floor = lowest(target)

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


def stages_of(history: list[Mesh], fitted: Mesh, target: Mesh) -> dict[str, Mesh]:
    """The rows of the sheet: label and mesh."""
    early, late = history[len(history) // 8], history[len(history) // 3]
    plain = clay(fitted.vertices, fitted.faces)
    return {
        "start": history[0],
        "at first": early,
        "half-way": late,
        "shape": plain,
        "shape and colours": fitted,
        "target": target,
    }


def clay(vertices: Tensor, faces: Tensor) -> Mesh:
    """A shape without colours."""
    colour = torch.tensor([0.55, 0.68, 0.84], device=vertices.device)
    return Mesh(vertices, faces, colour.expand(len(faces), 2, 2, 2, 3))
