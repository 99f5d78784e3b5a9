"""Mesh editing: the common part of `neural-renderer style` and `neural-renderer dream`."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import torch

from .. import validate
from ..features import FeatureNetwork, load_features
from ..io import load_mesh, save_image
from ..io.obj.writer import check_own
from ..meshes.mesh import Mesh
from ..meshes.uv_mesh import UVMesh
from ..tasks.editing import DreamWeights, MeshEdit, RandomViews, StyleWeights
from ..tasks.editing.edit import Objective
from ..tasks.editing.edit_pictures import preview
from ..tasks.editing.paint import check_cubes, check_images
from .common import check_counts, check_outputs, choose_device
from .options import EditOptions
from .reports.edit import RESULTS, report_edit, write_results
from .task_runner import TaskRunner, setting_value
from .watch import stay, watching

_MAY_DIFFER = ("output", "iterations", "preview", "turntable", "allow_outside", "resume", "force", "device", "watch")
"""Options that may differ when an edit is resumed."""
_Weights = TypeVar("_Weights", StyleWeights, DreamWeights)


@dataclass(frozen=True)
class Preset:
    """Default values of options."""

    iterations: int
    vertex_rate: float
    texture_rate: float
    settle: float
    elevation: tuple[float, float]
    distance: float
    light: tuple[float, float] | None
    init: Literal["mesh", "random"]
    seamless: bool

    def fill(self, options: EditOptions) -> dict[str, Any]:
        """Return a value for each field: the option if it is given, else the preset."""
        given = {name: getattr(options, name, None) for name in asdict(self)}
        return {name: value if given[name] is None else given[name] for name, value in asdict(self).items()}


def check_options(options: EditOptions, *inputs: Path) -> None:
    """Check options before anything is read or downloaded.

    Args:
        options: The options.
        *inputs: Input files besides the mesh and the weights.

    Raises:
        ValueError: An option is out of range, or an output file is an input.
        FileExistsError: An output file belongs to another program, and --force is not given.
    """
    check_counts(options, batch=1, size=32, texture_size=1, preview=1, turntable=0, seed=0, iterations=1, uv=16)
    check_outputs([options.output / name for name in RESULTS], [options.mesh, options.weights, *inputs])
    if not options.force:
        check_own(options.output / "mesh.obj", None, "--force replaces it")


def load_initial_mesh(options: EditOptions) -> tuple[Mesh | UVMesh, bool]:
    """Load the mesh to edit; return also whether it has colours."""
    device = choose_device(options.device)
    if options.uv is not None:
        textured = UVMesh.load(options.mesh, allow_outside=options.allow_outside)
        if not textured.images:
            raise ValueError(
                f"--uv: expected a mesh with texture coordinates and an image, got {options.mesh}, which has none"
            )
        check_images(len(textured.images), options.uv)
        return textured.to(device), True
    vertices, faces, textures = load_mesh(options.mesh, options.texture_size, options.allow_outside)
    check_cubes(len(faces), options.texture_size)
    white = torch.ones(len(faces), *(options.texture_size,) * 3, 3)
    mesh = Mesh(vertices, faces, white if textures is None else textures)
    return mesh.to(device), textures is not None


def load_network(options: EditOptions, published: str) -> FeatureNetwork:
    """Load the network of --weights, or else the published one."""
    return load_features(published if options.weights is None else options.weights).to(choose_device(options.device))


def loss_weights(options: EditOptions, default: _Weights) -> _Weights:
    """Return loss weights: the option of each weight if it is given, else ``default``."""
    given = {part.name: getattr(options, part.name, None) for part in fields(default)}
    return replace(default, **{name: value for name, value in given.items() if value is not None})


def run_edit(
    options: EditOptions,
    mesh: Mesh | UVMesh,
    colored: bool,
    objective: Objective,
    preset: Preset,
    weights: StyleWeights | DreamWeights,
) -> int:
    """Edit a mesh, and write results and report.

    Args:
        options: The options of the command.
        mesh: The mesh.
        colored: Whether the mesh has colours; see `load_initial_mesh`.
        objective: The objective.
        preset: Default values of options.
        weights: Loss weights of the objective, for the report.

    Returns:
        The exit code: 0, or 130 after Ctrl-C.
    """
    chosen = preset.fill(options)
    if chosen["init"] == "mesh" and not colored:
        chosen["init"] = "plain"
    edit = MeshEdit(
        mesh.resized(options.uv) if isinstance(mesh, UVMesh) and options.uv else mesh,
        objective,
        RandomViews(chosen["elevation"], chosen["distance"], light=chosen["light"]),
        steps=chosen["iterations"],
        batch=options.batch,
        size=options.size,
        vertex_rate=chosen["vertex_rate"],
        texture_rate=chosen["texture_rate"],
        settle=chosen["settle"],
        start=chosen["init"],
        texture_size=options.texture_size,
        seamless=chosen["seamless"],
        gradient=options.gradient,
        seed=options.seed,
    )
    settings = asdict(options) | chosen | asdict(weights)
    del settings["watch"]
    with watching(options.watch) as viewer:
        if viewer is not None:
            viewer.show(mesh, "before")
        runner = TaskRunner(
            options.output,
            edit,
            {name: setting_value(value) for name, value in settings.items() if name not in _MAY_DIFFER},
            lambda path: save_image(path, preview(edit)),
            options.preview,
            choose_device(options.device),
            viewer,
            lambda: {"mesh": edit.mesh(fill=False)},
        )
        with validate.called(steps="--iterations"):
            finished = runner.run(options.resume)
        write_results(options, edit, mesh, runner.history)
        report_edit(options.output, edit, runner, mesh, settings, finished)
        stay(viewer, finished or runner.stopped)
    return 0 if finished or runner.stopped else 130
