"""`neural-renderer view`: meshes, results and records in the browser."""

from __future__ import annotations

from pathlib import Path

from ...io.files import warn
from ..common.command import say
from ..common.views.up import named_up
from .options import ViewOptions
from .records.replay import Record
from .results import Results, read_results
from .viewer import Viewer


def run(options: ViewOptions) -> int:
    """Show the files until Ctrl-C; return the exit code."""
    results = _read(options)
    for note in results.notes:
        warn(note)
    with Viewer(host=options.host, port=options.port, browser=options.browser, title="neural-renderer") as viewer:
        viewer.finish("")  # nothing is computed
        _show(viewer, results, options)
        if options.record is not None:
            viewer.flush()
            say(viewer.save_record(options.record))
        if viewer.url is not None:
            say(f"open {viewer.url} in a browser; Ctrl-C ends the viewer")
            try:
                viewer.wait()
            except KeyboardInterrupt:
                say("the viewer has ended")
    return 0


def _read(options: ViewOptions) -> Results:
    found = [read_results(path, options.allow_outside) for path in options.paths]
    if len(found) == 1:
        return found[0]
    several = Results()
    for path, results in zip(options.paths, found, strict=True):
        if path.is_dir() or results.record is not None:
            raise ValueError(f"paths: expected several meshes, or one folder or record, got {path} among others")
        for name, mesh in results.meshes.items():
            several.meshes[_free_name(name, path, several)] = mesh
    return several


def _free_name(name: str, path: Path, results: Results) -> str:
    for candidate in (name, path.name, str(path)):
        if candidate not in results.meshes:
            return candidate
    return f"{path} {len(results.meshes)}"


def _show(viewer: Viewer, results: Results, options: ViewOptions) -> None:
    is_run = results.record is not None or results.views is not None or {"before", "result"} & set(results.meshes)
    viewer.arrange(equal_size=not is_run)  # else a small mesh next to a large one is invisible
    for name, mesh in results.meshes.items():
        if results.record is None or name == "before":
            viewer.show(mesh, name)  # on the left
    if results.record is not None:
        _show_steps(viewer, results, results.record)
    if results.numbers:
        viewer.show_curves(results.numbers)
    if results.pictures:
        viewer.show_pictures(results.pictures)
    if results.views is not None:
        viewer.show_cameras(results.views.camera, results.views.photos, results.views.masks)
    up = options.up or (None if results.views is None else named_up(results.views))
    if up is not None:
        viewer.set_up(up)


def _show_steps(viewer: Viewer, results: Results, record: Record) -> None:
    """Show the last frame of a record, and a slider; the result of a command follows after the last frame."""
    result = results.meshes.get("result")
    labels = [*record.labels, *([] if result is None else ["result"])]

    def choose(number: int) -> None:
        meshes = {"mesh": result} if number == len(record) else record.meshes(number)
        for name, mesh in meshes.items():
            viewer.show(mesh, name)

    choose(len(labels) - 1)
    viewer.show_steps(labels, choose)
