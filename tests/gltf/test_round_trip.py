"""What this package writes, read again: the same bits, the same picture, and by trimesh."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import neural_renderer as nr
from tests.gltf.compare import compare


def grid(seed: int, **more: Any) -> nr.UVMesh:
    """A bent sheet of 32 faces, with texture coordinates of 24 bits, so that 1 − v is exact."""
    random = torch.Generator().manual_seed(seed)
    side = torch.linspace(0, 1, 5)
    v, u = torch.meshgrid(side, side, indexing="ij")
    vertices = torch.stack((u, v, 0.3 * torch.rand(5, 5, generator=random)), -1).reshape(-1, 3)
    first = torch.arange(20).reshape(4, 5)[:, :4].reshape(-1, 1)
    faces = torch.cat((first + torch.tensor([0, 1, 6]), first + torch.tensor([0, 6, 5])))
    uv = (torch.rand(25, 2, generator=random) * 4096).round() / 4096
    image = torch.randint(0, 256, (6, 5, 3), generator=random).float() / 255
    return nr.UVMesh(vertices, faces, uv, image, **more)


def tinted() -> nr.UVMesh:
    """An image, and faces without one, under tints with alpha; two materials."""
    mesh = grid(1)
    random = torch.Generator().manual_seed(2)
    index = torch.arange(32) % 2
    glass = nr.Material("glass", alpha_mode="BLEND", opacity=0.5, unlit=True)
    return mesh.replace(
        image_index=index - 1,
        colors=torch.rand(32, 1, 3, generator=random).expand(-1, 3, -1),
        tints=torch.rand(32, 3, 4, generator=random),
        materials=(glass, nr.Material("red", base_color=(1.0, 0.5, 0.5), metallic=1.0)),
        material_index=index,
    )


MODELS = {
    "image": lambda: grid(0),
    "tints": tinted,
    "colors": lambda: grid(3).replace(
        image_index=torch.full((32,), -1), colors=torch.rand(32, 3, 3), images=(), wraps=()
    ),
    "one color": lambda: grid(4).replace(
        image_index=torch.full((32,), -1), colors=torch.full((32, 3, 3), 0.25), images=(), wraps=()
    ),
    "unlit": lambda: grid(5, materials=(nr.Material("m", unlit=True, emissive=(2.0, 1.0, 0.0)),)),
}


@pytest.mark.parametrize("name", MODELS)
def test_the_same_mesh_comes_back(name: str, tmp_path: Path) -> None:
    first = MODELS[name]()
    first.save(tmp_path / "m.glb")
    again = nr.UVMesh.load(tmp_path / "m.glb")
    order = {tuple(face): number for number, face in enumerate(first.faces.tolist())}
    rows = [order[tuple(face)] for face in again.faces.tolist()]
    assert sorted(rows) == list(range(32)) and torch.equal(again.vertices, first.vertices)
    assert torch.equal(again.uv, first.uv[rows])
    for number, image in enumerate(first.images if name != "tints" else ()):  # texels that no face shows are filled
        written = again.images[int(again.image_index[rows.index(int((first.image_index == number).nonzero()[0]))])]
        torch.testing.assert_close(written, image, rtol=0, atol=1e-6)
    for one, found in zip(again.material_index.tolist(), rows, strict=True):
        if first.materials:
            known = first.materials[int(first.material_index[found]) if first.material_index is not None else 0]
            other = again.materials[one]
            assert (other.name, other.unlit, other.alpha_mode) == (known.name, known.unlit, known.alpha_mode)
            assert torch.equal(other.emissive, known.emissive) and torch.equal(other.opacity, known.opacity)
    camera = nr.Camera.look_at((0.4, 0.6, 2.5), at=(0.5, 0.5, 0.0), viewing_angle=25)
    for options in ({"light": None}, {"shading": "smooth"}, {"light": None, "layers": 2}):
        there, back = (nr.render(mesh, camera, 48, outputs=("rgb", "alpha"), **options) for mesh in (first, again))
        # Faces are in another order, which decides about points on their common edges.
        assert (there.rgb - back.rgb).abs().mean() < 1e-3 and (there.alpha - back.alpha).abs().mean() < 1e-3
    again.save(tmp_path / "n.glb")
    third = nr.UVMesh.load(tmp_path / "n.glb")
    for field in dataclasses.fields(again):
        values = [getattr(mesh, field.name) for mesh in (again, third)]
        if isinstance(values[0], torch.Tensor) and field.name != "colors":
            assert torch.equal(*values), field.name
    assert (again.colors - third.colors).abs().max() < 1e-6  # display values, linear light and back
    if name != "colors":  # whose colours are interpolated as display values, by this package alone
        assert compare(tmp_path / "m.glb")[0] == "right"


@pytest.mark.parametrize("name", MODELS)
def test_trimesh_reads_it(name: str, tmp_path: Path) -> None:
    first = MODELS[name]()
    first.save(tmp_path / "m.glb")
    scene = trimesh.load(tmp_path / "m.glb", process=False)
    parts = [scene.geometry[key] for key in scene.geometry]
    triangles = np.concatenate([part.triangles for part in parts])
    expected = first.vertices[first.faces.long()].numpy()
    # A face may begin at another corner.
    rows = [
        np.concatenate((t.mean(1), np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])), 1) for t in (triangles, expected)
    ]
    rows = [row[np.lexsort(row[:, :2].round(3).T)] for row in rows]
    np.testing.assert_allclose(rows[0], rows[1], rtol=0, atol=1e-6)


def test_texture_cubes_come_back(tmp_path: Path) -> None:
    """Faces, vertices and, up to bytes, texels; white without textures."""
    vertices, faces = nr.icosphere(1)
    mesh = nr.Mesh(vertices, faces, torch.rand(80, 1, 1, 1, 3))
    mesh.save(tmp_path / "m.glb")
    again = nr.Mesh.load(tmp_path / "m.glb", 1)
    assert torch.equal(again.vertices, vertices) and torch.equal(again.faces, faces)
    assert (again.textures - mesh.textures).abs().max() < 0.51 / 255
    nr.save_mesh(tmp_path / "n.glb", vertices, faces)
    plain = nr.UVMesh.load(tmp_path / "n.glb")
    assert torch.equal(plain.faces, faces) and bool((plain.colors == 1).all()) and plain.materials[0].double_sided


def test_tints_over_images_are_left_out_of_obj_with_a_sentence(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="OBJ has no colours of vertices over images"):
        tinted().save(tmp_path / "m.obj")
    plain = tinted().submesh(tinted().image_index < 0)
    plain.save(tmp_path / "n.obj")  # in the colours of its faces
    camera = nr.Camera.look_at((0.5, 0.5, 2.5), at=(0.5, 0.5, 0.0), viewing_angle=25)
    there, back = (nr.render(m, camera, 32, light=None).rgb for m in (plain, nr.UVMesh.load(tmp_path / "n.obj")))
    assert (there - back).abs().mean() < 0.02


def test_gradients_and_batches_of_tints() -> None:
    """Gradients reach tints; batches, joined meshes, parts and subdivisions keep them."""
    mesh = tinted().trainable("tints")
    camera = nr.Camera.look_at((0.5, 0.5, 2.5), at=(0.5, 0.5, 0.0), viewing_angle=25)
    options: dict[str, Any] = {"light": None, "outputs": ("rgb",)}
    alone = nr.render(mesh, camera, 32, **options).rgb
    alone.square().sum().backward()
    assert mesh.tints is not None and mesh.tints.grad is not None and bool(mesh.tints.grad[..., :3].any())
    plain = grid(0)
    together = nr.render([mesh, plain], camera, 32, **options).rgb
    assert torch.equal(together[0], alone[0])
    assert (together[1] - nr.render(plain, camera, 32, **options).rgb[0]).abs().max() < 1e-6  # under tints of 1
    away = plain.replace(vertices=plain.vertices + torch.tensor([9.0, 0.0, 0.0]))
    joined = nr.join([mesh, away])
    assert joined.tints is not None and joined.tints.shape == (64, 3, 4) and bool((joined.tints[32:] == 1).all())
    assert (nr.render(joined, camera, 32, **options).rgb - alone).abs().max() < 1e-6
    fine = nr.render(mesh.subdivide(), camera, 32, **options).rgb
    assert (fine - alone).abs().mean() < 1e-3  # but for points on edges
    moved = nr.render(mesh.submesh(range(0, 32, 2)), camera, 32, **options).rgb
    assert moved.shape == alone.shape
