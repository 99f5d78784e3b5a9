"""`neural-renderer fit`: a textured mesh from images with known cameras, a texture for a mesh, or an image's camera."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import Any

from rich.console import Console
from torch import Tensor

from ..io import save_image
from ..io.atomic_write import write_file
from ..io.obj_writer import check_own
from ..meshes.mesh import Mesh
from ..pictures.curve import curve
from ..tasks.fit import CameraFit, MeshFit, Views, load_photo, load_views
from ..tasks.fit.fit_pictures import comparison, turntable
from ..tasks.fit.load import camera_file
from ..version import __version__
from .common import check_outputs, checked_count, chosen_device, output_folder
from .options.fit import FitOptions
from .task_runner import Run, fingerprint

# What may change when a fit goes on; of the images only what is in them counts.
_FREE = ("images", "output", "steps", "texture_steps", "turntable", "allow_outside", "resume", "force", "device")
_RESULTS = ("mesh.obj", "mesh.glb", "preview.png", "comparison.png", "loss.png", "turntable.gif", "report.json")


@dataclass(frozen=True)
class Fit(FitOptions):
    """Fits a mesh, its texture, or a camera, as the options say."""

    def run(self) -> int:
        """Fit; returns the exit code: 0, or 130 after Ctrl-C. Raises ValueError, TypeError or OSError."""
        limits = {"cells": 8, "size": 16, "steps": 1, "texture_steps": 1, "texture_size": 3, "batch": 1, "starts": 1}
        for name, least in {**limits, "turntable": 0, "seed": 0}.items():
            checked_count(name, getattr(self, name), least)
        if self.recover != "shape" and self.mesh is None:
            raise ValueError(f"--mesh: expected the mesh whose {self.recover} is looked for, got none")
        images = self.images if self.recover == "camera" else camera_file(self.images)
        check_outputs([self.output / name for name in _RESULTS], [images, self.mesh])
        return self._camera() if self.recover == "camera" else self._mesh()

    def _mesh(self) -> int:
        if not self.force:
            check_own(self.output / "mesh.obj", None, "--force replaces it")
        device = chosen_device(self.device)
        views = load_views(
            self.images,
            size=self.size,
            photos=self.photos,
            background=self.background,
            allow_outside=self.allow_outside,
        ).to(device)
        seen, unseen = self._split(views)
        fit = MeshFit(
            seen,
            self.start if self.mesh is None else Mesh.load(self.mesh, texture_size=2, allow_outside=self.allow_outside),
            recover="texture" if self.recover == "texture" else "shape",
            steps=self.steps,
            texture_steps=self.texture_steps,
            cells=self.cells,
            texture_size=self.texture_size,
            color_from=self.color_from,
            weights=self.weights,
            batch=self.batch,
            gradient=self.gradient,
            seed=self.seed,
        )
        output_folder("--output", self.output)
        camera = (getattr(seen.camera, part.name) for part in fields(seen.camera))
        run = self._run(fit, (seen.masks, seen.photos, *camera), lambda: (fit.views, fit.shape))
        finished = run.work(self.resume)
        mesh = fit.mesh()
        mesh.save(self.output / "mesh.obj", overwrite=self.force)
        mesh.save(self.output / "mesh.glb")
        save_image(self.output / "comparison.png", comparison(fit.views, fit.shape))
        found: dict[str, Any] = {"views": len(seen), "vertices": mesh.num_vertices, "faces": mesh.num_faces}
        for name, part in (("fitted", fit.views), ("held_out", unseen and fit.normalize(unseen))):
            if part is not None:
                quality = part.quality(fit.shape)
                found[name] = {
                    key: {"mean": round(value.mean().item(), 4), "least": round(value.min().item(), 4)}
                    for key, value in quality.items()
                }
        if self.turntable:
            turntable(self.output / "turntable.gif", seen, mesh, self.turntable)
        return self._report(run, found, finished)

    def _camera(self) -> int:
        device = chosen_device(self.device)
        mask, photo = load_photo(self.images, size=self.size, photos=self.photos, background=self.background)
        mesh = Mesh.load(
            self.mesh,  # type: ignore[arg-type]
            texture_size=self.texture_size,
            allow_outside=self.allow_outside,
        ).to(device)
        shape: tuple[Tensor, ...] = mesh.vertices.detach(), mesh.faces, mesh.textures.detach()
        mask, photo = mask.to(device), None if photo is None else photo.to(device)
        fit = CameraFit(
            shape,
            mask,
            photo,
            viewing_angle=self.viewing_angle,
            starts=self.starts,
            steps=self.steps,
            gradient=self.gradient,
            seed=self.seed,
        )
        output_folder("--output", self.output)

        def state() -> tuple[Views, tuple[Tensor, ...]]:
            return Views(fit.best(), mask[None], None if photo is None else photo[None]), shape

        run = self._run(fit, (mask, photo, *shape), state)
        finished = run.work(self.resume)
        views, _ = state()
        save_image(self.output / "comparison.png", comparison(views, shape))
        eye, forward = views.eyes()
        found = {
            "camera": {
                "eye": eye[0].tolist(),
                "direction": forward[0].tolist(),
                "up": views.camera.rotation[0, 1].tolist(),
                "viewing_angle": self.viewing_angle,
            },
            "fitted": {"iou": {"mean": round(views.quality(shape[:2])["iou"].item(), 4)}},
            "starts": [round(value, 4) for value in fit.losses().tolist()],
        }
        return self._report(run, found, finished)

    def _run(
        self,
        fit: MeshFit | CameraFit,
        images: tuple[Any, ...],
        state: Callable[[], tuple[Views, tuple[Tensor, ...]]],
    ) -> Run:
        inputs = {name: fingerprint(value) for name, value in asdict(self).items() if name not in _FREE}
        contents = b"".join(part.cpu().numpy().tobytes() for part in images if isinstance(part, Tensor))
        inputs["images"] = f"#{zlib.crc32(contents):08x}"
        return Run(
            self.output,
            fit,
            inputs,
            lambda path: save_image(path, comparison(*state(), columns=4)),
            device=chosen_device(self.device),
        )

    def _split(self, views: Views) -> tuple[Views, Views | None]:
        if not self.held_out:
            return views, None
        rows = list(range(checked_count("held_out", self.held_out, 2) - 1, len(views), self.held_out))
        if not rows:
            raise ValueError(f"--held-out: expected at most the {len(views)} views there are, got {self.held_out}")
        return views[[index for index in range(len(views)) if index not in rows]], views[rows]

    def _report(self, run: Run, found: dict[str, Any], finished: bool) -> int:
        report = {"version": __version__, "recover": self.recover, "gradient": self.gradient, "finished": finished}
        report |= {"seconds": round(run.seconds, 1), **found, "history": run.history}
        write_file(self.output / "report.json", json.dumps(report, indent=1) + "\n")
        if run.history:
            save_image(self.output / "loss.png", curve(run.history, "loss", "iou"))
        console = Console()
        for name in ("fitted", "held_out"):
            if name in found:
                numbers = ", ".join(f"{key} {value['mean']:.4f}" for key, value in found[name].items())
                console.print(f"{name.replace('_', '-')} views: [bold]{numbers}[/bold]", highlight=False)
        ending = "" if finished else f", interrupted after {len(run.history)} steps (--resume goes on)"
        text = f"{report['seconds']} s{ending}; the results are in {self.output}"
        console.print(text, highlight=False, soft_wrap=True)
        return 0 if finished else 130
