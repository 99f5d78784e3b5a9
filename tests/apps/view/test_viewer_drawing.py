"""Copies of meshes, and the arrays and files that a browser gets of them."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import neural_renderer as nr
from neural_renderer.apps.common.pictures.clay import CLAY
from neural_renderer.apps.view.drawing.glb import Drawable, write_glb
from neural_renderer.apps.view.drawing.snapshot import take_snapshot
from neural_renderer.apps.view.drawing.surface import SURFACES, Look, drawables
from neural_renderer.apps.view.panels.faces import first_face
from tests.paths import EXAMPLES


def load_glb(parts: list[Drawable]) -> list[trimesh.Trimesh]:
    scene = trimesh.load(io.BytesIO(write_glb(parts)), file_type="glb", process=False)
    return list(scene.geometry.values())


def corners(part: Drawable) -> np.ndarray:
    return part.positions[part.faces]


def test_a_snapshot_is_a_copy() -> None:
    mesh = nr.Mesh.icosphere(1)
    before = mesh.vertices.detach().clone()
    snapshot = take_snapshot(mesh)
    with torch.no_grad():
        mesh.vertices += 1
        mesh.textures.zero_()
    assert torch.equal(snapshot.vertices, before) and not snapshot.vertices.requires_grad
    assert bool((snapshot.textures == 1).all())
    spot = nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    copy = take_snapshot(spot).uv_mesh
    assert copy is not None and torch.equal(copy.images[0], spot.images[0])
    assert copy.images[0].data_ptr() != spot.images[0].data_ptr()


def test_every_change_is_seen() -> None:
    """Also those that torch does not count; what has not changed is copied once."""
    mesh = nr.Mesh.icosphere(1)
    changes = (
        lambda: mesh.vertices.data.mul_(2),
        lambda: setattr(mesh.vertices, "data", mesh.vertices.data * 2),
        lambda: np.multiply(shared_of(mesh.vertices), 2, out=shared_of(mesh.vertices)),
    )
    before = take_snapshot(mesh)
    for change in changes:
        change()
        after = take_snapshot(mesh)
        assert torch.equal(after.vertices, 2 * before.vertices)
        assert after.faces is before.faces and after.textures is before.textures
        before = after
    empty = torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.long)
    assert take_snapshot(empty).vertices is take_snapshot(empty).vertices


def shared_of(tensor: torch.Tensor) -> np.ndarray:
    """An array in the memory of a tensor."""
    return tensor.detach().numpy()


@pytest.mark.parametrize(
    ("mesh", "error", "sentence"),
    [
        ("bunny.obj", TypeError, "mesh: expected a Mesh"),
        ((torch.rand(4, 3),), TypeError, "mesh: expected a Mesh"),
        ((torch.rand(4, 2), torch.zeros(1, 3)), ValueError, "vertices"),
        ((torch.rand(4, 3), torch.tensor([[0, 1, 4]])), ValueError, "faces"),
        ((torch.rand(4, 3), torch.tensor([[0, 1, 2]]), torch.rand(2, 1, 1, 1, 3)), ValueError, "textures"),
        (([0.0], [1]), TypeError, "mesh: expected tensors"),
    ],
)
def test_what_is_no_mesh_is_refused(mesh: Any, error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        take_snapshot(mesh)


def test_meshes_in_other_forms() -> None:
    vertices, faces = nr.cube()
    for form in (
        (vertices, faces),
        (vertices[None], faces[None]),
        (vertices.numpy(), faces.numpy()),
        [vertices.double(), faces.long(), None],
    ):
        snapshot = take_snapshot(form)
        assert torch.equal(snapshot.vertices, vertices) and torch.equal(snapshot.faces, faces.int())


def test_faces_with_bad_vertices_are_left_out() -> None:
    mesh = nr.Mesh.icosphere(2)
    vertices = mesh.vertices.detach().clone()
    vertices[5] = torch.nan
    vertices[9, 1] = torch.inf
    bad = int(((mesh.faces == 5) | (mesh.faces == 9)).any(1).sum())
    usable, left_out = take_snapshot((vertices, mesh.faces, mesh.textures)).finite()
    assert left_out == bad > 0 and len(usable.faces) == mesh.num_faces - bad == len(usable.textures)
    assert bool(torch.isfinite(usable.vertices).all())
    spot = nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    vertices = spot.vertices.clone()
    vertices[0] = torch.nan
    usable, left_out = take_snapshot(replace(spot, vertices=vertices)).finite()
    assert left_out and len(usable.uv_mesh.uv) == len(spot.faces) - left_out
    assert drawables(usable, Look())


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("lit", [True, False])
def test_every_look_shows_the_same_corners(surface: Any, smooth: bool, lit: bool) -> None:
    spot = take_snapshot(nr.UVMesh.load(EXAMPLES / "data" / "spot.obj"))
    sphere = nr.Mesh.icosphere(1)
    random = take_snapshot((sphere.vertices, sphere.faces, torch.rand(80, 3, 3, 3, 3)))
    for snapshot in (spot, random):
        parts = drawables(snapshot, Look(surface, lit, smooth))
        expected = snapshot.vertices[snapshot.faces.long()].numpy()
        assert np.array_equal(np.concatenate([corners(part) for part in parts]), expected)
        found = np.concatenate([mesh.vertices[mesh.faces] for mesh in load_glb(parts)])
        assert np.array_equal(found.astype(np.float32), expected)


def test_one_colour_is_plain() -> None:
    mesh = nr.Mesh.icosphere(1)
    [clay] = drawables(take_snapshot((mesh.vertices, mesh.faces)), Look())
    assert clay.is_plain and clay.color == CLAY
    [red] = drawables(take_snapshot(nr.Mesh(mesh.vertices, mesh.faces, face_colors=torch.full((80, 3), 0.2))), Look())
    assert red.is_plain and red.color == (0.2, 0.2, 0.2)  # 51 / 255


def test_colours_of_vertices_are_shared() -> None:
    vertices, faces = nr.icosphere(1)
    colors = torch.rand(len(vertices), 3)
    mesh = nr.Mesh(vertices, faces, vertex_colors=colors, texture_size=2)
    [part] = drawables(take_snapshot(mesh), Look())
    assert part.corners is None and part.colors is not None and part.normals is not None
    assert np.abs(part.colors / 255 - colors.numpy()).max() <= 0.5 / 255 + 1e-6
    data = write_glb([part])
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    found = accessor(data, "COLOR_0").view(np.uint16).reshape(-1, 4) / 65535
    assert (found[:, 3] == 1).all()
    assert np.abs(found[:, :3] - linear).max() < 2.3 / 2 / 255 + 1e-4  # the slope of the conversion is at most 2.3


def accessor(data: bytes, name: str) -> np.ndarray:
    """The bytes of an attribute of the first part."""
    length = int.from_bytes(data[12:16], "little")
    gltf = json.loads(data[20 : 20 + length])
    number = gltf["meshes"][0]["primitives"][0]["attributes"][name]
    view = gltf["bufferViews"][gltf["accessors"][number]["bufferView"]]
    start = 28 + length + view["byteOffset"]
    return np.frombuffer(data[start : start + view["byteLength"]], np.uint8)


def test_texture_cubes_become_an_atlas() -> None:
    """The texels at the faces' corners and at the middles of their edges are where the coordinates say."""
    vertices, faces = nr.icosphere(1)
    cubes = torch.rand(80, 3, 3, 3, 1).expand(-1, -1, -1, -1, 3).contiguous()  # grey, which JPEG keeps best
    [part] = drawables(take_snapshot((vertices, faces, cubes)), Look())
    [mesh] = load_glb([part])
    image = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")).astype(float) / 255
    uv = mesh.visual.uv[mesh.faces]  # trimesh turns v up
    for places, texels in (
        (uv, [cubes[:, 2, 0, 0], cubes[:, 0, 2, 0], cubes[:, 0, 0, 2]]),
        ((uv + uv[:, [1, 2, 0]]) / 2, [cubes[:, 1, 1, 0], cubes[:, 0, 1, 1], cubes[:, 1, 0, 1]]),
    ):
        x = np.rint(places[..., 0] * image.shape[1] - 0.5).astype(int)
        y = np.rint((1 - places[..., 1]) * image.shape[0] - 0.5).astype(int)
        error = np.abs(image[y, x] - torch.stack(texels, 1).numpy())
        assert error.mean() < 0.02  # JPEG of noise


