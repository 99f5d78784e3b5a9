"""Results of the commands, read from files and folders: meshes, pictures, cameras, curves and steps."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...camera import Camera
from ...io.files import read_text, reason, short
from ...io.formats import MESH_SUFFIXES
from ...io.named_files import is_file, is_outside
from ...meshes.uv_mesh import UVMesh
from ..common.checks import leads_outside
from ..common.views.load import load_photo, load_views
from ..common.views.small_copies import COPIES
from ..common.views.views import Views
from .records.replay import Record, is_record

_PICTURES = (".png", ".jpg", ".jpeg", ".webp")
_MOST_MESHES, _MOST_PICTURES = 12, 200
_LONGEST_NAME, _MOST_REASONS = 1024, 20
_NO_REPORT = (AttributeError, TypeError, KeyError, IndexError, OverflowError, RecursionError)
"""Errors at values of a kind that no command writes."""
_GREY = 0.5  # grey of meshes without colours
REPORT = "report.json"
"""File of a run's settings and numbers."""
_FILES = ("mesh", "images", "painting", "image")  # inputs of a run that are files
_INNER = ("pictures", "sheets")  # folders of pictures of a training, and of a data set
_OWN = {"sparse/0": ".", COPIES: COPIES}
"""Folders with cameras that a fit has found or was given, and where the copies of their photographs are."""
_NOT_BLACK = 1e-6  # pixels of copies without masks are shown if they are brighter
_VIEW_SIZE = 256  # longer side of a photograph in pixels


@dataclass
class Results:
    """Contents of a file or folder, for the viewer."""

    meshes: dict[str, Any] = field(default_factory=dict)  # meshes for `Viewer.show`, by name
    pictures: dict[str, Path] = field(default_factory=dict)  # image files by name
    views: Views | None = None  # cameras with photographs
    record: Record | None = None
    numbers: dict[str, list[tuple[float, float]]] = field(default_factory=dict)  # points (step, value) of curves
    notes: list[str] = field(default_factory=list)  # sentences about what is missing


