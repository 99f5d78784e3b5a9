"""Rigs: skinning against written-out formulas, files against Blender, derivatives, and errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.func import jvp

import neural_renderer as nr
from neural_renderer.io.gltf.rig_reader import Track
from neural_renderer.meshes.rigs.animation import sampled
from neural_renderer.rotations import from_axis_angle

EPS = torch.finfo(torch.float32).eps


def numbers(seed: int, *shape: int) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def arm(**options: Any) -> nr.Rig:
    """A sphere, three joints of which the last is listed before its parent, two targets and a quarter turn at rest."""
    vertices, faces = nr.icosphere(1)
    weights = numbers(0, len(vertices), 3).abs()
    uv = torch.zeros(len(vertices), 2)
    return nr.Rig(
        nr.UVMesh(vertices, faces, uv, torch.full((2, 2, 3), 0.5)),
        (-1, 2, 0),
        numbers(1, 3, 3),
        weights / weights.sum(1, keepdim=True),
        rotations=from_axis_angle(numbers(2, 3, 3)),
        scales=numbers(3, 3, 3).abs() + 0.5,
        targets=0.1 * numbers(4, 2, len(vertices), 3),
        target_weights=torch.tensor([0.0, 0.5]),
        names=("root", "hand", "elbow"),
        **options,
    )


def written_out(rig: nr.Rig, angles: Tensor, shape: Tensor) -> Tensor:
    """The formula of the docstring, joint by joint with matrices [4, 4] in float64."""

    def world(joint: int, turned: bool) -> Tensor:
        own = torch.eye(4, dtype=torch.float64)
        turn = rig.rotations[joint].double()
        if turned:
            turn = turn @ from_axis_angle(angles[joint].double())
        own[:3, :3] = turn @ torch.diag(rig.scales[joint].double())
        own[:3, 3] = rig.translations[joint]
        return own if rig.parents[joint] < 0 else world(rig.parents[joint], turned) @ own

    points = rig.mesh.vertices.double() + torch.einsum("m,mvc->vc", shape.double(), rig.targets.double())
    whole = torch.cat((points, torch.ones(len(points), 1, dtype=torch.float64)), 1)
    motions = torch.stack([world(joint, True) @ world(joint, False).inverse() for joint in range(3)])
    return torch.einsum("vk,kij,vj->vi", rig.weights.double(), motions, whole)[:, :3]


def test_skinning_is_the_formula() -> None:
    rig, angles, shape = arm(), numbers(5, 3, 3), numbers(6, 2)
    expected = written_out(rig, angles, shape)
    found = rig.vertices(rig.pose(angles, shape))
    assert (found - expected).abs().max() < 200 * EPS * expected.abs().max()


def test_poses_at_rest_and_of_the_whole() -> None:
    rig = arm()
    plain = rig.vertices()
    turn, move = numbers(7, 3), numbers(8, 3)
    found = rig.vertices(rig.pose(rotation=turn, translation=move))
    expected = plain @ from_axis_angle(turn).T + move
    assert (found - expected).abs().max() < 100 * EPS * expected.abs().max()
    rest = rig.mesh.vertices + 0.5 * rig.targets[1]
    assert (plain - rest).abs().max() < 100 * EPS * rest.abs().max()


def test_batches_equal_single_poses() -> None:
    rig, angles, shapes = arm(), numbers(5, 2, 4, 3, 3), numbers(6, 2, 4, 2)
    together = rig.vertices(rig.pose(angles, shapes))
    assert together.shape == (2, 4, 42, 3)
    for place in np.ndindex(2, 4):
        alone = rig.vertices(rig.pose(angles[place], shapes[place]))
        assert (together[place] - alone).abs().max() < 50 * EPS * alone.abs().max()


def test_gradients_and_forward_mode_to_all() -> None:
    """Products with the Jacobian in both modes agree, for every tensor of a rig and a pose."""
    base = arm()
    names = ("translations", "weights", "rotations", "scales", "targets", "inverse_bind")
    inverse = torch.eye(4).repeat(3, 1, 1) + 0.1 * numbers(9, 3, 4, 4)
    values = [getattr(base, name) if name != "inverse_bind" else inverse for name in names]
    values = [base.mesh.vertices, *values, 0.5 * numbers(5, 3, 3), numbers(6, 2)]

    def bent(vertices: Tensor, *rest: Tensor) -> Tensor:
        *own, angles, shape = rest
        options = dict(zip(names, own, strict=True))
        rig = nr.Rig(base.mesh.replace(vertices=vertices), base.parents, **options, joint_targets=None)
        return rig.vertices(rig.pose(angles, shape))

    doubles = tuple(value.double().requires_grad_() for value in values)
    directions = tuple(numbers(20 + n, *value.shape).double() for n, value in enumerate(values))
    result, along = jvp(bent, doubles, directions)
    back = numbers(30, *result.shape).double()
    gradients = torch.autograd.grad(bent(*doubles), doubles, back)
    assert all(bool(gradient.any()) for gradient in gradients)
    there = float((back * along).sum().detach())
    again = sum(float((g * d).sum()) for g, d in zip(gradients, directions, strict=True))
    assert abs(there - again) < 1e-10 * abs(there)
    step = 1e-6
    ahead, behind = (bent(*(v + s * d for v, d in zip(doubles, directions, strict=True))) for s in (step, -step))
    assert (along - (ahead - behind) / (2 * step)).abs().max() < 1e-6 * along.abs().max()


def test_joint_targets_move_joints_and_keep_the_mesh() -> None:
    """Without rotations the mesh is that of the targets alone, wherever the joints are."""
    rig = arm(joint_targets=numbers(9, 2, 3, 3))
    shape = torch.tensor([0.7, -0.4])
    expected = rig.mesh.vertices + torch.einsum("m,mvc->vc", shape, rig.targets)
    assert (rig.vertices(rig.pose(None, shape)) - expected).abs().max() < 200 * EPS * expected.abs().max()
    moved = rig.joints(rig.pose(None, shape)) - rig.joints(rig.pose(None, torch.zeros(2)))
    assert (moved[0] - torch.einsum("m,mc->c", shape, rig.joint_targets[:, 0])).abs().max() < 10 * EPS  # type: ignore[index]


def test_normals_are_those_of_the_bent_surface() -> None:
    """A sphere under one joint becomes an ellipsoid; its normals are those of the inverse transpose."""
    vertices, faces = nr.icosphere(1)
    normals = vertices[faces.long()]
    mesh = nr.UVMesh(vertices, faces, torch.zeros(42, 2), torch.ones(2, 2, 3), normals=normals)
    scale = torch.tensor([[1.0, 2.0, -4.0]])
    rig = nr.Rig(mesh, [-1], torch.zeros(1, 3), torch.ones(42, 1), scales=scale, inverse_bind=torch.eye(4)[None])
    expected = torch.nn.functional.normalize(normals / scale[0], dim=-1)
    assert (rig.posed().normals - expected).abs().max() < 10 * EPS


def tracks() -> dict[str, list[Track]]:
    generator = np.random.default_rng(0)
    turns = generator.normal(size=(3, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    times = np.array([0.0, 0.5, 2.0])
    return {
        "wave": [
            Track(1, "rotation", times, turns),
            Track(0, "translation", times, generator.normal(size=(3, 3, 3)), "CUBICSPLINE"),
            Track(2, "scale", times, 1 + generator.random((3, 3)), "STEP"),
            Track(0, "weights", times, generator.random((3, 2))),
        ]
    }


def test_files_come_back(tmp_path: Path) -> None:
    rig = arm(animations=tracks())
    rig.save(tmp_path / "arm.glb")
    again = nr.Rig.load(tmp_path / "arm.glb")
    assert (again.names, again.parents) == (rig.names, rig.parents)
    for time in (0.0, 0.3, 0.5, 1.1, 2.0, 9.0):
        there, back = (one.vertices(one.animated(time, "wave")) for one in (rig, again))
        assert (there - back).abs().max() < 100 * EPS * there.abs().max()
    assert (again.duration(), repr(again)) == (2.0, "Rig(42 vertices, 3 joints, 2 morph targets, 1 animations)")


def test_interpolation_is_that_of_the_specification() -> None:
    times, keys = np.linspace(0, 1, 11), np.array([0.0, 1.0])
    cubic = np.polynomial.Polynomial([1.0, -2.0, 3.0, 4.0])  # a cubic is its own Hermite spline
    knots = np.array([[[9.0], [cubic(t)], [cubic.deriv()(t)]] for t in keys])
    knots[1, 0], knots[1, 2] = knots[1, 2].copy(), 9.0
    assert (
        np.abs(sampled([Track(0, "weights", keys, knots, "CUBICSPLINE")], times)[:, 0, 0] - cubic(times)).max() < 1e-13
    )
    turns = np.array([[0.0, 0, 0, 1], [0.0, 0, -np.sin(0.5), -np.cos(0.5)]])  # 1 radian, by the other sign
    found = sampled([Track(0, "rotation", keys, turns)], times)[:, 0]
    assert np.abs(found[:, 2] * np.sign(found[:, 3]) - np.sin(times / 2)).max() < 1e-14
    jump = Track(0, "scale", keys, np.array([[1.0] * 3, [2.0] * 3]), "STEP")
    assert sampled([jump], np.array([-1.0, 0.99, 1.0, 5.0]))[:, 0, 0].tolist() == [1.0, 1.0, 2.0, 2.0]


def waving() -> nr.Rig:
    """A sphere under a chain of three joints that are turned at rest, with a morph target and an animation."""
    vertices, faces = nr.icosphere(1)
    x, y, _ = vertices.unbind(1)
    upper = ((1 + y) / 2).square()
    weights = torch.stack((1 - upper, 0.6 * upper, 0.4 * upper), 1)
    turned = from_axis_angle(torch.tensor([[0.3, 0.0, 0.0], [0.0, -0.4, 0.2], [0.1, 0.2, 0.3]]))
    target = torch.stack((0 * x, 0 * x, 0.5 * x.square()), 1)
    times = np.array([0.0, 0.5, 1.25])
    angles = np.array([0.2, -0.5, 0.9])[:, None] / 2
    turns = np.concatenate((np.sin(angles) * [0.6, 0.0, 0.8], np.cos(angles)), 1)
    tracks = [
        Track(1, "rotation", times, turns),
        Track(2, "rotation", times, turns[::-1].copy()),
        Track(0, "translation", times, np.array([[0.0, -1.0, 0.0], [0.5, -1.0, 0.2], [0.0, -0.5, -0.4]])),
        Track(0, "weights", times, np.array([[0.0], [1.0], [0.3]])),
    ]
    places = torch.tensor([[0.0, -1.0, 0.0], [0.0, 0.8, 0.0], [0.1, 0.7, 0.2]])
    mesh = nr.UVMesh(vertices, faces, torch.zeros(42, 2), torch.full((2, 2, 3), 0.5))
    return nr.Rig(
        mesh, (-1, 0, 1), places, weights, rotations=turned, targets=target[None], animations={"wave": tracks}
    )


# Vertices 0, 20 and 41 of `waving` at the keys, from its file by Blender 5.0.1 (wheel bpy 5.0.1).
BLENDER = torch.tensor(
    [
        [[-0.2584457, 1.0537413, 0.2842042], [0.9432921, 0.089786, 0.2477093], [0.4265125, -0.8489407, 0.3070747]],
        [[0.936541, 0.5921007, -0.2042067], [1.4163806, -0.1471299, 0.8739942], [0.9221466, -0.8501008, 0.6007109]],
        [[-0.7557348, 1.2247808, 0.1728484], [0.8771804, 0.6120502, 0.0500316], [0.4266332, -0.3483626, -0.0656711]],
    ]
)


def test_blender_bends_the_file_alike(tmp_path: Path) -> None:
    waving().save(tmp_path / "wave.glb")
    rig = nr.Rig.load(tmp_path / "wave.glb")
    found = rig.vertices(rig.animated([0.0, 0.5, 1.25]))[:, [0, 20, 41]]
    assert (found - BLENDER).abs().max() < 20 * EPS * BLENDER.abs().max()


def change(path: Path, edit: Any) -> Path:
    """Rewrite the JSON of a GLB file."""
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + length])
    edit(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = data[:8] + (20 + len(text) + len(data) - 20 - length).to_bytes(4, "little")
    path.write_bytes(head + len(text).to_bytes(4, "little") + b"JSON" + text + data[20 + length :])
    return path


def cyclic(tree: Any) -> None:
    tree["nodes"][1]["children"] = [0]


def shared(tree: Any) -> None:
    tree["nodes"][1]["children"] = [1]


def sheared(tree: Any) -> None:
    tree["nodes"][0]["matrix"] = [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]


def few_matrices(tree: Any) -> None:
    tree["accessors"][tree["skins"][0]["inverseBindMatrices"]]["count"] = 2


def no_weights(tree: Any) -> None:
    for primitive in tree["meshes"][0]["primitives"]:
        del primitive["attributes"]["WEIGHTS_0"]


def unknown_joint(tree: Any) -> None:
    tree["skins"][0]["joints"][0] = 99


def long_track(tree: Any) -> None:
    sampler = tree["animations"][0]["samplers"][0]
    tree["accessors"][sampler["output"]]["count"] = 1


def narrow_track(tree: Any) -> None:
    tree["accessors"][tree["animations"][0]["samplers"][3]["output"]]["count"] = 3  # one of two weights at each key


def beyond_the_buffer(tree: Any) -> None:
    tree["accessors"][tree["animations"][0]["samplers"][0]["input"]]["byteOffset"] = 1 << 40


def huge_targets(tree: Any) -> None:
    accessor = {"componentType": 5126, "count": 1 << 40, "type": "VEC3"}
    tree["accessors"].append(accessor)
    for primitive in tree["meshes"][0]["primitives"]:
        primitive["targets"] = [{"POSITION": len(tree["accessors"]) - 1}] * 2


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (cyclic, "node .*one that is its own ancestor"),
        (shared, "node 1: expected one parent"),
        (sheared, "node 0: expected a matrix"),
        (few_matrices, "skin 0: expected 3 finite inverse bind matrices, got 2"),
        (no_weights, "attribute WEIGHTS_0"),
        (unknown_joint, "one of its 4 nodes, got 99"),
        (long_track, "animation 0, sampler 0: expected 12 finite numbers of rotation"),
        (narrow_track, "animation 0, sampler 3: expected 6 finite numbers of weights, got 3"),
        (beyond_the_buffer, "accessor .*: expected data within"),
        (huge_targets, "accessor .*: expected at most"),
    ],
)
def test_damaged_files_are_named(edit: Any, sentence: str, tmp_path: Path) -> None:
    arm(animations=tracks()).save(tmp_path / "arm.glb")
    with pytest.raises(ValueError, match=f"arm.glb.*{sentence}"):
        nr.Rig.load(change(tmp_path / "arm.glb", edit))


def test_sparse_and_whole_numbered_accessors(tmp_path: Path) -> None:
    """A sparse morph target, and weights as bytes with bytes of joints: what small files of other programs have."""
    arm().save(tmp_path / "arm.glb")
    expected = nr.Rig.load(tmp_path / "arm.glb")

    def sparse(tree: Any) -> None:
        target = tree["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]
        own = tree["accessors"][target]
        view = own.pop("bufferView")
        index = tree["accessors"][tree["meshes"][0]["primitives"][0]["indices"]]
        indices = {"bufferView": index["bufferView"], "componentType": 5125}
        own["sparse"] = {"count": 3, "indices": indices, "values": {"bufferView": view}}

    found = nr.Rig.load(change(tmp_path / "arm.glb", sparse))
    corners = found.mesh.faces[0].long()
    target = torch.zeros_like(expected.targets[0])
    target[corners] = expected.targets[0][:3]
    assert torch.equal(found.targets[1], expected.targets[1])
    assert torch.equal(found.targets[0], target)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"parents": (1, 0, -1)}, "parents: expected a tree of joints, got 2 of 3 in cycles"),
        ({"parents": (-1, 0, 7)}, r"parents\[2\]: expected less than 3, got 7"),
        ({"weights": torch.ones(41, 3)}, "weights: expected"),
        ({"weights": torch.zeros(42, 3)}, "weights: expected non-negative rows that sum to 1, got .* sums from 0 to 0"),
        ({"weights": torch.full((42, 3), 2 / 3)}, "weights: .* sums from 2 to 2"),
        ({"weights": torch.tensor([[1.5, -0.5, 0.0]]).repeat(42, 1)}, "weights: .* a minimum of -0.5"),
        ({"scales": torch.zeros(3, 3)}, "scales: expected numbers other than 0 without inverse_bind"),
        ({"indices": torch.full((42, 3), 3)}, "indices: "),
        ({"translations": torch.full((3, 3), torch.nan)}, "translations: "),
        ({"names": ("one",)}, "names: expected 3"),
    ],
)
def test_errors(options: Any, sentence: str) -> None:
    base = arm()
    plain = {"mesh": base.mesh, "parents": (-1, 2, 0), "translations": numbers(1, 3, 3), "weights": base.weights}
    with pytest.raises(ValueError, match=sentence):
        nr.Rig(**(plain | options))
    with pytest.raises(ValueError, match="animation: expected a rig with animations, got one without"):
        base.animated(0.0)
    with pytest.raises(ValueError, match="angles: expected"):
        base.pose(torch.zeros(2, 3))
