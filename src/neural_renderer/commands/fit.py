"""`neural-renderer fit`: a textured mesh from images with known cameras, a texture for a mesh, or an image's camera."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console
from torch import Tensor

from ..io import save_image
from ..meshes.mesh import Mesh
from ..pictures.curve import curve
from ..tasks.fit import CameraFit, MeshFit, Views, Weights, load_photo, load_views
from ..tasks.fit.fit_pictures import comparison, turntable
from ..version import __version__
from .common import checked_count, chosen_device, output_folder
from .task_runner import Run, fingerprint

# What may change when a fit goes on; of the images only what is in them counts.
_FREE = ("images", "output", "steps", "texture_steps", "turntable", "resume", "device")


@dataclass(frozen=True)
class Fit:
    """Recover a textured mesh from images with known cameras; or for a known mesh its texture, or an image's camera.

    IMAGES is a folder with a transforms.json (NeRF), a cameras.json or a cameras.csv (file, azimuth, elevation,
    distance), or that file itself. For --recover camera it is one image.

    Example: neural-renderer fit photos -o out

    Example: neural-renderer fit photos -o out --recover texture --mesh bunny.obj

    Example: neural-renderer fit photo.png -o out --recover camera --mesh bunny.obj

    Ctrl-C ends the fit and writes what there is; --resume goes on.
    """

    images: tyro.conf.Positional[Path]
    """Folder of the images, or the file of their cameras; one image for --recover camera."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the results; it is made if missing."""
    recover: Literal["shape", "texture", "camera"] = "shape"
    """What to find: the shape (and then its texture, if there are photos), the texture alone, or the camera."""
    mesh: Path | None = None
    """Mesh to begin with, or whose texture or camera is looked for; in the world of the cameras."""
    start: Literal["hull", "sphere"] = "hull"
    """Without a mesh, begin with the visual hull of the silhouettes, holes and handles included, or with a sphere."""
    cells: int = 64
    """Cells along each side of the grid that the hull is carved from (at least 8): more for thin parts."""
    photos: bool = True
    """Use the colours of the images; without them they are silhouettes."""
    background: tuple[float, float, float] | None = None
    """Red, green and blue (0 to 1) of what is behind the object, for images without transparency or masks."""
    size: int = 256
    """Images are scaled down to at most this many pixels on their longer side (at least 16)."""
    held_out: int = 0
    """Keep every n-th view for the report instead of fitting it (0: none, else at least 2)."""
    steps: int = 150
    """Steps of descent for the shape or the camera (at least 1)."""
    texture_steps: int = 20
    """Steps of conjugate gradients for the texture (at least 1)."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3)."""
    batch: int = 6
    """Views that each step looks at (at least 1)."""
    starts: int = 16
    """Cameras to begin with, side by side, for --recover camera (at least 1)."""
    viewing_angle: float = 30.0
    """Half of the vertical field of view in degrees, for --recover camera (above 0, below 90)."""
    gradient: Literal["edge", "nmr"] = "edge"
    """The renderer's gradient through visibility."""
    color_from: float = 1.0
    """The part of the steps (0 to 1) after which colours move the shape too: 0.3 finds some hollows that silhouettes do
    not show, in twice the time."""
    weights: Weights = field(default_factory=Weights)
    """How much each loss counts."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
    """Seed of the order in which the views are used, and of the cameras to begin with."""
    resume: bool = False
    """Go on from the checkpoint in the output folder, if there is one. It must be of the same images and options, but
    for the numbers of steps."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""

    def run(self) -> int:
        """Fit; returns the exit code: 0, or 130 after Ctrl-C. Raises ValueError, TypeError or OSError."""
        limits = {"cells": 8, "size": 16, "steps": 1, "texture_steps": 1, "texture_size": 3, "batch": 1, "starts": 1}
        for name, least in {**limits, "turntable": 0, "seed": 0}.items():
            checked_count(name, getattr(self, name), least)
        if self.recover != "shape" and self.mesh is None:
            raise ValueError(f"--mesh: expected the mesh whose {self.recover} is looked for, got none")
        return self._camera() if self.recover == "camera" else self._mesh()

    def _mesh(self) -> int:
        device = chosen_device(self.device)
        views = load_views(self.images, size=self.size, photos=self.photos, background=self.background).to(device)
        seen, unseen = self._split(views)
        fit = MeshFit(
            seen,
            self.start if self.mesh is None else Mesh.load(self.mesh, texture_size=2),
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
        mesh.save(self.output / "mesh.obj")
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
        mesh = Mesh.load(self.mesh, texture_size=self.texture_size).to(device)  # type: ignore[arg-type]
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
        (self.output / "report.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
        if run.history:
            curve(run.history, "loss", "iou").save(self.output / "loss.png")
        console = Console()
        for name in ("fitted", "held_out"):
            if name in found:
                numbers = ", ".join(f"{key} {value['mean']:.4f}" for key, value in found[name].items())
                console.print(f"{name.replace('_', '-')} views: [bold]{numbers}[/bold]", highlight=False)
        ending = "" if finished else f", interrupted after {len(run.history)} steps (--resume goes on)"
        text = f"{report['seconds']} s{ending}; the results are in {self.output}"
        console.print(text, highlight=False, soft_wrap=True)
        return 0 if finished else 130
