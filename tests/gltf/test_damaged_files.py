"""Files that do not follow the specification: each value of the JSON replaced by others, and sentences for the rest."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import neural_renderer as nr
from tests.gltf.compare import PYTHON
from tests.gltf.files import UV, File, textured

WRONG = [None, True, -1, 0, 1.5, 2**70, "x", [], {}, [None], [[0]]]


def rich() -> File:
    """A file that has a bit of everything."""
    file = File()
    file.json["extensionsUsed"] = ["KHR_texture_transform"]
    moved = {"KHR_texture_transform": {"offset": [0, 0.5], "texCoord": 1}}
    material = textured(file, [[[255, 0, 0, 99]]], extensions=moved) | {
        "normalTexture": {"index": 0, "scale": 2},
        "emissiveTexture": {"index": 0, "texCoord": 0},
        "emissiveFactor": [1, 0, 0],
        "alphaMode": "MASK",
        "alphaCutoff": 0.4,
    }
    file.json["textures"][0]["sampler"] = file.add("samplers", {"wrapS": 33071})
    old = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 0}, "glossinessFactor": 0.5}
    file.add("materials", {"extensions": {"KHR_materials_pbrSpecularGlossiness": old}})
    bound = {
        "JOINTS_0": file.array(np.zeros((4, 4)), np.uint8),
        "WEIGHTS_0": file.array(np.tile([1, 0, 0, 0], (4, 1)), np.float32),
        "COLOR_0": file.array(np.full((4, 4), 200), np.uint8, normalized=True),
        "NORMAL": file.array(np.tile([0, 0, 1], (4, 1)), np.float32),
        "TANGENT": file.array(np.tile([1, 0, 0, 1], (4, 1)), np.float32),
        "TEXCOORD_0": file.array(UV),
        "TEXCOORD_1": file.array(UV),
    }
    first = file.square(material, **bound)
    moved_up = file.array(np.tile([0, 0, 1], (4, 1)), np.float32)
    index, values = (file.json["accessors"][n]["bufferView"] for n in (file.array([1], np.uint8), moved_up))
    sparse = {"count": 1, "indices": {"bufferView": index, "componentType": 5121}, "values": {"bufferView": values}}
    target = file.add("accessors", {"count": 4, "type": "VEC3", "componentType": 5126, "sparse": sparse})
    first["targets"] = [{"POSITION": target, "NORMAL": target}]
    file.scene(first, file.square() | {"material": 0, "mode": 5, "targets": first["targets"]}, weights=[0.5])
    joint = file.add("nodes", {"translation": [0, 1, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]})
    file.json["skins"] = [{"joints": [joint], "inverseBindMatrices": file.array(np.eye(4).reshape(1, 16), np.float32)}]
    lone = file.add("meshes", {"primitives": [file.square() | {"material": 0}], "weights": []})
    places = {"attributes": {"TRANSLATION": file.array([[0, 0, 1], [0, 0, 2]], np.float32)}}
    skinned = {"mesh": 0, "skin": 0, "weights": [1]}
    file.json["meshes"][0]["primitives"].pop()
    copies = {"mesh": lone, "children": [joint], "extensions": {"EXT_mesh_gpu_instancing": places}}
    file.json["nodes"][0] = skinned
    file.json["scenes"][0]["nodes"] = [0, file.add("nodes", copies)]
    times, turns = file.array([0, 1], np.float32), file.array([[0, 0, 0, 1], [0, 0, 1, 0]], np.float32)
    channel = {"sampler": 0, "target": {"node": joint, "path": "rotation"}}
    sampler = {"input": times, "output": turns, "interpolation": "LINEAR"}
    file.json["animations"] = [{"channels": [channel], "samplers": [sampler]}]
    return file


def places_of(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Iterate over the keys that lead to each value of a JSON."""
    if place:
        yield place
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in pairs:
        yield from places_of(inner, (*place, key))


