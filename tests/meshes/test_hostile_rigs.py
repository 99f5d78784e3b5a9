"""Rigs that would take minutes or gigabytes, and numbers that leave float32."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.io.gltf import reader
from neural_renderer.io.gltf.primitives import Primitives
from neural_renderer.meshes.rigs.animation import alike, sampled
from tests.fuzz.kinds import rig
from tests.mutations import glb


def changed(path: Path, edit: Any) -> Path:
    """A GLB file with another JSON."""

    def change(text: bytes) -> bytes:
        tree = json.loads(text)
        edit(tree)
        return json.dumps(tree).encode()

    path.write_bytes(glb(path.read_bytes(), 0.0, change))
    return path


@pytest.fixture
def good(tmp_path: Path) -> Path:
    rig().save(tmp_path / "r.glb")
    return tmp_path / "r.glb"


def test_a_channel_for_each_property(good: Path) -> None:
    """As glTF says; a hundred thousand for one took a minute."""

    def repeated(tree: dict[str, Any]) -> None:
        tree["animations"][0]["channels"] *= 100

    with pytest.raises(ValueError, match=r"r.glb: .*animation 0: expected one channel for rotation of node 1, got sev"):
        nr.Rig.load(changed(good, repeated))


def test_channels_that_share_keys_share_their_arrays(good: Path) -> None:
    """Each read all of its sampler's array. Now it is read once, and they are interpolated together."""

    def shared(tree: dict[str, Any]) -> None:
        first = len(tree["nodes"])
        tree["nodes"] += [{} for _ in range(2_000)]
        tree["scenes"][0]["nodes"] += range(first, first + 2_000)
        tree["animations"][0]["channels"] = [
            {"sampler": 0, "target": {"node": first + number, "path": "rotation"}} for number in range(2_000)
        ]

    loaded = nr.Rig.load(changed(good, shared))
    tracks = next(iter(loaded.animations.values()))  # type: ignore[union-attr]
    assert len(tracks) == 2_000 and len({id(track.values) for track in tracks}) == 1
    groups = alike(tracks)
    assert len(groups) == 1 and sampled(groups[0], np.array([0.0, 0.5])).shape == (2, 2_000, 4)
    pose = loaded.animated(0.5)
    assert torch.equal(pose.rotations[-1], pose.rotations[-2]) and not torch.equal(pose.rotations[-1], torch.eye(3))


def test_the_last_track_of_a_property_counts() -> None:
    one = rig()
    spin = one.animations["go"][0]  # type: ignore[index]
    other = dataclasses.replace(spin, values=spin.values[::-1].copy())
    both = one.replace(animations={"go": [spin, other]}).animated(0.25)
    assert torch.equal(both.rotations, one.replace(animations={"go": [other]}).animated(0.25).rotations)


def test_chains_and_numbers_of_joints_have_limits(good: Path) -> None:
    mesh = nr.Mesh.icosphere(0)
    for joints in (4096, 4097):
        parts = [*range(-1, joints - 1)], torch.zeros(joints, 3), torch.ones(12, 1), torch.zeros(12, 1).long()
        if joints == 4096:
            assert nr.Rig(mesh, *parts).joints().shape == (4096, 3)
        else:
            with pytest.raises(ValueError, match="parents: expected chains of at most 4,096 joints, got a longer one"):
                nr.Rig(mesh, *parts)

    def many(tree: dict[str, Any]) -> None:
        tree["nodes"] += [{} for _ in range(1 << 17)]

    with pytest.raises(ValueError, match=r"r.glb: .*expected at most 131,072 nodes of a rig, got 131,07"):
        nr.Rig.load(changed(good, many))

    def chain(tree: dict[str, Any]) -> None:
        first = len(tree["nodes"])
        tree["nodes"] += [{"children": [first + number + 1]} for number in range(5000)] + [{}]
        tree["scenes"][0]["nodes"].append(first)

    rig().save(good)
    with pytest.raises(ValueError, match=r"r.glb: parents: expected chains of at most 4,096 joints"):
        nr.Rig.load(changed(good, chain))


def test_keys_that_leave_float32(tmp_path: Path) -> None:
    big = rig()
    track = big.animations["go"][1]  # type: ignore[index]
    for value, fits in ((1e18, True), (3e38, False)):
        track.values[:] = value
        big.save(tmp_path / "big.glb")
        if fits:
            loaded = nr.Rig.load(tmp_path / "big.glb")
            assert bool(loaded.vertices(loaded.animated(0.5)).isfinite().all())
        else:
            with pytest.raises(
                ValueError, match=r"big.glb: .*expected numbers of translation up to 1e\+18, got 3e\+38"
            ):
                nr.Rig.load(tmp_path / "big.glb")


def test_a_rig_without_animations() -> None:
    plain = rig().replace(animations={})
    with pytest.raises(ValueError, match=r"^animation: expected a rig with animations, got one without$"):
        plain.animated(0.0)


def test_many_joints_of_a_vertex(good: Path) -> None:
    """Sets that share an accessor: 3,000 of 30,000 vertices took more than 7 GB, in a file of 1.4 MB."""

    def edit(tree: Any) -> None:
        attributes = tree["meshes"][0]["primitives"][0]["attributes"]
        for name in ("JOINTS", "WEIGHTS"):
            attributes.update({f"{name}_{number}": attributes[f"{name}_0"] for number in range(17)})

    changed(good, edit)
    for load in (nr.Rig.load, nr.UVMesh.load):
        with pytest.raises(ValueError, match="expected at most 64 joints of a vertex, got more"):
            load(good)


def test_primitives_are_read_until_the_limit_of_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not all before it is looked at: 200 primitives of three million vertices without data took 5 GB."""
    read: list[str] = []
    before = Primitives._read
    monkeypatch.setattr(reader, "_LEAST_LIMIT", 1 << 17)
    monkeypatch.setattr(
        Primitives, "_read", lambda self, what, *rest: (read.append(what), before(self, what, *rest))[1]
    )
    nr.Mesh.icosphere(0).save(tmp_path / "m.glb")

    def edit(tree: Any) -> None:
        tree["accessors"].append({"componentType": 5126, "count": 30_000, "type": "VEC3"})
        primitive = {"attributes": {"POSITION": len(tree["accessors"]) - 1}}
        tree["meshes"][0]["primitives"] = [primitive] * 200

    with pytest.raises(ValueError, match="vertices and faces in a scene, got more"):
        nr.UVMesh.load(changed(tmp_path / "m.glb", edit))
    assert len(read) < 20
