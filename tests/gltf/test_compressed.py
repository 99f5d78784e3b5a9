"""Compressed parts of glTF files: decoded where a library is installed, else a sentence with the command to install."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from tests.gltf.compare import compare
from tests.gltf.files import FACES, SQUARE, UV, File, textured
from tests.memory import takes_at_most

INSTALL = r'\(pip install "neural-renderer\[compressed\]"\)'
DRACO, MESHOPT, BASIS = "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"


def uses(file: File, name: str, required: bool = True) -> None:
    file.json["extensionsUsed"] = [name]
    if required:
        file.json["extensionsRequired"] = [name]


def draco(fallback: bool = False) -> File:
    """A square whose arrays are compressed, and with a fallback stored beside, 2 further in z."""
    library = pytest.importorskip("DracoPy")
    file = File()
    uses(file, DRACO, not fallback)
    data = library.encode(SQUARE, FACES.reshape(-1, 3), preserve_order=True, tex_coord=UV.astype(np.float64))
    mesh = library.decode(data)
    numbers = {one["attribute_type"]: one["unique_id"] for one in mesh.attributes}
    packed = {"POSITION": numbers[0], "TEXCOORD_0": numbers[3]}
    primitive = file.square(textured(file, [[[255, 0, 0]], [[0, 0, 255]]]), TEXCOORD_0=file.array(UV))
    if fallback:
        primitive["attributes"]["POSITION"] = file.array(SQUARE + [0, 0, 2], np.float32)
    else:
        for number in (*primitive["attributes"].values(), primitive["indices"]):
            del file.json["accessors"][number]["bufferView"]
    primitive["extensions"] = {DRACO: {"bufferView": file.view(data), "attributes": packed}}
    return file.scene(primitive)


def test_draco(tmp_path: Path) -> None:
    path = draco().save(tmp_path / "m.glb")
    mesh = nr.UVMesh.load(path)
    torch.testing.assert_close(mesh.vertices, torch.from_numpy(SQUARE), rtol=0, atol=2**-13)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    torch.testing.assert_close(mesh.uv[0, 0], torch.tensor([0.0, 0.0]), rtol=0, atol=1e-6)
    assert compare(path)[0] == "right"


def without(monkeypatch: pytest.MonkeyPatch, library: str) -> None:
    monkeypatch.setitem(sys.modules, library, None)  # as if it were not installed


def test_draco_without_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Never zeros: a sentence, or the arrays that are stored beside."""
    path, other = draco().save(tmp_path / "m.glb"), draco(fallback=True).save(tmp_path / "n.glb")
    assert nr.UVMesh.load(other).vertices[0, 2] == 0
    without(monkeypatch, "DracoPy")
    for load in (nr.UVMesh.load, nr.Mesh.load, nr.Rig.load):
        with pytest.raises(ValueError, match=rf"m.glb.*DracoPy .*{DRACO} {INSTALL}"):
            load(path)
    assert nr.UVMesh.load(other).vertices[0, 2] == 2


def test_draco_that_is_damaged_or_huge(tmp_path: Path) -> None:
    file = draco()
    view = file.json["bufferViews"][file.json["meshes"][0]["primitives"][0]["extensions"][DRACO]["bufferView"]]
    begin = view["byteOffset"]
    good = file.data
    assert good[begin + 8] == 0  # sequential: the number of faces follows, as a number of groups of seven bits
    file.data = good[: begin + 11] + b"\xff\xff\xff\x7f" + good[begin + 12 :]
    with pytest.raises(ValueError, match="expected at most 33554432 faces and vertices of Draco"):
        nr.UVMesh.load(file.save(tmp_path / "m.glb"))
    file.data, view["byteLength"] = good, 60
    with pytest.raises(ValueError, match=f"expected a mesh of {DRACO} within 4 GiB, got damaged"):
        nr.UVMesh.load(file.save(tmp_path / "m.glb"))
    file.data = good[:begin] + b"point" + good[begin + 5 :]
    with pytest.raises(ValueError, match=f"expected {DRACO} of a mesh"):
        nr.UVMesh.load(file.save(tmp_path / "m.glb"))


def test_draco_with_wide_attributes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """204 bytes asked for 2 GB, and could for 67: the header does not tell how wide positions are."""
    library = pytest.importorskip("DracoPy")
    file = draco()
    points = np.zeros((1_000_000, 3), np.float32)
    points[0] = 1
    data = bytearray(library.encode(points, FACES[None, :3], preserve_order=True, quantization_bits=1))
    wide = data.index(bytes([0, 9, 3, 0, 0])) + 2  # positions, float32, their number of components
    data[wide] = 255
    primitive = file.json["meshes"][0]["primitives"][0]
    primitive["extensions"][DRACO]["bufferView"] = file.view(bytes(data))
    path = file.save(tmp_path / "m.glb")
    assert path.stat().st_size < 5000
    monkeypatch.setattr("neural_renderer.io.gltf.decoders._MOST_MEMORY", 1 << 28)
    before = resource_limit()
    with (
        takes_at_most(400),
        pytest.raises(ValueError, match=r"within 0\.25 GiB, got damaged data or more"),
    ):
        nr.UVMesh.load(path)
    assert resource_limit() == before


