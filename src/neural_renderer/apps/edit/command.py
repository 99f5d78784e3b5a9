"""`neural-renderer style` and `neural-renderer dream`: mesh editing for an objective on images."""

from __future__ import annotations

import json
from dataclasses import asdict, fields, replace
from typing import Any, TypeVar

import torch

from ...io import load_image, load_mesh, save_image
from ...io.atomic_write import write_file
from ...io.files import warn
from ...io.obj.writer import check_own
from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ...version import __version__
from ..common.checks import REPORT
from ..common.command import choose_device, load_network, say, say_finished
from ..common.pictures.animation import save_animation
from ..common.pictures.curve import curve
from ..common.task_runner import TaskRunner, setting_value
from ..view.watching import stay, watching
from .dream import PUBLISHED_DREAM, Dream, DreamWeights
from .edit import MeshEdit
from .edit_pictures import preview, six_views, turntable_pictures
from .objective import Objective
from .options import DREAM_PRESETS, STYLE_PRESETS, TURNTABLES, DreamOptions, EditOptions, Preset, StyleOptions
from .paint import check_cubes, check_images
from .random_views import RandomViews
from .style import PUBLISHED_STYLE, Style, StyleWeights

_MAY_DIFFER = ("output", "steps", "preview", "turntable", "allow_outside", "resume", "force", "device", "watch")
"""Options that may differ when an edit is resumed."""
_Weights = TypeVar("_Weights", StyleWeights, DreamWeights)


def run(options: StyleOptions | DreamOptions) -> int:
    """Edit a mesh and write the results; return the exit code: 0, or 130 after Ctrl-C."""
    return _style(options) if isinstance(options, StyleOptions) else _dream(options)


def _style(options: StyleOptions) -> int:
    """Transfer the style of a painting."""
    device = choose_device(options.device)
    painting = load_image(options.painting, upright=True).permute(2, 0, 1).to(device)
    mesh, colored = _load_initial_mesh(options)
    published = options.preset == "published"
    weights = _loss_weights(options, PUBLISHED_STYLE if published else StyleWeights())
    network = load_network(options.weights or "vgg16-original", "--weights").to(device)
    if published and network.name != "VGG-16":
        warn(f"--preset published: its loss weights suit the features of VGG-16, not those of {network.name}")
    style = Style(
        network,
        painting,
        options.size,
        layers=options.layers,
        weights=weights,
        painting_scale=options.painting_scale,
        relative=not published,
    )
    return _run_edit(options, mesh, colored, style, STYLE_PRESETS[options.preset], weights)


def _dream(options: DreamOptions) -> int:
    """Apply DeepDream."""
    mesh, colored = _load_initial_mesh(options)
    published = options.preset == "published"
    weights = _loss_weights(options, PUBLISHED_DREAM if published else DreamWeights())
    network = load_network(options.weights or "googlenet", "--weights").to(choose_device(options.device))
    dream = Dream(network, layer=options.layer, channel=options.channel, weights=weights, relative=not published)
    return _run_edit(options, mesh, colored, dream, DREAM_PRESETS[options.preset], weights)


def _load_initial_mesh(options: EditOptions) -> tuple[Mesh | UVMesh, bool]:
    """Load the mesh to edit; return also whether it has colours. FileExistsError: It would replace a foreign file."""
    if not options.force:
        check_own(options.output / "mesh.obj", None, "--force replaces it")
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


def _loss_weights(options: EditOptions, default: _Weights) -> _Weights:
    """Return loss weights: the option of each weight if it is given, else ``default``."""
    given = {part.name: getattr(options, part.name, None) for part in fields(default)}
    return replace(default, **{name: value for name, value in given.items() if value is not None})


def _run_edit(
    options: EditOptions,
    mesh: Mesh | UVMesh,
    colored: bool,
    objective: Objective,
    preset: Preset,
    weights: StyleWeights | DreamWeights,
) -> int:
    """Edit a mesh, as from `_load_initial_mesh`, and write results and report, with the loss ``weights``.

    Returns the exit code: 0, or 130 after Ctrl-C.
    """
    chosen = preset.fill(options)
    if chosen["init"] == "mesh" and not colored:
        chosen["init"] = "plain"
    same = {name: getattr(options, name) for name in ("batch", "size", "texture_size", "gradient", "seed")}
    same |= {name: chosen[name] for name in ("steps", "vertex_rate", "texture_rate", "settle", "seamless")}
    edit = MeshEdit(
        mesh.resized(options.uv) if isinstance(mesh, UVMesh) and options.uv else mesh,
        objective,
        RandomViews(chosen["elevation"], chosen["distance"], light=chosen["light"]),
        start=chosen["init"],
        **same,
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
        finished = runner.run(options.resume)
        _write(options, edit, mesh, runner, settings)
        stay(viewer, finished or runner.stopped)
    return 0 if finished or runner.stopped else 130


def _write(
    options: EditOptions, edit: MeshEdit, before: Mesh | UVMesh, runner: TaskRunner, settings: dict[str, Any]
) -> None:
    folder, mesh, history = options.output, edit.mesh(), runner.history
    mesh.save(folder / "mesh.obj", overwrite=options.force)
    mesh.save(folder / "mesh.glb")
    save_image(folder / "views.png", six_views(before, mesh))
    if options.turntable:
        pictures = turntable_pictures(mesh, options.turntable)
        for name in TURNTABLES:
            save_animation(folder / name, pictures, fps=15)
    main = next(name for name in history[-1] if name not in ("phase", "loss")) if history else "loss"
    save_image(folder / "loss.png", curve(history, main, "loss", logarithmic=main == "style"))
    after, moved = edit.measure(), edit.displacement()
    total = max(sum(edit.seconds.values()), 1e-9)
    report = {
        "version": __version__,
        "finished": edit.done,
        "steps": edit.step,
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "inputs": {
            name: str(settings[name].resolve()) for name in ("mesh", "painting") if settings.get(name) is not None
        },
        "settings": settings,
        "held_out": {"before": edit.before, "after": after},
        "moved": moved,
        "seconds": round(runner.seconds, 1),
        "share_of_time": {name: round(part / total, 4) for name, part in edit.seconds.items()},
        "changes": runner.changes,
        "history": history,
    }
    write_file(folder / REPORT, json.dumps(report, indent=1, default=str) + "\n")
    change = f"{edit.before:.4g} → {after:.4g} on held-out views, mean displacement {moved['mean']:.2%}"
    say(f"[bold]{change}[/bold] of the mesh's longest side", markup=True)
    say_finished(runner.seconds, folder, None if edit.done else edit.step)
