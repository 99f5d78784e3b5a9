"""Result files and reports of `neural-renderer fit`."""

from __future__ import annotations

import json
from typing import Any

from torch import Tensor

from ...camera.files.opencv import save_cameras
from ...io import save_animation, save_image
from ...io.atomic_write import write_file
from ...meshes.unwrap import unwrap
from ...pictures.curve import curve
from ...pictures.turntable import turntable
from ...tasks.fit import CameraFit, FitResult, MeshFit, Views
from ...tasks.fit.fit_pictures import comparison, upright
from ...version import __version__
from ..common import say, say_finished
from ..options import FitOptions
from ..task_runner import TaskRunner

_TURNTABLE_SIZE = 256  # pixels
_NAMES = {
    "fitted": "fitted",
    "held_out": "held-out",
    "held_out_located": "held-out (with cameras located on the result)",
    "held_out_exposed": "held-out (with exposure matched to the result)",
}
CAMERAS = "cameras.json"
"""File that a fit with refined cameras writes, too."""
RESULTS = (
    "mesh.obj",
    "mesh.glb",
    "preview.png",
    "comparison.png",
    "loss.png",
    "turntable.gif",
    "report.json",
    "cameras.json",
)
"""Files that a fit writes."""


def write_mesh(options: FitOptions, fit: MeshFit, views: Views) -> None:
    """Write a fitted mesh and pictures of it.

    Args:
        options: The options of the command.
        fit: The fit.
        views: The fitted views, in the world of the mesh.
    """
    folder, mesh = options.output, fit.mesh()
    written = unwrap(mesh, options.unwrap) if options.unwrap else mesh
    written.save(folder / "mesh.obj", overwrite=options.force)
    written.save(folder / "mesh.glb")
    save_image(folder / "comparison.png", comparison(fit.views, fit.shape))
    if options.turntable:
        pictures = turntable(upright(mesh, views, options.up), options.turntable, size=_TURNTABLE_SIZE)
        save_animation(folder / "turntable.gif", pictures, fps=15)


def write_cameras(options: FitOptions, fit: MeshFit, names: list[str]) -> None:
    """Write the refined cameras of the images with these names, but parallel and fisheye ones."""
    camera = fit.cameras()
    if camera.perspective and not camera.is_fisheye:
        save_cameras(options.output / CAMERAS, camera, names, fit.views.size)


def report_mesh(
    options: FitOptions, runner: TaskRunner, fit: MeshFit, result: FitResult, finished: bool, names: list[str]
) -> None:
    """Write the figures of a fit of the images with these names to ``report.json``, and print a summary."""
    mesh, gains = result.mesh, fit.views.gains
    results: dict[str, Any] = {"views": len(fit.views), "vertices": len(mesh.vertices), "faces": len(mesh.faces)}
    if gains is not None:
        rows = [[round(gain, 4) for gain in row] for row in gains.tolist()]
        results["gains"] = dict(zip(names, rows, strict=True))
    for name in _NAMES:
        if figures := getattr(result, name):
            results[name] = {
                measure: {"mean": round(values.mean().item(), 4), "least": round(values.min().item(), 4)}
                for measure, values in figures.items()
            }
    _report(options, runner, results, finished)


def report_camera(
    options: FitOptions,
    runner: TaskRunner,
    fit: CameraFit,
    views: Views,
    shape: tuple[Tensor, ...],
    finished: bool,
) -> None:
    """Write a picture and the report of a fitted camera, and print a summary.

    Args:
        options: The options of the command.
        runner: The runner of the fit.
        fit: The fit.
        views: The image with the fitted camera.
        shape: The known mesh.
        finished: Whether all steps were taken.
    """
    save_image(options.output / "comparison.png", comparison(views, shape))
    eye, forward = views.eyes()
    results = {
        "camera": {
            "eye": eye[0].tolist(),
            "direction": forward[0].tolist(),
            "up": views.camera.rotation[0, 1].tolist(),
            "viewing_angle": options.viewing_angle,
        },
        "fitted": {"iou": {"mean": round(views.quality(shape[:2])["iou"].item(), 4)}},
        "starts": [round(value, 4) for value in fit.losses().tolist()],
    }
    _report(options, runner, results, finished)


def _report(options: FitOptions, runner: TaskRunner, results: dict[str, Any], finished: bool) -> None:
    """Write ``report.json`` and the curve of the losses, and print a summary."""
    report = {
        "version": __version__,
        "recover": options.recover,
        "inputs": {
            "images": str(options.images.resolve()),
            "mesh": None if options.mesh is None else str(options.mesh.resolve()),
            "photos": options.photos,
            "maps": options.maps,
            "background": options.background,
        },
        "gradient": options.gradient,
        "finished": finished,
        "seconds": round(runner.seconds, 1),
        **results,
        "changes": runner.changes,
        "history": runner.history,
    }
    write_file(options.output / "report.json", json.dumps(report, indent=1) + "\n")
    if runner.history:
        save_image(options.output / "loss.png", curve(runner.history, "loss", "iou"))
    for name in _NAMES:
        if name in results:
            numbers = ", ".join(f"{measure} {value['mean']:.4f}" for measure, value in results[name].items())
            say(f"{_NAMES[name]} views: [bold]{numbers}[/bold]", markup=True)
    say_finished(runner.seconds, options.output, None if finished else len(runner.history))
