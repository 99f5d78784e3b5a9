"""Data sets from 3D models: rendered views and voxels, and their assembly into files of the published format."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....io import load_mesh
from ....io.atomic_write import replacing, write_file
from ....rendering import render
from ....version import __version__
from .arrays import DESCRIPTION, SPLITS
from .drawing import SHOULDER
from .framing import DISTANCE, ELEVATION, GRID, SIZE, VIEWING_ANGLE, VIEWS, mirror, scale_to_unit, view_camera
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
    """Settings of a data set. The defaults are the published settings; training needs them.

    Attributes:
        views: Number of views around an object.
        size: Side of the images in pixels.
        samples: Each pixel is the mean of samples × samples samples.
        grid: Voxels along each axis.
    """

    views: int = VIEWS
    size: int = SIZE
    samples: int = 6
    grid: int = GRID


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
    """Render and voxelise a model file, scaled to a longest side of 1.

    Returns:
        Views [K, 4, S, S] uint8 (see `render_views`) and voxels (see `voxels.voxelize_model`).

    Raises:
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


def make_objects(
    models: Sequence[Model], folder: Path, settings: Settings, processes: int, allow_outside: bool = False
) -> Iterator[tuple[Model, str | None, list[str]]]:
    """Render and voxelise models, one file per model in ``folder``; finished models are skipped.

    With 0 ``processes``, this process does the work. Yields each model when it is finished, with an error message or
    None, and warnings.
    """
    waiting: dict[Model, str] = {}
    for model, key in _keys(models, settings, allow_outside).items():
        notes = _finished_notes(model, folder, key)
        if notes is not None:
            yield model, None, notes
        elif processes == 0:
            yield model, *_make_file(model, folder, settings, key, allow_outside)
        else:
            waiting[model] = key
    while waiting:
        # A worker that dies breaks the whole pool. A second pass with one worker finds the model that kills it.
        for count in dict.fromkeys((processes, 1)):
            yield from _make_in_pool(waiting, folder, settings, count, allow_outside)
            if not waiting:
                return
        culprit = next(iter(waiting))
        del waiting[culprit]
        yield culprit, f"{culprit.path}: expected to render it, got a worker process that died (out of memory?)", []


def _make_in_pool(
    waiting: dict[Model, str], folder: Path, settings: Settings, processes: int, allow_outside: bool
) -> Iterator[tuple[Model, str | None, list[str]]]:
    """Make objects in worker processes until all are finished, and no longer in ``waiting``, or a worker dies."""
    with _pool(processes) as pool:
        futures = {
            pool.submit(_make_file, model, folder, settings, key, allow_outside): model
            for model, key in waiting.items()
        }
        with suppress(BrokenProcessPool):
            for future in as_completed(futures):
                problem, notes = future.result()
                del waiting[futures[future]]
                yield futures[future], problem, notes


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of worker processes; at its end, waiting tasks are cancelled."""
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _start_worker, (os.getpid(),))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _start_worker(parent: int) -> None:
    """Initialise a worker: one thread, Ctrl-C is left to the parent, and the worker ends if the parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def object_file(model: Model, folder: Path) -> Path:
    """Return the file of a finished object."""
    return folder / "objects" / model.category / f"{model.name}.npz"


def _keys(models: Sequence[Model], settings: Settings, allow_outside: bool) -> dict[Model, str]:
    """Compute a key for each model that changes with its mesh file, its materials and its images.

    In a folder with several models, a model owns the files with its name as a prefix; unmatched files belong to all.
    """
    together: dict[Path, list[Model]] = {}
    for model in models:
        own = next((folder for folder in model.path.parents if folder.name == model.name), model.path.parent)
        together.setdefault(own, []).append(model)
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


def _make_file(
    model: Model, folder: Path, settings: Settings, key: str, allow_outside: bool
) -> tuple[str | None, list[str]]:
    """Make one object; return an error message or None, and warnings."""
    target = object_file(model, folder)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            images, voxels = make_object(model.path, settings, allow_outside)
        except Exception as error:  # one broken model must not stop the others
            expected = isinstance(error, (ValueError, OSError)) and str(error)
            return (str(error) if expected else f"{model.path}: {type(error).__name__}: {error}"), []
    notes = sorted({str(warning.message) for warning in caught})
    arrays: dict[str, Any] = {"images": images.numpy(), "voxels": voxels.numpy(), "notes": np.array(notes, np.str_)}
    with replacing(target) as fresh, open(fresh, "wb") as file:
        np.savez_compressed(file, key=np.array(key), **arrays)
    return None, notes


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