def read_results(path: Path, allow_outside: bool = False) -> Results:
    """Read a mesh file, a record, or a folder. They name files outside of their folder only if ``allow_outside``.

    Damaged files in a folder are left out, with a note. OSError, ValueError: there is no such file or folder, the file
    is none that can be shown, or the folder has nothing to show.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: expected a mesh, a record or a folder, got nothing there")
    if path.is_dir():
        return _read_folder(path, allow_outside)
    if is_record(path):
        record = Record(path)
        return Results(record=record, numbers=record.numbers)
    return Results(meshes={path.stem: read_mesh_to_show(path, allow_outside)})


def read_mesh_to_show(path: Path, allow_outside: bool = False) -> Any:
    """Read a mesh with its images; a mesh without colours is returned as (vertices, faces)."""
    mesh = UVMesh.load(path, grey=_GREY, allow_outside=allow_outside)
    if not mesh.images and bool((mesh.colors == _GREY).all()):
        return mesh.vertices, mesh.faces
    return mesh


def _check_links(folder: Path) -> None:
    """Raise ValueError if a symbolic link leads outside: a folder may come from others, and a record is shared."""
    for place, folders, files in os.walk(folder):
        for path in (os.path.join(place, name) for name in (*folders, *files)):
            if os.path.islink(path) and leads_outside(path, folder):
                name = short(os.path.relpath(path, folder))
                raise ValueError(
                    f"{folder}: expected files of its own, got the link {name}, which leads outside; "
                    "allow_outside=True follows it"
                )


def _read_folder(folder: Path, allow_outside: bool) -> Results:
    if not allow_outside:
        _check_links(folder)
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    results = Results()
    report = _read_report(folder / REPORT, results)
    found = [path for path in files if path.suffix.lower() in MESH_SUFFIXES]
    # Commands write a mesh as OBJ, which is read faster, and GLB. Of the files of others, GLB has more materials.
    first = ".obj" if report else ".glb"
    stems = {path.stem for path in found if path.suffix.lower() == first}
    found = [path for path in found if path.suffix.lower() == first or path.stem not in stems]
    if len(found) > _MOST_MESHES:
        results.notes.append(f"{len(found)} meshes; the first {_MOST_MESHES} are shown")
    inputs = _inputs(folder, report, results, allow_outside)
    before = inputs.get("mesh")
    if report.get("verdict") == "doubtful":
        results.notes.append(f"doubtful: {_reasons(report)}")
    with ThreadPoolExecutor(1) as other:  # photographs are read in parallel with the meshes
        views = other.submit(_read_views, report, inputs, allow_outside) if inputs.get("images") else None
        if before:
            _try_mesh(results, "before", Path(before), allow_outside)
        for path in found[:_MOST_MESHES]:
            is_result = bool(report) and path.stem == "mesh"
            _try_mesh(results, "result" if is_result else path.stem, path, allow_outside)
    if views is not None:
        with _noting(results, Path(inputs["images"])):
            results.views = views.result()
    textures = tuple(f"{path.stem}_texture_" for path in found)  # spot_texture.png, or spot_texture_1.png and so on
    pictures = [path for path in files if path.suffix.lower() in _PICTURES and not f"{path.stem}_".startswith(textures)]
    pictures += [path for inner in _INNER for path in sorted((folder / inner).glob("*.png"))]
    for name in ("painting", "image"):
        if inputs.get(name) and is_file(Path(inputs[name])):
            results.pictures[name] = Path(inputs[name])
    results.pictures |= {path.relative_to(folder).as_posix(): path for path in pictures[-_MOST_PICTURES:]}
    for path in files:
        if is_record(path) and results.record is None:
            with _noting(results, path):
                results.record = Record(path)
    _read_log(folder / "log.csv", results)
    if not (results.meshes or results.pictures or results.record or results.numbers):
        notes = f" ({'; '.join(results.notes)})" if results.notes else ""
        raise ValueError(f"{folder}: expected meshes, pictures, curves or a record, got none{notes}")
    return results


def _inputs(folder: Path, report: dict[str, Any], results: Results, allow_outside: bool) -> dict[str, Any]:
    """Return the inputs of a run; files outside of its folder, with a note instead unless they are allowed.

    A folder of results may come from others, and the files that it names are shown and go into records. Only names
    decide, so that no other disk or machine is accessed.
    """
    inputs = dict(report["inputs"]) if isinstance(report.get("inputs"), dict) else {}
    pictures = next((place for name, place in _OWN.items() if (folder / name).is_dir()), None)
    if inputs.get("images") and pictures:
        inputs |= {"images": pictures, "background": None}
    inputs["mask_below"] = _NOT_BLACK if pictures else None
    for name in _FILES:
        value = inputs.get(name)
        if value and not (isinstance(value, str) and value.isprintable() and len(value) <= _LONGEST_NAME):
            results.notes.append(f"{folder / REPORT}: expected the name of a file as {name}, got {short(value)}")
            del inputs[name]
        elif value and is_outside(folder / REPORT, value) and not allow_outside:
            results.notes.append(f"{name} is {short(value)}, outside of {folder}: allow_outside=True shows it")
            del inputs[name]
        elif value:
            inputs[name] = os.path.join(folder, value)
    return inputs


def _reasons(report: dict[str, Any]) -> str:
    """Return why a result is doubtful, in words; a report may come from others, and hold anything."""
    listed = report.get("reasons")
    rows = listed if isinstance(listed, list) else []
    return "; ".join(str(row.get("text"))[:_LONGEST_NAME] for row in rows[:_MOST_REASONS] if isinstance(row, dict))


@contextmanager
def _noting(results: Results, path: Path) -> Iterator[None]:
    """Read a file of a folder; note it if that fails."""
    try:
        yield
    except (OSError, ValueError, *_NO_REPORT) as error:
        ours = isinstance(error, OSError) or "expected" in str(error)
        text = reason(error) if ours else "expected values that a command writes, got others"
        results.notes.append(text if str(path) in text else f"{path}: {text}")


def _try_mesh(results: Results, name: str, path: Path, allow_outside: bool) -> None:
    while name in results.meshes:
        name += "'"
    with _noting(results, path):
        results.meshes[name] = read_mesh_to_show(path, allow_outside)


def _read_views(report: dict[str, Any], inputs: dict[str, Any], allow_outside: bool) -> Views:
    """Read the photographs and cameras of a fit, or those of the camera that was found for one photograph."""
    options = {"size": _VIEW_SIZE, **_photo_options(inputs)}
    found = report.get("camera")
    if not isinstance(found, dict):
        return load_views(inputs["images"], maps=False, allow_outside=allow_outside, **options)
    mask, photo = load_photo(inputs["images"], **options)
    camera = Camera.look(found["eye"], found["direction"], found["up"], viewing_angle=found["viewing_angle"])
    return Views(camera, mask[None], None if photo is None else photo[None])


def _photo_options(inputs: dict[str, Any]) -> dict[str, Any]:
    background = inputs.get("background")
    return {
        "photos": inputs.get("photos", True),
        "background": None if background is None else tuple(background),
        "mask_below": inputs["mask_below"],
    }


def _read_report(path: Path, results: Results) -> dict[str, Any]:
    """Read the report of a command: its history as curves. Returns an empty dict without a report."""
    if not path.is_file():
        return {}
    try:
        report = json.loads(read_text(path))
        for number, row in enumerate(report.get("history", []), 1):
            for name, value in row.items():
                if isinstance(value, (int, float)):
                    results.numbers.setdefault(name, []).append((number, float(value)))
    except (ValueError, *_NO_REPORT):
        results.notes.append(f"{path}: expected the report of a command, got other text")
        return {}
    return report


def _read_log(path: Path, results: Results) -> None:
    if not path.is_file():
        return
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        for row in csv.DictReader(file):
            for name in ("loss", "iou", "val_iou"):
                try:
                    point = float(row["step"]), float(row[name])
                except (KeyError, TypeError, ValueError):  # a row has some of the numbers only
                    continue
                results.numbers.setdefault(name, []).append(point)
