"""Reading of records: the frames that `Recorder` wrote."""

from __future__ import annotations

import base64
import io
import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ....io.cubes import bake_corners
from ....io.files import existing, reason, short
from ....io.image_formats.pictures import open_picture
from ....meshes.uv_mesh import UVMesh
from ..drawing.snapshot import Snapshot
from .recorder import BEGIN, END, FORMAT

_LARGEST = 2**29  # bytes of the arrays and images of a frame: more is a damaged file


class Record:
    """The frames of an HTML file that a `Recorder` wrote; ValueError if it is damaged or of another version.

    ``labels`` name the frames, such as "shape step 20"; ``numbers`` are points (step, value) of each curve.
    """

    def __init__(self, path: Path) -> None:
        self._path = existing(path)
        text = path.read_text(encoding="utf-8", errors="replace")
        begin = text.find(BEGIN)
        if begin < 0:
            raise ValueError(f"{path}: expected a record, got another HTML file")
        try:
            data = json.loads(text[begin + len(BEGIN) : text.index(END, begin)])
            found = data["format"]
            self._data, self._frames, self._blobs = data, data["frames"], data["blobs"]
            curves = (data["numbers"] or {}).items()
            self.numbers = {name: [(float(step), float(value)) for step, value in points] for name, points in curves}
            self.labels = [f"{frame['label']} step {frame['step']}".strip() for frame in self._frames]
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(f"{path}: expected a record, got a damaged one ({reason(error)})") from None
        if not self.labels:
            raise ValueError(f"{path}: expected a record with frames, got an empty one")
        if found != FORMAT:
            raise ValueError(f"{path}: expected a record of format {FORMAT}, got {short(found)}")

    def __len__(self) -> int:
        return len(self._frames)

    def meshes(self, number: int) -> dict[str, Snapshot]:
        """Return the meshes of a frame, from 0, by name; raise ValueError if it is damaged."""
        self._left = _LARGEST
        try:
            return {name: self._mesh(parts) for name, parts in self._frames[number]["meshes"].items()}
        except Exception as error:  # Pillow and torch raise errors of many classes
            raise ValueError(f"{self._path}: frame {number} is damaged ({reason(error)})") from None

    def _mesh(self, parts: list[dict[str, Any]]) -> Snapshot:
        vertices: list[Tensor] = []
        faces, uvs, colors, image_index = [], [], [], []
        images: list[Tensor] = []
        wraps: list[str | tuple[str, str]] = []
        first: dict[str, int] = {}  # parts may share vertices
        for part in parts:
            if part["vertices"] not in first:
                first[part["vertices"]] = sum(map(len, vertices))
                vertices.append(torch.from_numpy(self._values(part, "vertices", "levels", "")).float())
            corners = self._faces(part, len(vertices[-1]))
            count = len(corners)
            faces.append(torch.from_numpy(self._at_corners(part, corners)) + first[part["vertices"]])
            uv, color = torch.zeros(count, 3, 2), torch.tensor(part["color"]).expand(count, 3, 3)
            if "colors" in part:
                rgb = self._array(part["colors"], 3, np.uint8)
                color = torch.from_numpy(rgb[corners].astype(np.float32) / 255)
            if "image" in part:
                places = self._values(part, "uv", "uv_levels", "uv_")
                uv = torch.from_numpy(places[corners] * [1, -1] + [0, 1]).float()
                images.append(self._image(part["image"]))
                wraps.append(part["wrap"] if isinstance(part["wrap"], str) else tuple(part["wrap"]))
            image_index.append(torch.full((count,), len(images) - 1 if "image" in part else -1))
            uvs.append(uv)
            colors.append(color)
        joined, all_faces, all_colors = torch.cat(vertices), torch.cat(faces).int(), torch.cat(colors).contiguous()
        if len(all_faces) and not 0 <= int(all_faces.min()) <= int(all_faces.max()) < len(joined):
            raise ValueError("a face has a vertex that is not there")
        if images:
            index = torch.cat(image_index)
            mesh = UVMesh(joined, all_faces, torch.cat(uvs), index, tuple(images), all_colors, tuple(wraps))
            return Snapshot(joined, all_faces, None, mesh)
        if any("colors" in part for part in parts):
            return Snapshot(joined, all_faces, bake_corners(all_colors, 2))
        return Snapshot(joined, all_faces, all_colors[:, :1, None, None].contiguous())

    def _values(self, part: dict[str, Any], name: str, levels: str, prefix: str) -> np.ndarray:
        """Decode the vertices [V, 3] or the texture coordinates [N, 2] of a part."""
        low, size = np.array(part[f"{prefix}low"]), np.array(part[f"{prefix}size"])
        return low + size * (self._array(part[name], len(low), np.uint16) / self._data[levels])

    def _faces(self, part: dict[str, Any], vertices: int) -> np.ndarray:
        if "index" in part:
            return self._array(part["index"], 1, np.uint32).reshape(-1, 3).astype(np.int64)
        count = len(self._array(part["corners"], 1, np.uint32)) if "corners" in part else vertices
        return np.arange(count).reshape(-1, 3)

    def _at_corners(self, part: dict[str, Any], corners: np.ndarray) -> np.ndarray:
        """Convert indices of drawn positions to indices of vertices, [F, 3]."""
        if "corners" not in part:
            return corners
        return self._array(part["corners"], 1, np.uint32).reshape(-1).astype(np.int64)[corners]

    def _array(self, name: str, columns: int, kind: type[np.unsignedinteger[Any]]) -> np.ndarray:
        """Decode an array [N, columns]; see `recorder._planes`."""
        unpacked = zlib.decompressobj()
        data = unpacked.decompress(base64.b64decode(self._blobs[name]), self._left + 1)
        self._spend(len(data))
        planes = np.frombuffer(data, np.uint8).reshape(np.dtype(kind).itemsize, -1)
        values = np.ascontiguousarray(planes.T).view(kind).reshape(columns, -1)
        return np.cumsum(values, axis=1, dtype=kind).T

    def _spend(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise ValueError(f"its arrays and images have more than {_LARGEST >> 20} MiB")

    def _image(self, name: str) -> Tensor:
        with open_picture(io.BytesIO(base64.b64decode(self._blobs[name]))) as file:
            self._spend(3 * file.width * file.height)
            return torch.from_numpy(np.asarray(file.convert("RGB")).astype(np.float32) / 255)


def is_record(path: Path) -> bool:
    """Return whether a file is a record."""
    if path.suffix.lower() not in (".html", ".htm") or not path.is_file():
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        return BEGIN in file.read(2**17)
