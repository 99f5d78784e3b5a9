"""Views in the shards of a data set, as arrays for training: pictures are decoded on access."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....io.files import reason
from ....io.image_formats.pictures import open_picture
from ...many.dataset import DESCRIPTION
from ...many.shards import MANIFEST, SHARDS
from .framing import ELEVATION, SIZE, VIEWING_ANGLE, VIEWS
from .models_folder import Model, default_splits

_PICTURE = "rgba.png"
_BLOCK = 512  # bytes of a header in a tar
_MANIFEST_FILE = "manifest.json"  # of a finished data set


class ObjectViews:
    """Views of an object, like a uint8 array [24, 4, 64, 64]; ``views[k]`` decodes one of them."""

    def __init__(self, places: Sequence[tuple[Path, int]]) -> None:
        self._places = places

    def __getitem__(self, view: Any) -> np.ndarray:
        if not isinstance(view, (int, np.integer)):
            return self.copy()[view]
        path, offset = self._places[int(view)]
        try:
            with path.open("rb") as tar:
                tar.seek(offset)
                size = int(tar.read(_BLOCK)[124:136].rstrip(b"\0 "), 8)
                pixels = np.asarray(open_picture(io.BytesIO(tar.read(size))))
            if pixels.shape != (SIZE, SIZE, 4):
                raise ValueError(f"a picture of shape {pixels.shape}")
        except Exception as error:  # Pillow raises errors of many classes
            raise ValueError(f"{path}: expected pictures of {SIZE} pixels at {offset}, got {reason(error)}") from None
        return pixels.transpose(2, 0, 1)

    def copy(self) -> np.ndarray:
        """Decode all views."""
        return np.stack([self[view] for view in range(len(self._places))])


class ShardImages:
    """Objects of a class, like a uint8 array [N, 24, 4, 64, 64]."""

    def __init__(self, objects: Sequence[Sequence[tuple[Path, int]]]) -> None:
        self._objects = objects

    def __len__(self) -> int:
        return len(self._objects)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple):
            return self[index[0]][index[1] if len(index) == 2 else index[1:]]
        return ObjectViews(self._objects[index])


def is_shards(folder: Path) -> bool:
    """Return whether a folder is a finished data set of `neural-renderer dataset`."""
    return (folder / DESCRIPTION).is_file() and (folder / _MANIFEST_FILE).is_file()


def open_shards(folder: Path) -> tuple[dict[str, dict[str, ShardImages]], dict[str, dict[str, tuple[str, ...]]]]:
    """Open the data set of `neural-renderer dataset` in a folder: images and names of objects, by split and class.

    The class of a model is the first part of its name, and the splits are those of `default_splits`. Cameras must be
    those of the reconstruction frame: ``--views 24 --size 64 --azimuth 90 --elevation 30 --viewing-angle 15 --distance
    5.464``, with rgba.png as first output. ValueError: The settings are others, or an entry is damaged.
    """
    description = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
    cameras = description.get("cameras", {})
    wanted = {
        "kind": "orbit",
        "views": VIEWS,
        "azimuth": 90.0,
        "elevation": [ELEVATION],
        "viewing_angle": VIEWING_ANGLE,
    }
    found = {name: cameras.get(name) for name in wanted}
    others = {"size": [SIZE, SIZE], "layout": "shards", "sample": "view", "normalize": True}
    different = [name for name, value in (wanted | others).items() if (found | description).get(name) != value]
    if abs((cameras.get("distance") or 0) - 5.464) > 1e-3:
        different.append("distance")
    if (description.get("outputs") or [""])[0] != _PICTURE:
        different.append("outputs")
    if different:
        raise ValueError(
            f"{folder}: expected views of the reconstruction frame, with rgba.png as first output, views 24, size 64, "
            "azimuth 90, elevation 30, viewing_angle 15 and distance 5.464; got another "
            f"{different[0]}"
        )
    places: dict[str, list[tuple[Path, int]]] = {}
    for path in sorted((folder / MANIFEST).glob("*.json")):
        try:
            entry = json.loads(path.read_text(encoding="utf-8"))
            for row in entry["samples"]:
                tar = folder / SHARDS / f"{entry['shard']}.tar"
                places.setdefault(row["model"], []).append((tar, int(row["offset"])))
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"{path}: expected an entry of a shard, got {reason(error)}") from None
    models = [Model(name.partition("/")[0], name.partition("/")[2] or name, folder) for name in places]
    names: dict[str, dict[str, list[str]]] = {}
    for (category, name), split in sorted(default_splits(models).items()):
        names.setdefault(split, {}).setdefault(category, []).append(name)
    images = {
        split: {
            category: ShardImages(
                [places[f"{category}/{name}" if f"{category}/{name}" in places else name] for name in objects]
            )
            for category, objects in classes.items()
        }
        for split, classes in names.items()
    }
    return images, {split: {c: tuple(objects) for c, objects in classes.items()} for split, classes in names.items()}
