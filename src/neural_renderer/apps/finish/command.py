"""`neural-renderer finish`: a light mesh with the look of a heavy one."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ...io import save_image
from ...io.atomic_write import write_file
from ...meshes.uv_mesh import UVMesh
from ...version import __version__
from ..common.checks import REPORT
from ..common.command import progress_bars, say, say_finished
from ..common.pictures.outputs import GREY
from ..common.task_runner import TaskRunner, setting_value
from ..compare.comparison import compare
from ..view.watching import stay, watching
from .finish import Finished, finished
from .improve import Improvement
from .levels import save_levels
from .options import SHEET, FinishOptions
from .pictures import preview
from .source import with_materials
from .surface.clean import summary
from .workshop import Workshop

_MAY_DIFFER = ("output", "faces", "lod", "allow_outside", "resume", "force", "watch")
"""Options that may differ when a run is resumed; the number of faces of a level has its own entry."""
_SHEET_VIEWS, _SHEET_SIZE = 8, 384
_LAYERS = 4  # faces blended at a pixel of a sheet, if a material is not opaque


def run(options: FinishOptions) -> int:
    """Finish a mesh and write the results; return the exit code: 0, or 130 after Ctrl-C."""
    start = time.monotonic()
    mesh = UVMesh.load(options.mesh, GREY, options.allow_outside)
    whole = True
    reports: dict[str, Any] = {}
    levels: list[UVMesh] = []
    with watching(options.watch) as viewer:
        workshop = Workshop(
            mesh,
            inside=options.keep_inside,
            pieces=options.pieces,
            holes=options.holes,
            size=options.size,
            gutter=options.gutter,
            keep_uv=options.keep_uv,
        )
        for line in summary(workshop.clean.removed):
            say(line)
        for count in options.faces:
            with progress_bars() as report:
                level = workshop.level(count, report)
            task = Improvement(workshop, level, options.steps, options.views, options.pixels)
            runner = _runner(options, count, task, viewer)
            if options.steps:
                whole = runner.run(options.resume)
            result = finished(workshop, task)
            reports[str(count)] = _write(options, count, mesh, result, runner)
            levels.append(result.mesh)
            if not whole:
                break
        if options.lod and len(levels) > 1:
            save_levels(options.levels_file, levels)
            say(f"{options.levels_file} has all levels")
        stay(viewer, whole or runner.stopped)
    settings = {name: value for name, value in asdict(options).items() if name != "watch"}
    report_of_run = {
        "version": __version__,
        "finished": whole,
        "settings": settings,
        "seconds": round(time.monotonic() - start, 1),
        "levels": reports,
    }
    write_file(options.folder / REPORT, json.dumps(report_of_run, indent=1, default=str) + "\n")
    say_finished(time.monotonic() - start, options.folder, None if whole else task.step)
    return 0 if whole or runner.stopped else 130


def _runner(options: FinishOptions, count: int, task: Improvement, viewer: Any) -> TaskRunner:
    settings = {name: setting_value(value) for name, value in asdict(options).items() if name not in _MAY_DIFFER}
    folder = options.level_folder(count)
    folder.mkdir(parents=True, exist_ok=True)
    return TaskRunner(
        folder,
        task,
        settings | {"level": count},
        lambda path: save_image(path, preview(task.level.mesh)),
        observer=viewer,
        mesh=lambda: {"mesh": task.level.mesh},
    )


def _write(options: FinishOptions, count: int, mesh: UVMesh, result: Finished, runner: TaskRunner) -> dict[str, Any]:
    """Write a level and its sheet; return its report."""
    file: Path = options.mesh_file(count)
    file.parent.mkdir(parents=True, exist_ok=True)
    result.mesh.save(file, overwrite=options.force)
    say(f"{file} has {result.mesh.num_faces:,} faces; it is compared with the original")
    sheet = options.level_folder(count) / SHEET
    layers = None if all(material.alpha_mode == "OPAQUE" for material in result.mesh.materials) else _LAYERS
    drawing: dict[str, Any] = {"views": _SHEET_VIEWS, "size": _SHEET_SIZE, "shading": "pbr", "layers": layers}
    found = compare(with_materials(mesh), result.mesh, output=sheet, **drawing)
    for line in found.table():
        say(line)
    say(f"{sheet} shows both")
    return {"file": str(file), **result.report, "compared": found.as_dict(), "history": runner.history}
