"""`Recorder`: the steps of a run as one HTML file that any browser opens, without Python and without a network."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ....io.atomic_write import write_file
from ....version import __version__
from ...common.options import WatchOptions
from ..drawing.glb import Drawable
from ..drawing.snapshot import Snapshot
from ..drawing.surface import Look, drawables

FORMAT = 1
"""Number of the format, in every file."""
BEGIN, END = '<script id="record" type="application/json">', "</script>"
"""Text before and after the data in a file."""
_LEVELS = 2**16 - 1  # levels of a coordinate over its extent
_PAGE = Path(__file__).with_name("record.html")
_MARK = "<!-- record -->"
_WRITING = 0.02  # share of the time that writing the file may take during a run
_LEAST_INTERVAL = 10.0  # least seconds between two writes during a run
_MOST_NUMBERS = 2000  # most steps in the curves


class Recorder:
    """Collects frames and writes them as an HTML file of ``limit`` MiB at most.

    Equal faces, texture coordinates and images of several frames are stored once. If the file would be larger than its
    limit, every second frame is left out, and from then on every second one is skipped.
    """

    def __init__(self, path: str | os.PathLike[str], limit: float = WatchOptions.record_limit) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() not in (".html", ".htm"):
            raise ValueError(f"record: expected a name that ends in .html, got {self.path.name!r}")
        if self.path.is_dir():
            raise ValueError(f"record: expected a file, got the folder {self.path}")
        page = _PAGE.read_text(encoding="utf-8")
        self._before, self._after = page.split(_MARK)
        self._most = limit * 2**20 - len(page) - 2**16
        self._frames: list[dict[str, Any]] = []
        self._blobs: dict[str, str] = {}
        self._numbers: dict[str, list[tuple[int, float]]] = {}
        self._seen, self._stride = 0, 1
        self._step = self._offset = self._earlier = 0  # steps of the curves: phases that count from 1 follow each other
        self._written, self._interval = time.monotonic(), _LEAST_INTERVAL
        self._too_large = 0
        write_file(self.path, self._content())  # fails at the start if the name cannot be written

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, step: int, meshes: Mapping[str, Snapshot], label: str = "", always: bool = False) -> None:
        """Add a frame of meshes by name; the label is what the step belongs to, such as a phase.

        Keep it ``always``, even if others of its kind are skipped, as the last one.
        """
        self._seen += 1
        if self._seen % self._stride and not always:
            return
        place = step + (self._offset if step <= self._step else self._earlier)
        frame: dict[str, Any] = {"step": step, "label": label, "place": place, "number": self._seen, "meshes": {}}
        for name, snapshot in meshes.items():
            usable, _ = snapshot.finite()
            if len(usable.faces):
                frame["meshes"][name] = [self._part(part) for part in drawables(usable, Look())]
        if self._frames and self._is_replaced(self._frames[-1], step, label):
            self._frames.pop()
        self._frames.append(frame)
        while self._size() > self._most and len(self._frames) > 1:
            self._thin_out()
        if self._size() > self._most:
            self._too_large += 1
            self._frames.clear()
            self._forget_unused()
        self._write_sometimes()

    def log(self, step: int, numbers: Mapping[str, float]) -> None:
        """Add numbers of a step, for the curves. A step that is less than the last one begins a new phase."""
        if step < self._step:
            self._earlier, self._offset = self._offset, self._offset + self._step
        self._step = step
        for name, value in numbers.items():
            self._numbers.setdefault(name, []).append((self._offset + step, value))

    def write(self) -> str:
        """Write the file; return a sentence about it."""
        content = self._content()
        write_file(self.path, content)
        count = len(self._frames)
        text = f"{self.path}: {count} {'frame' if count == 1 else 'frames'}, {len(content) / 2**20:.1f} MiB"
        if self._stride > 1:
            text += f" (every {_ordinal(self._stride)} update, to keep it below {self._most / 2**20:.0f} MiB)"
        if self._too_large:
            one = self._too_large == 1
            text += f"; {self._too_large} {'frame was' if one else 'frames were'} larger than the limit and "
            text += f"{'is' if one else 'are'} left out"
        return text

    def _is_replaced(self, last: dict[str, Any], step: int, label: str) -> bool:
        """Return whether the last frame is the same step, or was only kept because it was the last."""
        same = last["step"] == step and last["label"] == label
        return same or (len(self._frames) > 1 and last["number"] % self._stride != 0)

    def _part(self, part: Drawable) -> dict[str, Any]:
        found: dict[str, Any] = {"color": [round(value, 4) for value in part.color]}
        found["low"], found["size"], found["vertices"] = self._levels(part.vertices)
        if part.corners is not None:
            found["corners"] = self._blob(_planes(part.corners.astype(np.uint32)[:, None]))
        if part.index is not None:
            found["index"] = self._blob(_planes(part.index.astype(np.uint32).reshape(-1, 1)))
        if part.colors is not None:
            found["colors"] = self._blob(_planes(part.colors))
        if part.uv is not None and part.image is not None:
            found["uv_low"], found["uv_size"], found["uv"] = self._levels(part.uv)
            found |= {"wrap": part.wrap, "image": self._blob(part.image, compress=False)}
        return found

    def _levels(self, values: np.ndarray) -> tuple[list[float], list[float], str]:
        """Keep values [N, C] in 16 bits: return their least numbers, their extents, and the name of the bytes."""
        low, high = values.min(0).astype(float), values.max(0).astype(float)
        size = np.maximum(high - low, 1e-30)
        levels = np.rint((values - low) / size * _LEVELS).astype(np.uint16)
        return low.tolist(), size.tolist(), self._blob(_planes(levels))

    def _blob(self, data: bytes, compress: bool = True) -> str:
        """Keep bytes once; return their name."""
        name = hashlib.blake2b(data, digest_size=9).hexdigest()
        if name not in self._blobs:
            self._blobs[name] = base64.b64encode(zlib.compress(data, 6) if compress else data).decode()
        return name

    def _size(self) -> int:
        return sum(map(len, self._blobs.values())) + 700 * len(self._frames)

    def _thin_out(self) -> None:
        """Leave out every second frame, but neither the first nor the last."""
        self._stride *= 2
        *earlier, last = self._frames
        first = earlier[:1] if len(earlier) > 1 else []
        self._frames = [*first, *(one for one in earlier[1:] if not one["number"] % self._stride), last]
        self._forget_unused()

    def _forget_unused(self) -> None:
        used = {
            value
            for frame in self._frames
            for parts in frame["meshes"].values()
            for part in parts
            for value in part.values()
            if isinstance(value, str)
        }
        self._blobs = {name: blob for name, blob in self._blobs.items() if name in used}

    def _write_sometimes(self) -> None:
        """Write the file now and then, so that a killed process leaves one."""
        start = time.monotonic()
        if start - self._written > self._interval:
            self.write()
            self._written = time.monotonic()
            self._interval = max(_LEAST_INTERVAL, (self._written - start) / _WRITING)

    def _content(self) -> str:
        numbers = {name: values[:: -(-len(values) // _MOST_NUMBERS)] for name, values in self._numbers.items()}
        record = {
            "format": FORMAT,
            "version": __version__,
            "title": self.path.stem,
            "levels": _LEVELS,
            "uv_levels": _LEVELS,
            "frames": self._frames,
            "numbers": numbers,
            "blobs": self._blobs,
        }
        text = json.dumps(record, separators=(",", ":")).replace("</", "<\\/")
        return f"{self._before}{BEGIN}{text}{END}{self._after}"


def _planes(values: np.ndarray) -> bytes:
    """Make integers [N, C] easy to compress: differences from row to row, column by column, byte by byte."""
    differences = np.diff(values, axis=0, prepend=values[:1] * 0)  # wraps around
    columns = np.ascontiguousarray(differences.T)
    return np.ascontiguousarray(columns.view(np.uint8).reshape(-1, values.itemsize).T).tobytes()


def _ordinal(number: int) -> str:
    """Write a power of two, ≥ 2, as an ordinal."""
    return f"{number}{'nd' if number % 10 == 2 and number != 12 else 'th'}"
