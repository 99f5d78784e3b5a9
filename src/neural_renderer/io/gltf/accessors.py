"""Arrays of numbers in a glTF file: buffers, views, accessors with their sparse changes (section 3.6 of the spec)."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np

from ..files import short
from .decoders import meshopt_view
from .tree import GltfError, as_object, child, dicts, extension, item, whole

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SHAPES = {
    "SCALAR": (1, 1),
    "VEC2": (1, 2),
    "VEC3": (1, 3),
    "VEC4": (1, 4),
    "MAT2": (2, 2),
    "MAT3": (3, 3),
    "MAT4": (4, 4),
}
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_MOST = 1 << 26  # numbers in an array without data, which a few bytes of JSON can declare
_MOST_URI = 1 << 16  # characters of the name of a file

Resolve = Callable[[str], bytes]
"""Returns the content of a file beside the glTF file by its URI."""


class Accessors:
    """The arrays of a file by their numbers; ``tree`` is its JSON, and ``binary`` the binary chunk of a GLB file."""

    def __init__(self, tree: dict[str, Any], binary: bytes | None, resolve: Resolve) -> None:
        self._tree, self._binary, self._resolve = tree, binary, resolve
        self._buffers: dict[int, bytes] = {}
        self._decoded: dict[int, bytes] = {}

    def count(self, number: Any) -> int:
        """Return the number of elements of an array."""
        return whole(item(self._tree, "accessors", number), "count")

    def has_data(self, number: Any) -> bool:
        """Test whether an array is stored in the file, in full or in part."""
        found = item(self._tree, "accessors", number)
        return "bufferView" in found or "sparse" in found

    def read(self, number: Any, *widths: int) -> np.ndarray:
        """Read an array [count, numbers of an element]: floats where it holds or stands for floats, else integers.

        Raises GltfError if an element has another number of numbers than ``widths`` allow, or it does not fit its
        buffer. The array may be a view of the file.
        """
        return self.floats(number, self.stored(number, *widths))

    def stored(self, number: Any, *widths: int) -> np.ndarray:
        """Read an array as `read`, with its numbers as they are stored."""
        what, found = f"accessor {number}", item(self._tree, "accessors", number)
        kind, shape = _form(what, found)
        count, width = whole(found, "count"), shape[0] * shape[1]
        if widths and width not in widths:
            expected = " or ".join(map(str, widths))
            raise GltfError(f"{what}: expected {expected} numbers in an element, got {width}")
        if "bufferView" in found:
            values = self._elements(what, found, kind, count, shape)
        elif count * width > _MOST:
            raise GltfError(f"{what}: expected at most {_MOST} numbers without data, got {count * width}")
        else:
            values = np.zeros((count, width), kind)
        if "sparse" in found:
            return self._changed(what, values, as_object(found["sparse"], what), shape)
        return values

    def floats(self, number: Any, values: np.ndarray) -> np.ndarray:
        """Convert the stored numbers of an array to those that they stand for."""
        if values.dtype.kind != "f" and item(self._tree, "accessors", number).get("normalized") is True:
            return np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)
        return values

    def dtype(self, number: Any) -> np.dtype[Any]:
        """Return the type of the stored numbers of an array."""
        return np.dtype(_form(f"accessor {number}", item(self._tree, "accessors", number))[0])

    def size(self) -> int:
        """Count the bytes of all buffers."""
        count = len(dicts(self._tree, "buffers"))
        return sum(len(self._buffer(number)) for number in range(count) if self._has_bytes(number))

    def view(self, number: Any) -> memoryview:
        """Return the bytes of a view, decoded."""
        content, begin, length, _ = self._place(number)
        return memoryview(content)[begin : begin + length]

    def _changed(self, what: str, values: np.ndarray, sparse: dict[str, Any], shape: tuple[int, int]) -> np.ndarray:
        """Copy an array with the elements set that its sparse part lists."""
        count, places = whole(sparse, "count"), child(sparse, "indices")
        kind = _TYPES.get(whole(places, "componentType"), "")
        if kind not in ("u1", "<u2", "<u4"):
            raise GltfError(f"{what}: expected whole numbers ≥ 0 as sparse indices, got {short(places)}")
        index = self._elements(what, places, kind, count, (1, 1))[:, 0]
        if len(index) and index.max() >= len(values):
            raise GltfError(f"{what}: expected sparse indices below {len(values)}, got {index.max()}")
        values = values.copy()
        values[index] = self._elements(what, child(sparse, "values"), values.dtype.str, count, shape)
        return values

    def _elements(self, what: str, place: dict[str, Any], kind: str, count: int, shape: tuple[int, int]) -> np.ndarray:
        """View elements [count, numbers] of a type in the view that ``place`` names."""
        content, start, length, stride = self._place(place.get("bufferView"))
        size = np.dtype(kind).itemsize
        columns, rows = shape
        column = (
            rows * size if columns == 1 else -(-rows * size // 4) * 4
        )  # columns of matrices begin at multiples of 4
        step = stride or columns * column
        offset = whole(place, "byteOffset", 0)
        last = offset + (count - 1) * step + (columns - 1) * column + rows * size
        if count and last > min(length, len(content) - start):
            available = max(0, min(length, len(content) - start))
            raise GltfError(f"{what}: expected data within the {available} bytes of its view, got bytes to {last}")
        begin = start + offset if count else 0
        strides = (step, column, size)
        return np.ndarray((count, columns, rows), kind, content, begin, strides).reshape(count, columns * rows)

    def _place(self, number: Any) -> tuple[bytes, int, int, int]:
        """Find the bytes of a view: content, where it begins there, its length, and its stride or 0."""
        view, what = item(self._tree, "bufferViews", number), f"view {number}"
        stride = whole(view, "byteStride", 0)
        for name in _MESHOPT:
            packed = extension(view, name)
            if packed is not None:
                content = self._unpacked(number, view, packed, name)
                if content is not None:
                    return content, 0, len(content), whole(packed, "byteStride")
        begin, length = whole(view, "byteOffset", 0), whole(view, "byteLength")
        content = self._buffer(view.get("buffer"))
        if begin + length > len(content):
            raise GltfError(
                f"{what}: expected data within the {len(content)} bytes of its buffer, got {begin + length}"
            )
        return content, begin, length, stride

    def _unpacked(self, number: int, view: dict[str, Any], packed: dict[str, Any], name: str) -> bytes | None:
        """Decode a compressed view; None if the library for it is missing and the file has the bytes unpacked, too."""
        if number not in self._decoded:
            begin, length = whole(packed, "byteOffset", 0), whole(packed, "byteLength")
            content = self._buffer(packed.get("buffer"))[begin : begin + length]
            if len(content) < length:
                raise GltfError(f"view {number}: expected {length} bytes of {name}, got {len(content)}")
            try:
                self._decoded[number] = meshopt_view(f"view {number}", content, packed, name)
            except ModuleNotFoundError:
                if not self._has_bytes(view.get("buffer")):
                    raise
                return None
        return self._decoded[number]

    def _has_bytes(self, number: Any) -> bool:
        """Test whether a buffer has bytes, and is no placeholder of compressed views."""
        buffer = item(self._tree, "buffers", number)
        return "uri" in buffer or (number == 0 and self._binary is not None)

    def _buffer(self, number: Any) -> bytes:
        entry = item(self._tree, "buffers", number)
        if number not in self._buffers:
            if "uri" in entry:
                self._buffers[number] = uri_content(f"buffer {number}", entry["uri"], self._resolve)
            elif number == 0 and self._binary is not None:
                self._buffers[number] = self._binary
            else:
                raise GltfError(f"buffer {number}: expected a URI or a binary chunk, got neither")
        return self._buffers[number]


def uri_content(what: str, uri: Any, resolve: Resolve) -> bytes:
    """Return the content of a data URI, or of a file."""
    if not isinstance(uri, str):
        raise GltfError(f"{what}: expected a text as its URI, got {short(uri)}")
    head, comma, content = uri.partition(",")
    if not uri.startswith("data:"):
        if len(uri) > _MOST_URI:
            raise GltfError(f"{what}: expected the name of a file as its URI, got {len(uri)} characters")
        return resolve(uri)
    if not comma:
        raise GltfError(f"{what}: expected data after a comma in its URI, got {short(uri)}")
    plain = unquote_to_bytes(content) if "%" in content or not head.endswith(";base64") else content.encode()
    if not head.endswith(";base64"):
        return plain
    try:
        return base64.b64decode(plain + b"=" * (-len(plain) % 4))
    except binascii.Error:
        raise GltfError(f"{what}: expected base64 in its URI, got other characters") from None


def _form(what: str, found: dict[str, Any]) -> tuple[str, tuple[int, int]]:
    """Return the type of an accessor's numbers, and the columns and rows of an element."""
    kind, shape = found.get("componentType"), found.get("type")
    if not isinstance(kind, int) or kind not in _TYPES or not isinstance(shape, str) or shape not in _SHAPES:
        raise GltfError(f"{what}: expected a type and a count of glTF, got {short(found)}")
    return _TYPES[kind], _SHAPES[shape]
