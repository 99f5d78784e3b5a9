"""From 3D models to the data that single-image reconstruction is trained and measured on."""

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
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....io import load_mesh
from ....io.atomic_write import replacing, write_file
from ....rendering import render
from ....version import __version__
from .arrays import DESCRIPTION, SPLITS
from .drawing import shoulder_light
from .framing import DISTANCE, ELEVATION, GRID, SIZE, VIEWING_ANGLE, VIEWS, mirrored, unit, view_camera
from .models_folder import Model, is_mesh
from .voxels import solid

_GREY = 0.75  # of models without a colour
_DARKEST = 0.08  # no paint reflects less, and on pure black no shape shows
_TEXELS = 4_000_000  # of a whole model, at most
_RECIPE = 1  # of a finished object: another number renders all anew


@dataclass(frozen=True)
class Settings:
    """How objects are rendered: ``views`` around them, of ``size`` pixels, each the mean of ``samples`` x ``samples``.

    ``grid`` is the voxels' number along each side. Published data have the defaults, and training asks for them.
    """

    views: int = VIEWS
    size: int = SIZE
    samples: int = 6
    grid: int = GRID


@torch.no_grad()
def render_views(
    vertices: Tensor, faces: Tensor, textures: Tensor | None = None, settings: Settings = Settings()
) -> Tensor:
    """The views of an object: uint8 [K, 4, S, S], red, green, blue and alpha, colours not multiplied by alpha.

    vertices: [V, 3] in the frame of reconstruction (see `framing`); faces: [F, 3]; textures: as `render` takes them, or
    None for grey.
    """
    if textures is None:
        textures = torch.full((len(faces), 2, 2, 2, 3), _GREY)
    textures = _DARKEST + (1 - _DARKEST) * textures
    pictures = []
    for view in range(settings.views):
        camera = view_camera(torch.tensor([view]), settings.views)
        light = shoulder_light(camera, 0.56)
        size = settings.size * settings.samples
        images = render(
            (vertices, faces, textures), camera, size, light=light, outputs=("rgb", "alpha"), anti_aliasing=False
        )
        alpha = F.avg_pool2d(images.alpha[:, None], settings.samples)  # type: ignore[index]
        # On black, the mean is multiplied by alpha; what is seen has the mean colour of the samples that see it.
        rgb = F.avg_pool2d(images.rgb, settings.samples) / alpha.clamp(min=1e-6)  # type: ignore[arg-type]
        pictures.append(torch.cat((rgb.clamp(0, 1) * (alpha > 0), alpha), 1))
    return (torch.cat(pictures) * 255 + 0.5).to(torch.uint8)