def test_images_keep_their_coordinates() -> None:
    spot = nr.UVMesh.load(EXAMPLES / "data" / "spot.obj")
    [part] = drawables(take_snapshot(spot), Look())
    [mesh] = load_glb([part])
    assert np.allclose(mesh.visual.uv[mesh.faces], spot.uv.numpy(), atol=1e-6)
    pixels = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")) / 255
    assert np.abs(pixels - spot.images[0].numpy()).mean() < 0.01  # JPEG


def test_several_images_and_plain_faces() -> None:
    vertices, faces = nr.cube()
    index = torch.tensor([0] * 4 + [1] * 4 + [-1] * 4)
    images = torch.rand(8, 8, 3), torch.rand(16, 4, 3)
    mesh = nr.UVMesh(vertices, faces, torch.rand(12, 3, 2), index, images, torch.rand(12, 3, 3), ("repeat", "clamp"))
    parts = drawables(take_snapshot(mesh), Look())
    assert [part.image is not None for part in parts] == [True, True, False]
    assert [part.wrap for part in parts[:2]] == ["repeat", "clamp"]
    assert [len(part.faces) for part in parts] == [4, 4, 4]
    assert len(load_glb(parts)) == 3


def test_the_first_face_that_a_ray_meets() -> None:
    vertices, faces = (part.numpy() for part in nr.icosphere(2))
    for number in range(0, len(faces), 37):
        middle = vertices[faces[number]].mean(0)
        found, distance = first_face(vertices, faces, 3 * middle, -0.5 * middle)
        assert found == number and np.isclose(distance, 4, atol=1e-5)
    assert first_face(vertices, faces, np.array([3.0, 0, 0]), np.array([1.0, 0, 0]))[0] == -1
    assert first_face(vertices, faces, np.array([0, 5.0, 0]), np.array([1.0, 0, 0]))[0] == -1
