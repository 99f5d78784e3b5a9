"""Compressed parts of glTF files, decoded by libraries of the extra "compressed"; sizes are checked before."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from PIL import Image

from ..files import import_library, reason, short
from ..memory_limit import memory_within
from .tree import GltfError, whole

MOST_ELEMENTS = 1 << 25
"""Most faces, vertices or elements of a view to decode; as with pictures, a small file can declare many."""
_MOST_BYTES = 1 << 30
_MOST_MEMORY = 1 << 32  # bytes while a mesh of Draco is decoded; its header has no widths of attributes
_MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
_FILTERS = ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR")
KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"
"""First bytes of a KTX 2.0 file."""
_KTX2_HEADER = 104  # bytes, with the place of the first level


def meshopt_view(what: str, data: bytes, packed: dict[str, Any], name: str) -> bytes:
    """Decode a view that EXT_meshopt_compression, or the extension of KHR of this ``name``, describes."""
    library = import_library("meshopt", f"to read {name}")
    count, stride = whole(packed, "count"), whole(packed, "byteStride")
    mode, kind = packed.get("mode"), packed.get("filter", "NONE")
    if mode not in _MODES or kind not in _FILTERS:
        raise GltfError(f"{what}: expected a mode and filter of {name}, got {short(mode)} and {short(kind)}")
    fits = 4 <= stride <= 256 and stride % 4 == 0 if mode == "ATTRIBUTES" else stride in (2, 4)
    if not fits or (kind in ("OCTAHEDRAL", "COLOR") and stride not in (4, 8)) or (kind == "QUATERNION" and stride != 8):
        raise GltfError(f"{what}: expected a stride that fits {mode} of {name}, got {stride}")
    if count > MOST_ELEMENTS or count * stride > _MOST_BYTES or (mode == "TRIANGLES" and count % 3):
        raise GltfError(f"{what}: expected at most {MOST_ELEMENTS} elements of {name}, got {count}")
    if not count:
        return b""
    try:
        return np.asarray(library.decode_gltf_buffer(data, count, stride, mode, kind)).tobytes()
    except Exception as error:
        raise GltfError(f"{what}: expected data of {name}, got others") from error


def draco_mesh(what: str, data: bytes) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Decode KHR_draco_mesh_compression: faces [F, 3], and attributes [V, N] by their numbers in the extension."""
    library = import_library("DracoPy", "to read KHR_draco_mesh_compression")
    sizes = _draco_sizes(data)
    if sizes is None:
        raise GltfError(f"{what}: expected KHR_draco_mesh_compression of a mesh, got other data")
    if max(sizes) > MOST_ELEMENTS:
        raise GltfError(f"{what}: expected at most {MOST_ELEMENTS} faces and vertices of Draco, got {max(sizes)}")
    try:
        with memory_within(_MOST_MEMORY):
            mesh = library.decode(data)
        faces = np.asarray(mesh.faces).reshape(-1, 3).astype(np.int64)
        return faces, {int(one["unique_id"]): np.asarray(one["data"]) for one in mesh.attributes}
    except Exception as error:
        most = f"{_MOST_MEMORY / 2**30:g} GiB"
        raise GltfError(
            f"{what}: expected a mesh of KHR_draco_mesh_compression within {most}, got damaged data or more"
        ) from error


def _draco_sizes(data: bytes) -> tuple[int, int] | None:
    """Read the numbers of faces and vertices from the header of a mesh in Draco's bitstream 2.2; None for others."""
    try:
        if data[:5] != b"DRACO" or data[5] != 2 or data[6] != 2 or data[7] != 1:
            return None
        place = 11
        if int.from_bytes(data[9:11], "little") & 0x8000:
            place = _after_metadata(data, place)
        if data[8] == 1:  # edgebreaker: the kind of traversal comes first
            vertices, place = _varint(data, place + 1)
            return _varint(data, place)[0], vertices
        faces, place = _varint(data, place)
        return faces, _varint(data, place)[0]
    except IndexError:
        return None


def _after_metadata(data: bytes, place: int) -> int:
    attributes, place = _varint(data, place)
    for _ in range(attributes):
        _, place = _varint(data, place)
        place = _after_element(data, place)
    return _after_element(data, place)


def _after_element(data: bytes, place: int) -> int:
    waiting = 1  # elements, each followed by those below it
    while waiting:
        entries, place = _varint(data, place)
        for _ in range(entries):
            place += 1 + data[place]
            size, place = _varint(data, place)
            place += size
        below, place = _varint(data, place)
        waiting += below - 1
    return place


def _varint(data: bytes, place: int) -> tuple[int, int]:
    """Read a number in groups of seven bits; return also the place after it."""
    value = 0
    for shift in range(0, 64, 7):
        value |= (data[place] & 127) << shift
        place += 1
        if not data[place - 1] & 128:
            break
    return value, place


def basis_picture(what: str, data: bytes) -> Image.Image:
    """Decode a picture of KHR_texture_basisu, a KTX 2.0 file of Basis Universal."""
    if data[:12] != KTX2 or len(data) < _KTX2_HEADER:
        raise GltfError(f"{what}: expected a KTX 2.0 file of KHR_texture_basisu, got other data")
    width, height = struct.unpack_from("<II", data, 20)
    unpacked = struct.unpack_from("<Q", data, 96)[0]
    limit = Image.MAX_IMAGE_PIXELS
    if limit is not None and max(width * height, unpacked // 2) > limit * 3 // 4:
        raise GltfError(f"{what}: expected a picture of at most {limit * 3 // 4:,} pixels, got {width} x {height}")
    library = import_library("opengl_basisu", "to read KHR_texture_basisu")
    try:
        texture = library.open(data)
        pixels = np.asarray(texture.transcode("rgba8").data)
    except Exception as error:
        raise GltfError(
            f"{what}: expected a picture of KHR_texture_basisu, got one that cannot be read ({reason(error)})"
        ) from error
    return Image.fromarray(np.ascontiguousarray(pixels if texture.has_alpha else pixels[..., :3]))
