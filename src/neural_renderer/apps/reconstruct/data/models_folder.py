"""Folders of 3D models with one folder per category, and their splits."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from ....io.files import short
from ...many.models import MESHES, read_table
from .framing import SPLITS

_NESTED = ("models/model_normalized.obj", "model_normalized.obj", "models/model.obj", "model.obj")
_COLUMNS = {
    "category": ("category", "class", "synsetid", "synset"),
    "model": ("model", "modelid", "name", "id"),
    "split": ("split", "set"),
}
_SYNONYMS = {"valid": "val", "validation": "val"}
_SHARES = (("train", 0.7), ("val", 0.8), ("test", 1.0))  # cumulative shares of the splits, as in the paper


@dataclass(frozen=True)
class Model:
    """A model of a category."""

    category: str
    name: str  # name of the file without suffix or, in the layouts of ShapeNetCore, of the model's folder
    path: Path  # mesh file


def find_models(folder: Path) -> tuple[list[Model], dict[str, str]]:
    """Find the models in a folder, sorted; and error messages by "category/name". ValueError: There are none.

    The folder of a category contains mesh files, or a folder per model with one mesh file, ``model.obj``, or
    ``models/model_normalized.obj``. Folders without a mesh or with several are errors.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing there"
        raise FileNotFoundError(f"{folder}: expected a folder with a folder of models per category, got {found}")
    models: dict[tuple[str, str], Model] = {}
    broken: dict[str, str] = {}
    for category in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        entries = sorted(path for path in category.iterdir() if not path.name.startswith("."))
        files = [path for path in entries if path.is_file() and is_mesh(path)]
        for path in sorted(files, key=lambda path: MESHES.index(path.suffix.lower())):  # the first format is used
            models.setdefault((category.name, path.stem), Model(category.name, path.stem, path))
        for entry in (path for path in entries if path.is_dir()):
            found_files = _mesh_files(entry)
            if len(found_files) == 1:
                model = Model(category.name, entry.name, found_files[0])
                models.setdefault((category.name, entry.name), model)
            elif found_files:
                names = ", ".join(path.name for path in found_files[:4])
                broken[f"{category.name}/{entry.name}"] = f"{entry}: expected one mesh or model.obj, got {names}"
            elif not files and any(path.is_file() for path in entry.rglob("*")):
                broken[f"{category.name}/{entry.name}"] = f"{entry}: expected a mesh, got none"
    if not models:
        raise ValueError(f"{folder}: expected category/model.obj or category/model/model.obj, got no such mesh file")
    return [models[key] for key in sorted(models)], broken


def is_mesh(path: Path) -> bool:
    """Return whether a file is a mesh, judged by its suffix."""
    return path.suffix.lower() in MESHES


def _mesh_files(folder: Path) -> list[Path]:
    """List the candidates for the mesh file in the folder of a model."""
    for name in _NESTED:
        if (folder / name).is_file():
            return [folder / name]
    for place in (folder, folder / "models"):
        files = sorted(path for path in place.glob("*") if path.is_file())
        for suffix in MESHES:
            found = [path for path in files if path.suffix.lower() == suffix]
            if found:
                return found
    return []


def read_splits(path: Path) -> dict[tuple[str, str], str]:
    """Read a CSV file with the columns category, model, split, or ShapeNet's names of them: (category, model) → split.

    ValueError: The file is malformed; the message names the line.
    """
    header, table = read_table(path)
    given = {name.lower(): name for name in reversed(header)}  # the first of equal names counts
    column = {}
    for wanted, names in _COLUMNS.items():
        column[wanted] = next((given[name] for name in names if name in given), None)
        if column[wanted] is None:
            got = short(", ".join(header).lower()) if header else "an empty file"
            raise ValueError(f"{path}: expected a column {wanted!r}, got {got}")
    splits: dict[tuple[str, str], str] = {}
    for number, row, _ in table:
        if not row.keys() >= set(column.values()):
            raise ValueError(f"{path}, line {number}: expected {len(header)} columns, got {len(row)}")
        category, name, split = (row[str(column[key])] for key in ("category", "model", "split"))
        split = _SYNONYMS.get(split.lower(), split.lower())
        if split not in SPLITS:
            raise ValueError(f"{path}, line {number}: expected a split of {', '.join(SPLITS)}, got {short(split)}")
        splits[category, name] = split
    return splits


def default_splits(models: list[Model]) -> dict[tuple[str, str], str]:
    """Assign models to splits by (category, name): 70 % train, 10 % val, 20 % test of each category.

    The choice depends on names only, so that it is the same on every machine.
    """
    splits = {}
    for category in {model.category for model in models}:
        keys = [(model.category, model.name) for model in models if model.category == category]
        keys.sort(key=lambda key: hashlib.sha256("/".join(key).encode()).digest())
        for index, key in enumerate(keys):
            splits[key] = next(name for name, end in _SHARES if (index + 0.5) / len(keys) <= end)
    return splits
