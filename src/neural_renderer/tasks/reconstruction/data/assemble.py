"""Assembly of finished objects into the files of the published format."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from ....io.atomic_write import replacing, write_file
from ....version import __version__
from .arrays import DESCRIPTION, SPLITS
from .dataset import Settings, object_file
from .framing import DISTANCE, ELEVATION, VIEWING_ANGLE
from .models_folder import Model


def assemble(
    folder: Path,
    splits: dict[str, dict[str, list[Model]]],
    settings: Settings,
    broken: dict[str, str],
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