@pytest.mark.parametrize("step", [12, pytest.param(1, marks=pytest.mark.slow)])
def test_every_value_of_the_json_may_be_wrong(tmp_path: Path, step: int) -> None:
    """The file is read, or a sentence names it; never Python's words."""
    file = rich()
    good, path = file.json, tmp_path / "m.glb"
    with pytest.warns(UserWarning, match="no texture coordinates"):
        nr.Rig.load(file.save(path))
    refused = 0
    for number, place in enumerate(places_of(good)):
        for wrong in WRONG[number % len(WRONG) :: step]:
            file.json = copy.deepcopy(good)
            owner: Any = file.json
            for key in place[:-1]:
                owner = owner[key]
            owner[place[-1]] = wrong
            file.save(path)
            for load in (nr.UVMesh.load, nr.Rig.load)[:: 1 if step == 1 or number % 2 else -1][: 2 if step == 1 else 1]:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    try:
                        load(path)
                    except ValueError as error:
                        refused += 1
                        assert "m.glb: " in str(error) and not PYTHON.search(str(error)), (place, wrong, str(error))
                        assert "does not follow the specification" not in str(error), (place, wrong)
    assert refused > 100


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "it is cut"),
        (b"glTF\2\0\0\0", "it is cut"),
        (b"glTF\1\0\0\0" + bytes(12), "expected glTF 2.0, got version 1"),
        (b"glTF\2\0\0\0\x14\0\0\0\x63\0\0\0JSON", "expected chunks within its 20 bytes, got one of 99 bytes"),
        (b"glTF\2\0\0\0\x14\0\0\0\0\0\0\0BIN\0", "it has no chunk of JSON"),
        (b'{"asset": {', "its JSON is damaged in line 1, column 12"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4dc1\nsize 373032\n", "it is a pointer of Git LFS"),
        (b"[" * 100_000, "its JSON is nested too deeply"),
        (b'{"a": ' + b"9" * 5000 + b"}", "a number of too many digits"),
        (b'{"a": "\xff"}', "its text is not UTF-8"),
        (b"[1, 2]", "its JSON: expected an object"),
        (b'{"asset": {"version": "1.0"}}', "expected glTF 2.0, got version '1.0'"),
        (b'{"asset": {"version": "2.0", "minVersion": "2.1"}}', "expected glTF 2.0, got version '2.1'"),
        (b'{"asset": {"version": "2.0"}}', "expected faces, got 0 vertices but no faces"),
        (b'{"extensionsRequired": ["EXT_a", "KHR_materials_sheen"]}', r"EXT_a \(of unknown effect\), .*the sheen of"),
        (b'{"extensionsRequired": ["KHR_lights_punctual"]}', r"_punctual \(lamps\), .*in extensionsUsed alone"),
        (b'{"extensionsRequired": "EXT_a"}', "expected a list of texts as extensionsRequired"),
        (b'{"nodes": [{"children": [0]}]}', "one that is its own ancestor"),
        (b'{"nodes": [{"mesh": 3}]}', "expected one of its 0 meshes, got 3"),
    ],
)
def test_sentences(tmp_path: Path, content: bytes, sentence: str) -> None:
    (tmp_path / "m.glb").write_bytes(content)
    for load in (nr.UVMesh.load, nr.Rig.load):
        with pytest.raises(ValueError, match=rf"m\.glb: cannot be read as GLB \(.*{sentence}"):
            load(tmp_path / "m.glb")


def test_what_is_used_and_not_read_is_named(tmp_path: Path) -> None:
    file = File()
    file.json["extensionsUsed"] = ["KHR_materials_clearcoat", "KHR_xmp_json_ld", "VENDOR_x", "KHR_texture_transform"]
    path = file.scene(file.square()).save(tmp_path / "m.glb")
    words = (
        r"it uses KHR_materials_clearcoat \(a clear coat on materials\), VENDOR_x \(of unknown effect\), which is left"
    )
    for load in (nr.UVMesh.load, nr.Mesh.load, nr.Rig.load):
        with pytest.warns(UserWarning, match=words):
            load(path)


def test_small_files_cannot_take_minutes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh of many primitives at many nodes: 340 KB with four million did not end in minutes."""
    file = File()
    file.scene(*[file.square()] * 200)
    file.json["nodes"] = [{"mesh": 0}] * 30
    file.json["scenes"][0]["nodes"] = list(range(30))
    monkeypatch.setattr("neural_renderer.io.gltf.reader._LEAST_LIMIT", 1 << 18)  # of 2 ** 24, which takes seconds
    with pytest.raises(ValueError, match=r"expected at most \d+ vertices and faces in a scene, got more"):
        nr.UVMesh.load(file.save(tmp_path / "m.glb"))


def test_small_files_cannot_fill_the_memory(tmp_path: Path) -> None:
    """Instances, and nodes that share a mesh, multiply what a file stores."""
    file = File()
    corners = file.add("accessors", {"count": 1 << 20, "type": "VEC3", "componentType": 5126})
    file.scene({"attributes": {"POSITION": corners}, "mode": 5})
    file.json["nodes"] = [{"mesh": 0}] * 1000
    file.json["scenes"][0]["nodes"] = list(range(1000))
    with pytest.raises(ValueError, match=r"expected at most \d+ vertices and faces in a scene, got more"):
        nr.UVMesh.load(file.save(tmp_path / "m.glb"))
    file.json["accessors"][0]["count"] = 1 << 40
    with pytest.raises(ValueError, match="expected at most 67108864 numbers without data"):
        nr.UVMesh.load(file.save(tmp_path / "m.glb"))


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(100), "got KTX 2.0, which only textures with KHR_texture_basisu may have"),
        (b"GIF89a", "got a file of an unknown format, none of PNG"),
        (b"P6 8 8 2a5\n", r"got one that cannot be read\)$"),
        (b"", "got an empty file"),
    ],
)
def test_a_damaged_image_is_named(tmp_path: Path, content: bytes, sentence: str) -> None:
    file = File()
    good = textured(file, [[[255, 0, 0]]])
    file.add("images", {"uri": "wood%20a.png"})
    file.add("textures", {"source": 1})
    (tmp_path / "wood a.png").write_bytes(content)
    path = file.scene(file.square(good | {"emissiveTexture": {"index": 1}})).save(tmp_path / "m.gltf")
    for load in (nr.UVMesh.load, nr.Mesh.load, nr.Rig.load):
        with pytest.raises(ValueError, match=rf"m\.gltf: .*image 1 \(wood a\.png\): expected a picture, {sentence}"):
            load(path)