def resource_limit() -> tuple[int, int]:
    resource = pytest.importorskip("resource")
    return resource.getrlimit(resource.RLIMIT_AS)


def meshopt(name: str = MESHOPT, fallback: bool = False) -> File:
    """A square with compressed views: filtered normals, quantised positions, triangles."""
    library = pytest.importorskip("meshopt")
    file = File()
    uses(file, name, not fallback)
    positions = np.zeros((4, 4), np.int16)
    positions[:, :3] = SQUARE * 32767
    normals = np.zeros((4, 4), np.float32)
    normals[:, 2:] = 1
    arrays = {
        "POSITION": (positions.view(np.uint8).reshape(4, 8), "NONE", 5122, True),
        "NORMAL": (library.encode_filter_oct(normals, 4, 8), "OCTAHEDRAL", 5120, True),
    }
    file.json["buffers"] = [{"byteLength": 0}, {"byteLength": 64, "extensions": {name: {"fallback": True}}}]

    def view(data: bytes, count: int, size: int, mode: str, kind: str = "NONE") -> int:
        number = file.view(data)
        packed = file.json["bufferViews"].pop()
        entry = {"buffer": 1, "byteLength": count * size}
        more = {"count": count, "byteStride": size, "mode": mode, "filter": kind}
        entry["extensions"] = {name: {**packed, **more}}
        file.json["bufferViews"].append(entry)
        return number

    attributes = {}
    for key, (rows, kind, code, normalized) in arrays.items():
        number = view(library.encode_gltf_buffer(rows, "ATTRIBUTES"), 4, rows.shape[1], "ATTRIBUTES", kind)
        entry = {"bufferView": number, "count": 4, "type": "VEC3", "componentType": code, "normalized": normalized}
        attributes[key] = file.add("accessors", entry)
    number = view(library.encode_gltf_buffer(FACES, "TRIANGLES"), 6, 2, "TRIANGLES")
    indices = file.add("accessors", {"bufferView": number, "count": 6, "type": "SCALAR", "componentType": 5123})
    return file.scene({"attributes": attributes, "indices": indices})


def saved(file: File, path: Path) -> Path:
    """Write a .gltf with its first buffer beside it, since it has two."""
    (path.parent / "data.bin").write_bytes(file.data)
    file.json["buffers"][0] = {"byteLength": len(file.data), "uri": "data.bin"}
    data, file.data = file.data, b""
    file.save(path)
    file.data = data
    return path


@pytest.mark.parametrize("name", [MESHOPT, "KHR_meshopt_compression"])
def test_meshopt(tmp_path: Path, name: str) -> None:
    path = saved(meshopt(name), tmp_path / "m.gltf")
    mesh = nr.UVMesh.load(path)
    assert mesh.vertices.tolist() == SQUARE.tolist()
    corners = SQUARE[mesh.faces.long()]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert area.tolist() == [4, 4] and mesh.normals is not None and bool((mesh.normals[..., 2] > 0.99).all())
    assert compare(path)[0] == "right"


def test_meshopt_without_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(meshopt(), tmp_path / "m.gltf")
    without(monkeypatch, "meshopt")
    with pytest.raises(ValueError, match=rf"m.gltf.*meshopt .*{MESHOPT} {INSTALL}"):
        nr.UVMesh.load(path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"count": 1 << 40}, "expected at most 33554432 elements"),
        ({"mode": "POINTS"}, "expected a mode and filter"),
        ({"byteStride": 7}, "expected a stride that fits"),
        ({"byteLength": 3}, f"expected data of {MESHOPT}, got others"),
    ],
)
def test_meshopt_that_is_damaged_or_huge(tmp_path: Path, change: dict[str, Any], sentence: str) -> None:
    file = meshopt()
    file.json["bufferViews"][0]["extensions"][MESHOPT] |= change
    with pytest.raises(ValueError, match=sentence):
        nr.UVMesh.load(saved(file, tmp_path / "m.gltf"))


def ktx2(color: tuple[int, int, int], width: int = 4, height: int = 4) -> bytes:
    """A KTX 2.0 file of one UASTC block of one colour, mode 8 of its specification."""
    bits = 0b10111 | sum(value << 5 + 8 * place for place, value in enumerate((*color, 255)))
    block = bits.to_bytes(16, "little")
    descriptor = struct.pack("<HHHHBBBBBBBBQ", 0, 0, 2, 40, 166, 1, 2, 0, 3, 3, 0, 0, 16)
    descriptor += struct.pack("<HBBBBBBII", 0, 127, 3, 0, 0, 0, 0, 0, 0xFFFFFFFF)
    descriptor = struct.pack("<I", len(descriptor) + 4) + descriptor
    begin = 104
    head = struct.pack("<9I", 0, 1, width, height, 0, 0, 1, 1, 0)
    places = struct.pack("<IIIIQQ", begin, len(descriptor), 0, 0, 0, 0)
    data = begin + len(descriptor)
    data += -data % 16
    level = struct.pack("<QQQ", data, 16, 16)
    file = b"\xabKTX 20\xbb\r\n\x1a\n" + head + places + level + descriptor
    return file + bytes(data - len(file)) + block


