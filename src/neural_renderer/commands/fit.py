"""`neural-renderer fit`: a textured mesh from images with known cameras, a texture for a mesh, or an image's camera."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal

import torch
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from torch import Tensor

from .. import __version__
from ..io import save_image
from ..mesh import Mesh
from ..primitives import icosphere
from ..tasks.fit import ShapeFit, TextureFit, Views, Weights, carve, frame, load_views
from ..tasks.fit.results import coloured, comparison, curve, preview, turntable
from .common import checked_count, chosen_device

_CHECKPOINT = "checkpoint.pt"


@dataclass(frozen=True)
class Fit:
    """Recover a textured mesh from images with known cameras; or, for a known mesh, its texture.

    IMAGES is a folder with a transforms.json (NeRF), a cameras.json or a cameras.csv (file, azimuth, elevation,
    distance), or that file itself.

    Example: neural-renderer fit photos -o out

    Example: neural-renderer fit photos -o out --recover texture --mesh bunny.obj

    Ctrl-C ends the fit and writes what there is; --resume goes on.
    """

    images: tyro.conf.Positional[Path]
    """Folder of the images, or the file of their cameras."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the results; it is made if missing."""
    recover: Literal["shape", "texture"] = "shape"
    """What to find: the shape (and its texture, if there are photos), or the texture alone."""
    mesh: Path | None = None
    """Mesh to begin with, or whose texture is looked for, in the world of the cameras."""
    start: Literal["hull", "sphere"] = "hull"
    """Without a mesh, begin with the visual hull of the silhouettes, holes and handles included, or with a sphere."""
    cells: int = 64
    """Cells along each side of the grid that the hull is carved from (at least 8): more for thin parts."""
    photos: bool = True
    """Use the colours of the images; without them they are silhouettes."""
    background: tuple[float, float, float] | None = None
    """Red, green and blue (0 to 1) of what is behind the object, for images without transparency or masks."""
    size: int = 256
    """Longer images are scaled down to this many pixels on their longer side (at least 16)."""
    held_out: int = 0
    """Keep every n-th view for the report instead of fitting it (0: none, else at least 2)."""
    steps: int = 150
    """Steps of descent for the shape (at least 1)."""
    texture_steps: int = 150
    """Steps of descent for the texture (at least 3)."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 2)."""
    batch: int = 6
    """Views that each step looks at (at least 1)."""
    gradient: str = "nmr"
    """The renderer's gradient through visibility."""
    weights: Weights = field(default_factory=Weights)
    """How much each loss counts."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
    """Seed of the order in which the views are used."""
    resume: bool = False
    """Go on from the checkpoint in the output folder, if there is one."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""

    def run(self) -> int:
        """Fit; returns the exit code: 0, or 130 after Ctrl-C. Raises ValueError, TypeError or OSError."""
        limits = {"cells": 8, "steps": 1, "texture_steps": 3, "texture_size": 2, "batch": 1, "turntable": 0, "seed": 0}
        for name, least in limits.items():
            checked_count(name, getattr(self, name), least)
        device = chosen_device(self.device)
        if self.recover == "texture" and self.mesh is None:
            raise ValueError("--mesh: expected the mesh whose texture is looked for, got none")
        console = Console()
        views = load_views(self.images, size=self.size, photos=self.photos, background=self.background).to(device)
        if self.recover == "texture" and views.photos is None:
            raise ValueError("--photos: expected photos to take a texture from, got --no-photos")
        seen, unseen = self._split(views)
        job = _Job(self, seen)
        self.output.mkdir(parents=True, exist_ok=True)
        columns = (
            TextColumn("{task.description:<10}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
        )
        with Progress(*columns, console=console) as progress, _interruption() as interrupted:
            if self.resume and (self.output / _CHECKPOINT).is_file():
                job.restore(torch.load(self.output / _CHECKPOINT, weights_only=True, map_location=device))
            job.work(progress, interrupted)
        job.checkpoint()
        self._write(job, seen, unseen, console)
        if interrupted:
            console.print(f"Interrupted after {len(job.history)} steps; --resume goes on.")
        return 130 if interrupted else 0

    def _split(self, views: Views) -> tuple[Views, Views | None]:
        if not self.held_out:
            return views, None
        rows = list(range(checked_count("held_out", self.held_out, 2) - 1, len(views), self.held_out))
        if not rows:
            raise ValueError(f"--held-out: expected at most the {len(views)} views there are, got {self.held_out}")
        return views[[i for i in range(len(views)) if i not in rows]], views[rows]

    def _write(self, job: _Job, seen: Views, unseen: Views | None, console: Console) -> None:
        """The results, in the world of the cameras."""
        shape = job.shape
        local, mesh = seen.moved(job.centre, job.scale), job.mesh()
        mesh.save(self.output / "mesh.obj")
        mesh.save(self.output / "mesh.glb")
        save_image(self.output / "comparison.png", comparison(local, shape))
        if job.history:
            curve(job.history).save(self.output / "loss.png")
        report: dict[str, Any] = {"version": __version__, "recover": self.recover, "gradient": self.gradient}
        report |= {"views": len(seen), "size": list(seen.size), "steps": len(job.history)}
        report |= {"seconds": round(job.seconds, 1), "vertices": mesh.num_vertices, "faces": mesh.num_faces}
        for name, part in (("fitted", local), ("held_out", unseen and unseen.moved(job.centre, job.scale))):
            if part is not None:
                quality = part.quality(shape)
                report[name] = {
                    k: {"mean": round(v.mean().item(), 4), "least": round(v.min().item(), 4)}
                    for k, v in quality.items()
                }
        report["history"] = job.history
        (self.output / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        if self.turntable:
            turntable(self.output / "turntable.gif", seen, mesh, self.turntable)
        for name in ("fitted", "held_out"):
            if name in report:
                numbers = ", ".join(f"{key} {value['mean']:.4f}" for key, value in report[name].items())
                console.print(f"{name.replace('_', ' ')} views: [bold]{numbers}[/bold]", highlight=False)
        console.print(f"{report['seconds']} s; the results are in {self.output}", highlight=False, soft_wrap=True)


class _Job:
    """The phases of a fit, one after the other, and what has to be kept to go on another day."""

    def __init__(self, options: Fit, views: Views) -> None:
        self._options, self._world = options, views
        self.centre, self.scale = frame(views)
        self._views = views.moved(self.centre, self.scale)
        self.history: list[dict[str, Any]] = []
        self.seconds = 0.0
        self._phase = "texture" if options.recover == "texture" else "shape"
        self._fit: ShapeFit | TextureFit | None = None

    @property
    def shape(self) -> tuple[Tensor, ...]:
        """The mesh as it is now, in the frame of the fit."""
        return tuple(part.detach() for part in self._started().shape)

    def mesh(self) -> Mesh:
        """The mesh as it is now, in the world of the cameras."""
        vertices, faces, textures = coloured(self.shape)
        return Mesh(vertices * self.scale + self.centre, faces, textures)

    def work(self, progress: Progress, interrupted: list[int]) -> None:
        """All steps that are left, unless ``interrupted`` fills; preview and checkpoint from time to time."""
        begun, shown = time.monotonic() - self.seconds, 0.0
        while True:
            fit = self._started()
            task = progress.add_task(self._phase, total=fit.steps, completed=fit.step, note="")
            while not fit.done and not interrupted:
                row = fit.advance()
                self.history.append({"phase": self._phase, **{k: round(v, 6) for k, v in row.items()}})
                note = "  ".join(f"{name} {value:.4f}" for name, value in row.items())
                progress.update(task, completed=fit.step, note=note)
                self.seconds = time.monotonic() - begun
                if self.seconds - shown > 4:
                    preview(self._options.output / "preview.png", self._views, self.shape)
                    self.checkpoint()
                    shown = self.seconds
            if interrupted or not isinstance(fit, ShapeFit) or self._views.photos is None:
                break
            vertices, faces, *_ = fit.shape
            self._phase, self._fit = "texture", self._texture(vertices, faces, fit.colours)
        preview(self._options.output / "preview.png", self._views, self.shape)

    def checkpoint(self) -> None:
        """Save all that `restore` needs; the file is whole at any time."""
        state: dict[str, Any] = {"phase": self._phase, "fit": self._started().state_dict(), "history": self.history}
        state |= {"seconds": self.seconds, "views": list(self._world.masks.shape)}
        fresh = self._options.output / (_CHECKPOINT + ".new")
        torch.save(state, fresh)
        fresh.replace(self._options.output / _CHECKPOINT)

    def restore(self, state: dict[str, Any]) -> None:
        """Continue where a checkpoint was taken."""
        if state["views"] != list(self._world.masks.shape):
            raise ValueError(
                f"--resume: expected the {state['views']} images of the checkpoint, got {list(self._world.masks.shape)}"
            )
        self._phase, self.history, self.seconds = state["phase"], state["history"], state["seconds"]
        fit = state["fit"]
        if self._phase == "shape":
            self._fit = self._sculpture(fit["vertices"], fit["faces"])
        else:
            self._fit = self._texture(fit["vertices"], fit["faces"])
        self._fit.load_state_dict(fit)

    def _started(self) -> ShapeFit | TextureFit:
        if self._fit is None:
            vertices, faces = self._start()
            self._fit = self._sculpture(vertices, faces) if self._phase == "shape" else self._texture(vertices, faces)
        return self._fit

    def _start(self) -> tuple[Tensor, Tensor]:
        options, device = self._options, self._views.masks.device
        if options.mesh is not None:
            mesh = Mesh.load(options.mesh, texture_size=2).to(device)
            return (mesh.vertices.detach() - self.centre) / self.scale, mesh.faces
        if options.start == "hull":
            return carve(self._views, options.cells)
        vertices, faces = icosphere(3, 0.6)
        return vertices.to(device), faces.to(device)

    def _sculpture(self, vertices: Tensor, faces: Tensor) -> ShapeFit:
        options = self._options
        coarse = options.mesh is None and options.start == "sphere"
        return ShapeFit(
            self._views,
            vertices,
            faces,
            steps=options.steps,
            subdivisions=2 if coarse else 0,
            weights=options.weights,
            batch=options.batch,
            gradient=options.gradient,
            seed=options.seed,
        )

    def _texture(self, vertices: Tensor, faces: Tensor, colours: Tensor | None = None) -> TextureFit:
        options = self._options
        return TextureFit(
            self._views,
            vertices,
            faces,
            colours=colours,
            size=options.texture_size,
            steps=options.texture_steps,
            batch=options.batch,
            seed=options.seed,
        )


@contextmanager
def _interruption() -> Iterator[list[int]]:
    """A list that the first Ctrl-C puts a signal into; the second one interrupts as ever."""
    found: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        found.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield found
    finally:
        signal.signal(signal.SIGINT, before)
