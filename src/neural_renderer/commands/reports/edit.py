"""Result files and report of `neural-renderer style` and `neural-renderer dream`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...io import save_animation, save_image
from ...io.atomic_write import write_file
from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ...pictures.curve import curve
from ...tasks.editing import MeshEdit
from ...tasks.editing.edit_pictures import six_views, turn
from ...version import __version__
from ..common import say, say_finished
from ..options import EditOptions
from ..task_runner import TaskRunner

_PICTURES, _TURNTABLES = ("preview.png", "views.png", "loss.png"), ("turntable.mp4", "turntable.gif")
RESULTS = ("mesh.obj", "mesh.glb", *_PICTURES, *_TURNTABLES, "report.json")
"""Files that a run writes."""


def write_results(options: EditOptions, edit: MeshEdit, before: Mesh | UVMesh, history: list[dict[str, Any]]) -> None:
    """Write the edited mesh and pictures of it.

    Args:
        options: The options of the command.
        edit: The edit.
        before: The mesh before the edit.
        history: Losses of the steps.
    """
    folder, mesh = options.output, edit.mesh()
    mesh.save(folder / "mesh.obj", overwrite=options.force)
    mesh.save(folder / "mesh.glb")
    save_image(folder / "views.png", six_views(before, mesh))
    if options.turntable:
        pictures = turn(mesh, options.turntable)
        for name in _TURNTABLES:
            save_animation(folder / name, pictures, fps=15)
    main = next(name for name in history[-1] if name not in ("phase", "loss")) if history else "loss"
    save_image(folder / "loss.png", curve(history, main, "loss", logarithmic=main == "style"))


def report_edit(
    folder: Path,
    edit: MeshEdit,
    runner: TaskRunner,
    mesh: Mesh | UVMesh,
    settings: dict[str, Any],
    finished: bool,
) -> None:
    """Write ``report.json`` and print a summary.

    Args:
        folder: Output folder.
        edit: The edit.
        runner: Its runner.
        mesh: The mesh before the edit.
        settings: All settings.
        finished: Whether all steps were taken.
    """
    after, moved = edit.measure(), edit.displacement()
    total = max(sum(edit.seconds.values()), 1e-9)
    report = {
        "version": __version__,
        "finished": finished,
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
        "history": runner.history,
    }
    write_file(folder / "report.json", json.dumps(report, indent=1, default=str) + "\n")
    change = f"{edit.before:.4g} → {after:.4g} on held-out views, mean displacement {moved['mean']:.2%}"
    say(f"[bold]{change}[/bold] of the mesh's longest side", markup=True)
    say_finished(runner.seconds, folder, None if finished else edit.step)