def make_object(path: Path, settings: Settings = Settings(), allow_outside: bool = False) -> tuple[Tensor, Tensor]:
    """The views (see `render_views`) and the voxels (see `voxels.solid`) of a model in a file, its box's side made 1.

    allow_outside: as in `load_mesh`. Raises ValueError, with the file's name, for one that cannot be read or shows
    nothing.
    """
    vertices, faces, textures = load_mesh(path, 2, allow_outside)
    if textures is not None:
        texture_size = min(16, int((_TEXELS / len(faces)) ** (1 / 3)))
        textures = load_mesh(path, texture_size, allow_outside)[2] if texture_size > 2 else textures
    used = torch.unique(faces.long())  # stray vertices belong to no surface
    try:
        vertices = mirrored(vertices.index_copy(0, used, unit(vertices[used])))
        images = render_views(vertices, faces, textures, settings)
        if not images[:, 3].any():
            raise ValueError("faces: expected a surface that can be seen, got none in any view")
        return images, solid(vertices, faces, settings.grid)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def make_objects(
    models: Sequence[Model], folder: Path, settings: Settings, processes: int, allow_outside: bool = False
) -> Iterator[tuple[Model, str | None, list[str]]]:
    """Make objects in several processes, or (0) in this one; each has a file of its own below ``folder``.

    What is there already stays. Yields each model as it is done, with None or a sentence that says why it could not be
    made, and warnings about it. ``allow_outside``: as in `load_mesh`.
    """
    waiting: dict[Model, str] = {}
    for model, key in _keys(models, settings, allow_outside).items():
        notes = _made(model, folder, key)
        if notes is not None:
            yield model, None, notes
        elif processes == 0:
            yield model, *_make_file(model, folder, settings, key, allow_outside)
        else:
            waiting[model] = key
    while waiting:
        # A process that dies takes its pool with it; whose fault it was shows when one after the other is tried.
        for count in dict.fromkeys((processes, 1)):
            crashed = False
            with _pool(count) as pool:
                futures = {
                    pool.submit(_make_file, model, folder, settings, key, allow_outside): model
                    for model, key in waiting.items()
                }
                try:
                    for future in as_completed(futures):
                        problem, notes = future.result()
                        del waiting[futures[future]]
                        yield futures[future], problem, notes
                except BrokenProcessPool:
                    crashed = True
            if not crashed:
                return
        culprit = next(iter(waiting))
        del waiting[culprit]
        yield culprit, f"{culprit.path}: its process died, perhaps for lack of memory", []


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _begin, (os.getpid(),))
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin(parent: int) -> None:
    """A worker: one thread, Ctrl-C is its parent's business, and it does not outlive a parent that was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def object_file(model: Model, folder: Path) -> Path:
    """Where a finished object is kept."""
    return folder / "objects" / model.category / f"{model.name}.npz"


def _keys(models: Sequence[Model], settings: Settings, allow_outside: bool) -> dict[Model, str]:
    """What tells for each model whether it has changed: its file, and the materials and pictures that lie around it.

    Of a folder with several models each has what is named like it, and what is named like none of them.
    """
    together: dict[Path, list[Model]] = {}
    for model in models:
        own = next((folder for folder in model.path.parents if folder.name == model.name), model.path.parent)
        together.setdefault(own, []).append(model)
    keys = {}
    for folder, here in together.items():
        names = [path.stem for path in folder.iterdir() if is_mesh(path)]
        around: dict[str | None, list[Any]] = {}
        for path in sorted(path for path in folder.rglob("*") if path.is_file() and not is_mesh(path)):
            owner = max((name for name in names if path.name.startswith(name)), key=len, default=None)
            around.setdefault(owner, []).append((str(path), _stamp(path)))
        for model in here:
            own_files = around.get(model.path.stem, []), around.get(None, [])
            recipe = [_RECIPE, asdict(settings), *_stamp(model.path), zlib.crc32(repr(own_files).encode())]
            recipe += ["allow_outside"] if allow_outside else []
            keys[model] = json.dumps(recipe)
    return {model: keys[model] for model in models}


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_size, status.st_mtime_ns


def _made(model: Model, folder: Path, key: str) -> list[str] | None:
    """The warnings about an object that is there already; None if it is to be made."""
    try:
        with np.load(object_file(model, folder)) as arrays:
            return arrays["notes"].tolist() if str(arrays["key"]) == key else None
    except Exception:  # none, or broken in any way
        return None


def _make_file(
    model: Model, folder: Path, settings: Settings, key: str, allow_outside: bool
) -> tuple[str | None, list[str]]:
    target = object_file(model, folder)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            images, voxels = make_object(model.path, settings, allow_outside)
        except Exception as error:  # whatever a model is broken by, the others are not
            told = isinstance(error, (ValueError, OSError)) and str(error)
            return (str(error) if told else f"{model.path}: {type(error).__name__}: {error}"), []
    notes = sorted({str(warning.message) for warning in caught})
    arrays: dict[str, Any] = {"images": images.numpy(), "voxels": voxels.numpy(), "notes": np.array(notes, np.str_)}
    with replacing(target) as fresh, open(fresh, "wb") as file:
        np.savez_compressed(file, key=np.array(key), **arrays)
    return None, notes


def assemble(
    folder: Path,
    splits: dict[str, dict[str, list[Model]]],
    settings: Settings,
    broken: dict[str, str],
) -> None:
    """Put finished objects together as the published files, and describe them in dataset.json.

    splits: the models of each class, in order, of each split. Classes and splits that are not among them stay as they
    are in a folder that has them already.
    """
    names: dict[str, dict[str, list[str]]] = {split: {} for split in SPLITS} | names_before(folder)
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


def names_before(folder: Path) -> dict[str, dict[str, list[str]]]:
    """The names of the objects by split and class that a folder of data holds already."""
    try:
        return json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))["names"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


def _write_npz(target: Path, objects: Sequence[Path], kind: str) -> None:
    """One array of all objects, read and written one at a time."""
    with (
        replacing(target) as fresh,
        zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive,
        archive.open("arr_0.npy", "w", force_zip64=True) as member,
    ):
        for index, path in enumerate(objects):
            try:
                with np.load(path) as arrays:
                    array = arrays[kind]
            except Exception as error:  # numpy's and zipfile's errors for broken files are of many kinds
                raise ValueError(
                    f"{path}: expected a finished object, got a broken file; without it, it is made anew"
                ) from error
            if index == 0:
                _write_header(member, array, len(objects))
            member.write(np.ascontiguousarray(array).tobytes())


def _write_header(member: IO[bytes], array: np.ndarray, count: int) -> None:
    header = {"descr": array.dtype.str, "fortran_order": False, "shape": (count, *array.shape)}
    np.lib.format.write_array_header_1_0(member, header)
