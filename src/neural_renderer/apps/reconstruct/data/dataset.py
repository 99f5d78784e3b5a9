"""Data sets from 3D models: rendered views and voxels, and their assembly into files of the published format."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....io import load_mesh
from ....io.atomic_write import replacing, write_file
from ....rendering.forward import render
from ....version import __version__
from ...many.engines import Done, Engine, Report, Watch
from ...many.workers import JobError, Worker
from ..options import DatasetOptions
from .arrays import DESCRIPTION
from .drawing import SHOULDER
from .framing import DISTANCE, ELEVATION, GRID, SIZE, SPLITS, VIEWING_ANGLE, VIEWS, mirror, scale_to_unit, view_camera
from .models_folder import Model, is_mesh
from .voxels import voxelize_model

_GREY = 0.75  # colour of models without colours
_DARKEST = 0.08  # colours are mapped to [0.08, 1]: pure black would hide the shape
_LIGHT = replace(SHOULDER, directional=0.56)
_MOST_TEXELS = 4_000_000  # texels of a model
_MOST_TEXTURE_SIZE = 16  # texels along the edge of a face's cube
_RECIPE = 1  # version of finished objects; objects of another version are rendered again


@dataclass(frozen=True)
class Settings:
    """Settings of a data set. The defaults are the published settings; training needs them."""

    views: int = VIEWS  # number of views around an object
    size: int = SIZE  # side of the images in pixels
    samples: int = DatasetOptions.samples  # each pixel is the mean of samples × samples samples
    grid: int = GRID  # voxels along each axis


@torch.no_grad()
def render_views(
    vertices: Tensor, faces: Tensor, textures: Tensor | None = None, settings: Settings = Settings()
) -> Tensor:
    """Render the views of an object in the reconstruction frame: [K, 4, S, S] uint8, RGBA.

    Vertices are [V, 3], faces [F, 3], textures [F, T, T, T, 3] or None for grey. Colours are not multiplied by alpha.
    """
    if textures is None:
        textures = torch.full((len(faces), 2, 2, 2, 3), _GREY)
    textures = _DARKEST + (1 - _DARKEST) * textures
    pictures = []
    for view in range(settings.views):
        camera = view_camera(torch.tensor([view]), settings.views)
        size = settings.size * settings.samples
        images = render(
            (vertices, faces, textures), camera, size, light=_LIGHT, outputs=("rgb", "alpha"), anti_aliasing=False
        )
        alpha = F.avg_pool2d(images.alpha[:, None], settings.samples)
        # Means over a black background are multiplied by alpha; divide by it to get the mean of the object's samples.
        rgb = F.avg_pool2d(images.rgb, settings.samples) / alpha.clamp(min=1e-6)
        pictures.append(torch.cat((rgb.clamp(0, 1) * (alpha > 0), alpha), 1))
    return (torch.cat(pictures) * 255 + 0.5).to(torch.uint8)


def make_object(path: Path, settings: Settings = Settings(), allow_outside: bool = False) -> tuple[Tensor, Tensor]:
    """Render and voxelise a model file, scaled to a longest side of 1: views [K, 4, S, S] uint8, and voxels.

    ValueError: The file is unreadable or no face is visible; the message names the file.
    """
    vertices, faces, textures = load_mesh(path, 2, allow_outside)
    if textures is not None:
        texture_size = min(_MOST_TEXTURE_SIZE, int((_MOST_TEXELS / len(faces)) ** (1 / 3)))
        textures = load_mesh(path, texture_size, allow_outside)[2] if texture_size > 2 else textures
    used = torch.unique(faces.long())  # unused vertices do not count
    try:
        vertices = mirror(vertices.index_copy(0, used, scale_to_unit(vertices[used])))
        images = render_views(vertices, faces, textures, settings)
        if not images[:, 3].any():
            raise ValueError("faces: expected a visible surface, got empty images")
        return images, voxelize_model(vertices, faces, settings.grid)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


@dataclass(frozen=True)
class _Object:
    """Object to make: its model, and the key of its finished file."""

    model: Model
    key: str

    @property
    def name(self) -> str:
        return f"{self.model.category}/{self.model.name}"


@dataclass(frozen=True)
class _MakeFile:
    """Makes the file of an object with a worker; returns an error message or None, and warnings."""

    folder: Path
    settings: Settings
    allow_outside: bool

    def __call__(self, part: _Object, worker: Worker, report: Report) -> tuple[str | None, list[str]]:
        path = part.model.path
        try:
            (images, voxels), notes = worker.run(self._make, path)
        except JobError as error:
            problem = str(error) if str(path) in str(error) else f"{path}: {error}"
            report(Done(1, failures=1, problems=(problem,)))
            return problem, []
        arrays: dict[str, Any] = {"images": images, "voxels": voxels, "notes": np.array(notes, np.str_)}
        with replacing(object_file(part.model, self.folder)) as fresh, open(fresh, "wb") as file:
            np.savez_compressed(file, key=np.array(part.key), **arrays)
        report(Done(1, len(images), notes=tuple(notes)))
        return None, notes

    def _make(self, path: Path) -> tuple[np.ndarray, np.ndarray]:
        images, voxels = make_object(path, self.settings, self.allow_outside)
        return images.numpy(), voxels.numpy()


def make_objects(
    models: Sequence[Model],
    folder: Path,
    settings: Settings,
    engine: Engine,
    allow_outside: bool = False,
    watch: Watch = lambda *_: None,
) -> Iterator[tuple[Model, str | None, list[str]]]:
    """Render and voxelise models, one file per model in ``folder``; finished models are skipped.

    Yields each model when it is finished, with an error message or None, and warnings. ``watch`` gets statistics.
    """
    parts = []
    for model, key in _keys(models, settings, allow_outside).items():
        notes = _finished_notes(model, folder, key)
        if notes is None:
            parts.append(_Object(model, key))
        else:
            watch("before", Done(1, notes=tuple(notes)))
            yield model, None, notes
    with closing(engine.run(_MakeFile(folder, settings, allow_outside), parts, watch)) as finished:
        for part, (problem, notes) in finished:
            yield part.model, problem, notes


def object_file(model: Model, folder: Path) -> Path:
    """Return the file of a finished object."""
    return folder / "objects" / model.category / f"{model.name}.npz"


def _keys(models: Sequence[Model], settings: Settings, allow_outside: bool) -> dict[Model, str]:
    """Compute a key for each model that changes with its mesh file, its materials and its images.

    In a folder with several models, a model owns the files with its name as a prefix; unmatched files belong to all.
    """
    together: dict[Path, list[Model]] = {}
    for model in models:
        folder_of = next((folder for folder in model.path.parents if folder.name == model.name), model.path.parent)
        together.setdefault(folder_of, []).append(model)
    keys = {}
    for folder, here in together.items():
        names = [path.stem for path in folder.iterdir() if is_mesh(path)]
        files: dict[str | None, list[Any]] = {}
        for path in sorted(path for path in folder.rglob("*") if path.is_file() and not is_mesh(path)):
            owner = max((name for name in names if path.name.startswith(name)), key=len, default=None)
            files.setdefault(owner, []).append((str(path), _stamp(path)))
        for model in here:
            own_files = files.get(model.path.stem, []), files.get(None, [])
            recipe = [_RECIPE, asdict(settings), *_stamp(model.path), zlib.crc32(repr(own_files).encode())]
            recipe += ["allow_outside"] if allow_outside else []
            keys[model] = json.dumps(recipe)
    return {model: keys[model] for model in models}


def _stamp(path: Path) -> tuple[int, int]:
    """Return size and modification time of a file."""
    status = path.stat()
    return status.st_size, status.st_mtime_ns


def _finished_notes(model: Model, folder: Path, key: str) -> list[str] | None:
    """Return the warnings about a finished object with this key, or None if it is not finished."""
    try:
        with np.load(object_file(model, folder)) as arrays:
            return arrays["notes"].tolist() if str(arrays["key"]) == key else None
    except Exception:  # the file is missing or damaged
        return None


def assemble(
    folder: Path, splits: dict[str, dict[str, list[Model]]], settings: Settings, broken: dict[str, str]
) -> None:
    """Combine finished objects into the files of the published format, and write dataset.json.

    Other classes and splits of the data set stay. ``splits`` maps split → class → models, in order; ``broken`` maps
    "category/name" to an error message, for dataset.json.
    """
    names: dict[str, dict[str, list[str]]] = {split: {} for split in SPLITS} | existing_names(folder)
    for split, classes in splits.items():
        for name, models in classes.items():
            for kind in ("images", "voxels"):
                _write_npz(folder / f"{name}_{split}_{kind}.npz", [object_file(m, folder) for m in models], kind)
            names[split][name] = [model.name for model in models]
    frame = {"distance": DISTANCE, "elevation": ELEVATION, "viewing_angle": VIEWING_ANGLE, "longest_side": 1.0}
    description = {
        "names": names,
        "settings": asdict(settings) | frame | {"azimuth": f"-360 k / {settings.views} of view k"},
        "voxel_axes": "(y, x, -z) of the frame of the views, which is (y, -z, x) of the model, y up",
        "versions": {"neural_renderer": __version__, "torch": torch.__version__, "numpy": np.__version__},
        "broken": broken,
    }
    write_file(folder / DESCRIPTION, json.dumps(description, indent=1) + "\n")


def existing_names(folder: Path) -> dict[str, dict[str, list[str]]]:
    """Read the names of the objects in a data set: split → class → names; empty if there is none."""
    try:
        return json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))["names"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


def _write_npz(target: Path, objects: Sequence[Path], kind: str) -> None:
    """Write one array of all objects. Objects are read one at a time."""
    with (
        replacing(target) as fresh,
        zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive,
        archive.open("arr_0.npy", "w", force_zip64=True) as member,
    ):
        for index, path in enumerate(objects):
            try:
                with np.load(path) as arrays:
                    array = arrays[kind]
            except Exception as error:  # numpy and zipfile raise errors of many classes for damaged files
                raise ValueError(
                    f"{path}: expected a finished object, got a broken file; delete it to make the object again"
                ) from error
            if index == 0:
                shape = (len(objects), *array.shape)
                header = {"descr": array.dtype.str, "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(member, header)
            member.write(np.ascontiguousarray(array).tobytes())
