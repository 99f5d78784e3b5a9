"""What `neural-renderer style` and `neural-renderer dream` share: options, the run, its results."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal, TypeVar

import torch
from rich.console import Console

from .. import validate
from ..features import FeatureNetwork, load_features
from ..io import load_mesh, save_image
from ..io.atomic_write import write_file
from ..io.obj_writer import check_own
from ..meshes.mesh import Mesh
from ..meshes.uv_mesh import UVMesh
from ..pictures.curve import curve
from ..tasks.editing import DreamWeights, MeshEdit, RandomViews, StyleWeights
from ..tasks.editing.edit import Objective
from ..tasks.editing.edit_pictures import preview, six_views, turntable
from ..tasks.editing.paint import check_cubes, check_images
from ..version import __version__
from .common import check_outputs, checked_count, chosen_device
from .options.edit import EditOptions
from .task_runner import Run, fingerprint

# What may change when an edit goes on.
_FREE = ("output", "iterations", "preview", "turntable", "allow_outside", "resume", "force", "device")
_PICTURES = ("preview.png", "views.png", "loss.png", "turntable.mp4", "turntable.gif")
_RESULTS = ("mesh.obj", "mesh.glb", *_PICTURES, "report.json")
_Weights = TypeVar("_Weights", StyleWeights, DreamWeights)


@dataclass(frozen=True)
class Preset:
    """The settings that options leave open."""

    iterations: int
    vertex_rate: float
    texture_rate: float
    settle: float
    elevation: tuple[float, float]
    distance: float
    light: tuple[float, float] | None
    init: Literal["mesh", "random"]
    seamless: bool


@dataclass(frozen=True, kw_only=True)
class Edit(EditOptions):
    """What both commands do with their options; those that are None are the preset's."""

    def chosen(self, preset: Preset, name: str) -> Any:
        """The option's value, or else the preset's."""
        own = getattr(self, name, None)
        return getattr(preset, name) if own is None else own

    def loss_weights(self, default: _Weights) -> _Weights:
        """The weights of the losses: those of the options that are given, for the others ``default``."""
        own = {part.name: getattr(self, part.name, None) for part in fields(default)}
        return replace(default, **{name: value for name, value in own.items() if value is not None})

    def network(self, published: str) -> FeatureNetwork:
        """The network of --weights, or else a published one, on the chosen device."""
        return load_features(published if self.weights is None else self.weights).to(chosen_device(self.device))

    def checked(self) -> None:
        """Raise ValueError for options out of range and FileExistsError for outputs that are no results of ours, before
        anything is read or fetched.
        """
        limits = {"batch": 1, "size": 32, "texture_size": 1, "preview": 1, "turntable": 0, "seed": 0}
        for name, least in limits.items():
            checked_count(name, getattr(self, name), least)
        for name, least in {"iterations": 1, "uv": 16}.items():
            if getattr(self, name) is not None:
                checked_count(name, getattr(self, name), least)
        inputs = [self.mesh, self.weights, getattr(self, "painting", None)]
        check_outputs([self.output / name for name in _RESULTS], inputs)
        if not self.force:
            check_own(self.output / "mesh.obj", None, "--force replaces it")

    def loaded(self) -> tuple[Mesh | UVMesh, bool]:
        """The mesh and whether it has colours of its own."""
        if self.uv is not None:
            painted = UVMesh.load(self.mesh, allow_outside=self.allow_outside)
            if not painted.images:
                raise ValueError(
                    f"--uv: expected a mesh with texture coordinates and an image, got {self.mesh}, which has none"
                )
            check_images(len(painted.images), self.uv)
            return painted.to(chosen_device(self.device)), True
        vertices, faces, textures = load_mesh(self.mesh, self.texture_size, self.allow_outside)
        check_cubes(len(faces), self.texture_size)
        white = torch.ones(len(faces), *(self.texture_size,) * 3, 3)
        mesh = Mesh(vertices, faces, white if textures is None else textures)
        return mesh.to(chosen_device(self.device)), textures is not None

    def edited(
        self,
        mesh: Mesh | UVMesh,
        coloured: bool,
        objective: Objective,
        preset: Preset,
        weights: StyleWeights | DreamWeights,
    ) -> int:
        """Edit the mesh and write what comes of it; the exit code, 0, or 130 after Ctrl-C.

        ``weights`` are the objective's, for the report.
        """
        setting = {name: self.chosen(preset, name) for name in asdict(preset)}
        if setting["init"] == "mesh" and not coloured:
            setting["init"] = "plain"
        views = RandomViews(setting["elevation"], setting["distance"], light=setting["light"])
        edit = MeshEdit(
            mesh.resized(self.uv) if isinstance(mesh, UVMesh) and self.uv else mesh,
            objective,
            views,
            steps=setting["iterations"],
            batch=self.batch,
            size=self.size,
            vertex_rate=setting["vertex_rate"],
            texture_rate=setting["texture_rate"],
            settle=setting["settle"],
            start=setting["init"],
            texture_size=self.texture_size,
            seamless=setting["seamless"],
            gradient=self.gradient,
            seed=self.seed,
        )
        settings = asdict(self) | setting | asdict(weights)
        inputs = {name: fingerprint(value) for name, value in settings.items() if name not in _FREE}
        device = chosen_device(self.device)
        run = Run(self.output, edit, inputs, lambda path: save_image(path, preview(edit)), self.preview, device)
        with validate.called(steps="--iterations"):
            finished = run.work(self.resume)
        result = edit.mesh()
        result.save(self.output / "mesh.obj", overwrite=self.force)
        result.save(self.output / "mesh.glb")
        save_image(self.output / "views.png", six_views(mesh, result))
        if self.turntable:
            turntable(self.output, result, self.turntable)
        main = next(name for name in run.history[-1] if name not in ("phase", "loss")) if run.history else "loss"
        losses = curve(run.history, main, "loss", logarithmic=main == "style")
        save_image(self.output / "loss.png", losses)
        self._report(edit, run, finished, mesh, settings)
        return 0 if finished else 130

    def _report(self, edit: MeshEdit, run: Run, finished: bool, mesh: Mesh | UVMesh, settings: dict[str, Any]) -> None:
        """Write ``report.json`` and say the most important of it."""
        after, moved = edit.measure(), edit.displacement()
        share = {name: round(part / max(sum(edit.seconds.values()), 1e-9), 4) for name, part in edit.seconds.items()}
        report = {"version": __version__, "finished": finished, "steps": edit.step}
        report |= {"vertices": len(mesh.vertices), "faces": len(mesh.faces), "settings": settings}
        report |= {"held_out": {"before": edit.before, "after": after}, "moved": moved}
        report |= {"seconds": round(run.seconds, 1), "share_of_time": share, "history": run.history}
        write_file(self.output / "report.json", json.dumps(report, indent=1, default=str) + "\n")
        console = Console()
        change = f"{edit.before:.4g} → {after:.4g} on views that no step saw, vertices moved by {moved['mean']:.2%}"
        console.print(f"[bold]{change}[/bold] of the mesh's size on average", highlight=False, soft_wrap=True)
        ending = "" if finished else f", interrupted after {edit.step} steps (--resume goes on)"
        console.print(f"{run.seconds:.1f} s{ending}; the results are in {self.output}", highlight=False, soft_wrap=True)