def basis(content: bytes, fallback: bool = False) -> File:
    file = File()
    uses(file, BASIS, not fallback)
    material = textured(file, [[[0, 0, 255]]])
    image = file.add("images", {"bufferView": file.view(content), "mimeType": "image/ktx2"})
    entry = {"extensions": {BASIS: {"source": image}}}
    file.json["textures"][0] = entry | ({"source": 0} if fallback else {})
    return file.scene(file.square(material, TEXCOORD_0=file.array(UV)))


def test_basis_universal(tmp_path: Path) -> None:
    pytest.importorskip("opengl_basisu")
    path = basis(ktx2((255, 128, 0))).save(tmp_path / "m.glb")
    (image,) = nr.UVMesh.load(path).images
    assert (image[0, 0] * 255).round().tolist() == [255, 128, 0] and image.shape == (4, 4, 3)
    assert compare(path)[0] == "right"


def test_basis_universal_without_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = basis(ktx2((255, 128, 0))).save(tmp_path / "m.glb")
    other = basis(ktx2((255, 128, 0)), fallback=True).save(tmp_path / "n.glb")
    without(monkeypatch, "opengl_basisu")
    with pytest.raises(ValueError, match=rf"m.glb.*opengl_basisu .*{BASIS} {INSTALL}"):
        nr.UVMesh.load(path)
    assert nr.UVMesh.load(other).images[0][0, 0].tolist() == [0, 0, 1]


def test_basis_universal_that_is_damaged_or_huge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=f"expected a KTX 2.0 file of {BASIS}, got other data"):
        nr.UVMesh.load(basis(b"KTX or so").save(tmp_path / "m.glb"))
    with pytest.raises(ValueError, match=r"expected a picture of at most .* pixels, got 100000 x 100000"):
        nr.UVMesh.load(basis(ktx2((0, 0, 0), 100_000, 100_000)).save(tmp_path / "m.glb"))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 15)
    with pytest.raises(ValueError, match="expected a picture of at most 11 pixels, got 4 x 4"):
        nr.UVMesh.load(basis(ktx2((0, 0, 0))).save(tmp_path / "m.glb"))
    monkeypatch.undo()
    pytest.importorskip("opengl_basisu")
    with pytest.raises(ValueError, match=f"expected a picture of {BASIS}, got one that cannot be read"):
        nr.UVMesh.load(basis(ktx2((0, 0, 0))[:-8]).save(tmp_path / "m.glb"))


@pytest.mark.parametrize(
    ("place", "form", "value", "sentence"),
    [
        (20, "<II", (8000, 8000), "cannot be read"),  # pixels of a single block
        (28, "<I", (1 << 31,), "cannot be read"),  # depth
        (32, "<I", (1 << 31,), "cannot be read"),  # layers
        (36, "<I", (1 << 31,), "cannot be read"),  # faces
        (40, "<I", (1 << 31,), "cannot be read"),  # levels
        (44, "<I", (2,), "cannot be read"),  # packed by Zstandard, which it is not
        (80, "<Q", (1 << 63,), "cannot be read"),  # place of the level
        (88, "<Q", (1 << 62,), "cannot be read"),  # its size
        (96, "<Q", (1 << 62,), "expected a picture of at most"),  # its size when unpacked
    ],
)
def test_basis_universal_that_lies(
    tmp_path: Path, place: int, form: str, value: tuple[int, ...], sentence: str
) -> None:
    """About its sizes: nothing is allocated for them."""
    pytest.importorskip("opengl_basisu")
    data = bytearray(ktx2((9, 9, 9)))
    struct.pack_into(form, data, place, *value)
    with takes_at_most(300), pytest.raises(ValueError, match=rf"m.glb: .*{sentence}"):
        nr.UVMesh.load(basis(bytes(data)).save(tmp_path / "m.glb"))


def test_basis_universal_that_unpacks_to_more(tmp_path: Path) -> None:
    """Than it says: Zstandard stops there."""
    pytest.importorskip("opengl_basisu")
    data = bytearray(ktx2((9, 9, 9)))
    runs = [
        (1 << 17) << 3 | 1 << 1 | (number == 127) for number in range(128)
    ]  # of 128 KiB of a byte: RFC 8878, 3.1.1.2
    packed = b"\x28\xb5\x2f\xfd\x00\x38" + b"".join(run.to_bytes(3, "little") + b"\0" for run in runs)
    data[44] = 2
    struct.pack_into("<Q", data, 88, len(packed))
    with takes_at_most(30), pytest.raises(ValueError, match=rf"picture of {BASIS}, got one that cannot be read"):
        nr.UVMesh.load(basis(bytes(data[:-16]) + packed).save(tmp_path / "m.glb"))
