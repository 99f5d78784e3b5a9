"""Arrays of numbers in a glTF file: buffers, views, accessors with their sparse changes."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from typing import Any

import numpy as np

from ..files import short
from .reader import CHUNK, HEADER, dicts, item

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MOST = 1 << 28  # numbers in an array without data, which a few bytes of JSON can ask for


class Accessors:
    """The arrays of a file by their numbers.

    ``tree`` is its JSON, ``data`` its content, and ``resolve`` returns the content of a file beside it by its URI.
    """

    def __init__(self, tree: dict[str, Any], data: bytes, is_binary: bool, resolve: Callable[[str], bytes]) -> None:
        self._tree, self._resolve = tree, resolve
        self._buffers: dict[int, bytes] = {}
        if is_binary:
            length = int.from_bytes(data[HEADER : HEADER + 4], "little")
            self._buffers[0] = data[HEADER + CHUNK + length + CHUNK :]

    def check(self) -> None:
        """Raise ValueError if an array does not fit its buffer."""
        for number in range(len(dicts(self._tree, "accessors"))):
            self._stored(number)

    def read(self, number: Any, width: int | None = None) -> np.ndarray:
        """Read an array [count, numbers of an element]: float64 where it holds or stands for floats, else integers.

        Raises ValueError if it has another ``width`` or does not fit its buffer.
        """
        values, found = self._stored(number)
        if width not in (None, values.shape[1]):
            raise ValueError(f"accessor {number}: expected {width} numbers in an element, got {values.shape[1]}")
        if "sparse" in found:
            values = values.copy()
            self._change(f"accessor {number}", values, found["sparse"])
        if values.dtype.kind == "f":
            return values.astype(np.float64)
        if found.get("normalized"):
            return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values

    def _stored(self, number: Any) -> tuple[np.ndarray, dict[str, Any]]:
        """View an array in its buffer, zeros without one; return it with its entry."""
        found = item(self._tree, "accessors", number)
        kind, columns = found.get("componentType"), _WIDTHS.get(found.get("type"))
        count = found.get("count")
        if kind not in _TYPES or columns is None or not isinstance(count, int) or count < 0:
            raise ValueError(f"accessor {number}: expected a type and a count of glTF, got {short(found)}")
        if "bufferView" in found:
            values = self._elements(f"accessor {number}", found, _TYPES[kind], count, columns)
        elif count * columns > _MOST:
            raise ValueError(f"accessor {number}: expected at most {_MOST} numbers without data, got {count * columns}")
        else:
            values = np.zeros((count, columns), _TYPES[kind])
        return values, found

    def _change(self, what: str, values: np.ndarray, sparse: Any) -> None:
        """Set the elements that a sparse accessor lists."""
        count, places = sparse["count"], sparse["indices"]
        index = self._elements(what, places, _TYPES[places["componentType"]], count, 1)[:, 0]
        if len(index) and index.max() >= len(values):
            raise ValueError(f"{what}: expected sparse indices below {len(values)}, got {index.max()}")
        values[index] = self._elements(what, sparse["values"], values.dtype.str, count, values.shape[1])

    def _elements(self, what: str, place: Any, kind: str, count: int, columns: int) -> np.ndarray:
        """View elements [count, columns] of a type in the buffer that ``place`` names."""
        view = item(self._tree, "bufferViews", place["bufferView"])
        buffer = self._buffer(view["buffer"])
        begin = view.get("byteOffset", 0) + place.get("byteOffset", 0)
        size = np.dtype(kind).itemsize
        step = view.get("byteStride") or columns * size
        end = view.get("byteOffset", 0) + view["byteLength"]
        last = begin + (count - 1) * step + columns * size
        if count and not (begin >= 0 and step > 0 and last <= min(end, len(buffer))):
            raise ValueError(f"{what}: expected data within the {len(buffer)} bytes of its buffer, got bytes to {last}")
        return np.ndarray((count, columns), kind, buffer, begin if count else 0, (step, size))

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            uri = str(item(self._tree, "buffers", number)["uri"])
            head, _, content = uri.partition(",")
            if not uri.startswith("data:"):
                self._buffers[number] = self._resolve(uri)
            elif not head.endswith(";base64"):
                raise ValueError(f"buffer {number}: expected base64 in its URI, got {short(head)}")
            else:
                try:
                    self._buffers[number] = base64.b64decode(content)
                except binascii.Error as error:
                    raise ValueError(f"buffer {number}: expected base64 in its URI, got {error}") from error
        return self._buffers[number]
