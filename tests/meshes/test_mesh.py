"""The mesh module, in its old and its new forms."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
import torch
import trimesh

from neural_renderer.base.validate import check_values
from neural_renderer.camera import Camera
from neural_renderer.io import load_obj, save_obj
from neural_renderer.meshes.mesh import Mesh
from neural_renderer.meshes.primitives import cube, icosphere
from neural_renderer.meshes.uv_mesh import UVMesh
from neural_renderer.rendering.forward import render
from tests.paths import TEAPOT


@pytest.fixture
def file(tmp_path):
    vertices, faces = cube(5.0)
    textures = torch.rand(12, 1, 1, 1, 3).expand(12, 2, 2, 2, 3)
    save_obj(tmp_path / "cube.obj", vertices + 1, faces, textures)
    return tmp_path / "cube.obj"


def test_given_tensors_are_kept():
    vertices, faces = cube()
    textures = torch.rand(12, 3, 3, 3, 3)
    mesh = Mesh(vertices, faces.long(), textures)
    assert mesh.texture_size == 3 and torch.equal(mesh.textures, textures)
    assert (mesh.num_vertices, mesh.num_faces) == (8, 12)
    assert mesh.faces.dtype == torch.int32 and mesh.vertices.dtype == torch.float32
    assert mesh.vertices is vertices and mesh.textures is textures
    assert not list(mesh.parameters()) and not mesh.state_dict()
    assert repr(mesh) == "Mesh(8 vertices, 12 faces, textures of 3³, cpu)"


def test_trainable_copies_with_parameters():
    mesh = Mesh(*cube(), texture_size=2)
    copied = mesh.trainable("textures")
    assert [name for name, _ in copied.named_parameters()] == ["textures"] and copied.vertices is mesh.vertices
    assert copied.textures.data_ptr() != mesh.textures.data_ptr() and not mesh.textures.requires_grad
    assert set(copied.trainable().state_dict()) == {"vertices", "textures"}
    parameter = torch.nn.Parameter(mesh.vertices.clone())
    assert next(Mesh(parameter, mesh.faces).parameters()) is parameter
    with pytest.raises(ValueError, match="names: expected some of vertices, textures, "):
        mesh.trainable("faces")


@pytest.mark.parametrize("kind", ["mesh", "uv mesh"])
def test_gradients_flow_through_a_mesh_and_its_copies(kind):
    """One rule for both classes."""
    vertices, faces = icosphere(1)
    x = vertices.clone().requires_grad_()
    colors = torch.rand(42, 3, requires_grad=True)
    if kind == "mesh":
        mesh = Mesh(2 * x, faces, vertex_colors=colors)
        mesh.textures.sum().backward()
        assert colors.grad.any()
    else:
        mesh = UVMesh(2 * x, faces, torch.rand(42, 2), torch.rand(4, 4, 3))
    for change in (
        lambda m: m,
        lambda m: m.to("cpu"),
        lambda m: m.normalize(),
        lambda m: m.submesh(range(9)),
        lambda m: m.merge_vertices(),
        lambda m: m.subdivide(scheme="loop"),
    ):
        (found,) = torch.autograd.grad(change(mesh).vertices.square().sum(), x, retain_graph=True)
        assert found.isfinite().all() and found.any()


def test_without_textures_a_mesh_is_white_and_a_file_is_noise(tmp_path):
    mesh = Mesh(*(x.numpy() for x in icosphere(2)), texture_size=4)
    assert mesh.textures.shape == (320, 4, 4, 4, 3) and (mesh.textures == 1).all()
    save_obj(tmp_path / "sphere.obj", *icosphere(2))
    noise = Mesh(tmp_path / "sphere.obj", 4)
    # 61440 normal numbers: their deviation is known to 0.05 / √(2 · 61440) = 0.00014.
    assert noise.textures.shape == (320, 4, 4, 4, 3) and abs(noise.textures.std().item() - 0.05) < 0.002


def test_colours_of_vertices_and_faces():
    vertices, faces = icosphere(2)
    colors = torch.rand(len(vertices), 3, generator=torch.Generator().manual_seed(0))
    mesh = Mesh(vertices, faces, vertex_colors=colors.numpy(), texture_size=3)
    last = mesh.textures.detach()
    for corner, texel in enumerate([(2, 0, 0), (0, 2, 0), (0, 0, 2)]):
        torch.testing.assert_close(last[(slice(None), *texel)], colors[faces.long()][:, corner])
    torch.testing.assert_close(last[:, 1, 1, 1], colors[faces.long()].mean(1))
    paint = torch.rand(len(faces), 3, generator=torch.Generator().manual_seed(1))
    flat = Mesh(vertices, faces, face_colors=paint, texture_size=1)
    assert torch.equal(flat.textures.reshape(-1, 3), paint)
    for wrong, sentence in [
        ({"vertex_colors": colors, "face_colors": paint}, "textures: expected one of"),
        ({"vertex_colors": colors, "textures": flat.textures}, "textures: expected one of"),
        ({"vertex_colors": paint}, r"vertex_colors: expected shape \[162, 3\]"),
        ({"face_colors": colors}, r"face_colors: expected shape \[320, 3\]"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            Mesh(vertices, faces, **wrong)


def test_colours_are_kept_until_textures_are_asked_for():
    vertices, faces = icosphere(2)
    colors = torch.rand(len(vertices), 3, generator=torch.Generator().manual_seed(0))
    mesh = Mesh(vertices, faces, vertex_colors=colors, texture_size=3)
    corners = colors[faces.long()]
    assert mesh.vertex_colors is colors and mesh.face_colors is None and mesh.texture_size == 3
    assert torch.equal(mesh.colors_of_faces(), corners) and repr(mesh).endswith("320 faces, vertex colors, cpu)")
    assert mesh.cubes().shape == (320, 3, 3, 3, 3) and mesh.vertex_colors is colors
    assert torch.equal(mesh.submesh(slice(5, 9)).colors_of_faces(), corners[5:9])
    assert mesh.subdivide().vertex_colors.shape == (642, 3)
    torch.testing.assert_close(mesh.subdivide().colors_of_faces()[::4, 0], corners[:, 0])
    soup = Mesh(
        vertices[faces.long()].flatten(0, 1), torch.arange(960).view(-1, 3), vertex_colors=corners.flatten(0, 1)
    )
    assert torch.equal(soup.merge_vertices().colors_of_faces(), corners)
    torn = Mesh(soup.vertices, soup.faces, vertex_colors=torch.rand(960, 3)).merge_vertices()
    assert torn.vertex_colors is None and torn.textures.shape == (320, 4, 4, 4, 3)
    optimised = mesh.trainable()
    assert [name for name, _ in optimised.named_parameters()] == ["vertices", "vertex_colors"]
    for copied in (copy.deepcopy(optimised), pickle.loads(pickle.dumps(optimised)), optimised.to(torch.float32)):
        assert torch.equal(copied.colors_of_faces(), corners)
    baked = mesh.textures
    assert mesh.textures is baked and mesh.vertex_colors is None and mesh.colors_of_faces() is baked
    flat = Mesh(vertices, faces, face_colors=torch.rand(320, 3))
    assert flat.colors_of_faces().shape == (320, 1, 1, 1, 3) and flat.subdivide().face_colors.shape == (1280, 3)
    flat.textures = torch.ones(320, 2, 2, 2, 3)
    assert flat.face_colors is None and flat.texture_size == 2


def test_replace_keeps_the_kind_of_colours():
    vertices, faces = icosphere(1)
    mesh = Mesh(vertices, faces, vertex_colors=vertices.abs(), texture_size=2)
    moved = mesh.replace(vertices=2 * vertices)
    assert moved.vertex_colors is mesh.vertex_colors and moved.texture_size == 2
    assert torch.equal(moved.vertices, 2 * vertices)
    paint = torch.rand(len(faces), 3)
    painted = mesh.replace(face_colors=paint)
    assert painted.face_colors is paint and painted.vertex_colors is None
    assert torch.equal(painted.replace(textures=painted.cubes()).textures, painted.cubes())
    assert mesh.vertex_colors is not None and mesh.to_trimesh() is not None and mesh.vertex_colors is not None
    with pytest.raises(TypeError, match="uv: expected some of vertices, faces, textures, vertex_colors, face_colors"):
        mesh.replace(uv=paint)


def test_submesh_and_merged_vertices_agree_with_trimesh():
    vertices, faces = icosphere(2)
    soup = vertices[faces.long()].reshape(-1, 3)
    mesh = Mesh(soup, torch.arange(len(soup)).reshape(-1, 3), torch.rand(len(faces), 2, 2, 2, 3)).trainable()
    mesh.set_lr(0.5, 2.0)
    merged = mesh.merge_vertices()
    theirs = trimesh.Trimesh(soup.numpy(), np.arange(len(soup)).reshape(-1, 3), process=False)
    theirs.merge_vertices()
    assert merged.num_vertices == len(theirs.vertices) == 162
    assert torch.equal(merged.vertices[merged.faces.long()], mesh.vertices[mesh.faces.long()])
    assert torch.equal(merged.textures, mesh.textures) and merged.vertices.lr == 0.5
    assert merged.faces[0].tolist() == [0, 1, 2]  # the first of each place, in order
    moved = Mesh(soup + 1e-4 * torch.rand(soup.shape), mesh.faces)
    assert moved.merge_vertices().num_vertices == len(soup) and moved.merge_vertices(0.1).num_vertices < 400
    index = [5, 7, 300]
    part = merged.submesh(index)
    theirs = theirs.submesh([index], append=True, repair=False)
    assert part.num_vertices == len(theirs.vertices) and part.num_faces == 3
    assert torch.equal(part.vertices[part.faces.long()], merged.vertices[merged.faces[index].long()])
    assert torch.equal(part.textures, merged.textures[index]) and part.textures.lr == 2.0
    mask = torch.zeros(320, dtype=torch.bool)
    mask[index] = True
    assert torch.equal(merged.submesh(mask).faces, part.faces)
    for wrong, sentence in [
        ([], "at least one face"),
        ([320], r"indices in \[0, 320\)"),
        (mask[1:], "a bool for each"),
    ]:
        with pytest.raises(ValueError, match=f"index: expected {sentence}"):
            merged.submesh(wrong)
    with pytest.raises(ValueError, match="tolerance: expected"):
        merged.merge_vertices(-1)


def test_old_forms(file):
    chainer = Mesh(str(file), 5)
    assert chainer.texture_size == 5 and chainer.vertices.abs().max() == 1 and chainer.textures.abs().max() < 0.5
    assert Mesh(file, 2, False).vertices.max() == 3.5
    assert Mesh(file, texture_size=2, normalization=False).vertices.max() == 3.5
    noise = Mesh.fromobj(file, texture_size=3)
    assert noise.texture_size == 3 and noise.textures.min() < 0
    loaded = Mesh.fromobj(str(file), normalization=False, load_texture=True, texture_size=2)
    assert torch.equal(loaded.textures, load_obj(file, False, 2, True)[2])


def test_load_save_normalize(file, tmp_path):
    mesh = Mesh.load(file, texture_size=2)
    assert mesh.vertices.max() == 3.5
    assert torch.equal(mesh.normalize().vertices, Mesh.load(file, 2, normalize=True).vertices)
    assert torch.allclose(mesh.normalize().vertices, load_obj(file)[0])
    for name in ("out/m.obj", "out/m.ply", "out/m.glb"):
        mesh.save(tmp_path / name)
        again = Mesh.load(tmp_path / name, texture_size=2)
        assert again.num_faces == 12
        assert torch.allclose(again.vertices[again.faces.long()], mesh.vertices[mesh.faces.long()])
    teapot = Mesh.load(TEAPOT)
    assert teapot.texture_size == 4 and (teapot.textures == 1).all()
    with pytest.raises(ValueError, match="all coincide"):
        Mesh(torch.ones(3, 3), torch.tensor([[0, 1, 2]])).normalize()


def test_normalized_copies_keep_rates_and_what_is_frozen():
    class Named(Mesh):
        pass

    mesh = Named(*cube(5.0), texture_size=2).trainable()
    mesh.set_lr(0.1, 2.0)
    mesh.textures.requires_grad_(False)
    copied = mesh.normalize()
    assert type(copied) is Named and copied.vertices.abs().max() == 1 and mesh.vertices.max() == 2.5
    assert (copied.vertices.lr, copied.textures.lr) == (0.1, 2.0)
    assert copied.vertices.requires_grad and not copied.textures.requires_grad
    assert copied.vertices.is_leaf and copied.textures.data_ptr() != mesh.textures.data_ptr()
    with torch.no_grad():
        mesh.vertices[0] = torch.nan
    with pytest.raises(ValueError, match="vertices: expected finite"):
        mesh.normalize()


def test_batch_is_a_view_with_sigmoid():
    mesh = Mesh(*cube(), texture_size=2).trainable()
    vertices, faces, textures = mesh.get_batch(5)
    assert vertices.shape == (5, 8, 3) and faces.shape == (5, 12, 3) and textures.shape == (5, 12, 2, 2, 2, 3)
    assert vertices.data_ptr() == mesh.vertices.data_ptr() and vertices.stride(0) == textures.stride(0) == 0
    assert torch.equal(textures[3], torch.sigmoid(mesh.textures))
    (vertices.sum() + textures.sum()).backward()
    assert (mesh.vertices.grad == 5).all() and mesh.textures.grad.abs().min() > 0


def test_module_habits():
    mesh = Mesh.icosphere(1, 2.0, texture_size=3).trainable()
    assert (mesh.textures == 1).all() and torch.allclose(mesh.vertices.norm(dim=1), torch.tensor(2.0))
    mesh.set_lr(0.1, 2.0)
    assert (mesh.vertices.lr, mesh.textures.lr) == (0.1, 2.0)
    other = Mesh(torch.zeros(42, 3), mesh.faces, texture_size=3).trainable()
    other.load_state_dict(mesh.state_dict())
    assert torch.equal(other.vertices, mesh.vertices) and set(mesh.state_dict()) == {"vertices", "textures"}
    assert mesh.to("meta").faces.device.type == "meta"


def test_copies_and_pickles_keep_the_rates(tmp_path):
    mesh = Mesh.icosphere(0, texture_size=2).trainable()
    mesh.set_lr(0.1, 2.0)
    torch.save(mesh, tmp_path / "mesh.pt")
    for other in (
        copy.deepcopy(mesh),
        copy.deepcopy(torch.nn.ModuleList([mesh, mesh]))[1],
        pickle.loads(pickle.dumps(mesh)),
        torch.load(tmp_path / "mesh.pt", weights_only=False),
    ):
        assert (other.vertices.lr, other.textures.lr) == (0.1, 2.0) and isinstance(other, Mesh)
        assert torch.equal(other.vertices, mesh.vertices) and torch.equal(other.faces, mesh.faces)
        assert other.vertices.data_ptr() != mesh.vertices.data_ptr() and other.vertices.requires_grad
        other.set_lr(0.5, 0.5)
    twice = copy.deepcopy([mesh, mesh])
    assert twice[0] is twice[1] and (mesh.vertices.lr, mesh.textures.lr) == (0.1, 2.0)


@pytest.mark.parametrize(
    ("call", "error", "sentence"),
    [
        (lambda m: m.get_batch(-1), ValueError, "batch_size: expected at least 0, got -1"),
        (lambda m: m.get_batch(1.5), TypeError, "batch_size: expected a whole number, got 1.5"),
        (lambda m: m.get_batch("a"), TypeError, "batch_size: expected a number, got str"),
        (lambda m: m.to("meta").normalize(), ValueError, "vertices: expected a tensor with numbers"),
        (lambda m: Mesh.icosphere(1, "a"), TypeError, "radius: expected a number, got str"),
        (lambda m: Mesh.icosphere(1, texture_size="a"), TypeError, "texture_size: expected a number, got str"),
    ],
)
def test_odd_arguments(call, error, sentence):
    with pytest.raises(error, match=sentence):
        call(Mesh.icosphere(0, texture_size=2))


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
@pytest.mark.parametrize("checked", [True, False])
def test_a_broken_mesh_is_not_saved(tmp_path, suffix, checked):
    vertices, faces = cube()
    check_values(False)
    try:
        broken = [(Mesh(vertices, faces + 5), "faces: expected indices"), (Mesh(vertices / 0, faces), "vertices: exp")]
        check_values(checked)
        for mesh, sentence in broken:
            with pytest.raises(ValueError, match=sentence):
                mesh.save(tmp_path / f"new/mesh{suffix}")
    finally:
        check_values(True)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("change", "error", "sentence"),
    [
        ({"vertices": torch.zeros(8, 2)}, ValueError, r"vertices: expected shape \[V, 3\], got \[8, 2\] float32"),
        ({"vertices": [[0.0, 0, 0], [1.0]]}, TypeError, "vertices: expected a floating-point torch tensor, got list"),
        ({"vertices": torch.full((8, 3), torch.nan)}, ValueError, "vertices: expected finite"),
        ({"faces": torch.full((12, 3), 0.5)}, ValueError, "faces: expected whole numbers"),
        ({"faces": torch.zeros(0, 3, dtype=torch.int32)}, ValueError, "faces: expected at least one"),
        ({"faces": torch.full((12, 3), 8)}, ValueError, r"faces: expected indices in \[0, 8\), got 8"),
        ({"textures": torch.zeros(11, 2, 2, 2, 3)}, ValueError, r"textures: expected shape \[12, T, T, T, 3\]"),
        ({"textures": torch.zeros(12, 2, 2, 3, 3)}, ValueError, "textures: expected cubes"),
        ({"textures": torch.zeros(12, 0, 0, 0, 3)}, ValueError, "T at least 1"),
        ({"vertices": torch.ones(8, 3).to_sparse()}, TypeError, "vertices: expected a dense tensor"),
        ({"faces": cube()[1].to_sparse()}, TypeError, "faces: expected a dense tensor"),
        ({"texture_size": 0}, ValueError, "texture_size: expected at least 1, got 0"),
    ],
)
def test_errors(change, error, sentence):
    vertices, faces = cube()
    with pytest.raises(error, match=sentence):
        Mesh(**({"vertices": vertices, "faces": faces} | change))


def test_numpy_arrays_of_other_types():
    vertices, faces = (x.numpy() for x in cube())
    mesh = Mesh(vertices.astype(np.float64), faces.astype(np.uint32))
    assert mesh.vertices.dtype == torch.float32 and mesh.faces.dtype == torch.int32


def test_submesh_takes_slices_and_names_what_it_does_not():
    mesh = Mesh.icosphere(1)
    assert torch.equal(mesh.submesh(slice(4, 8)).textures, mesh.textures[4:8])
    assert mesh.submesh(slice(None, None, -1)).num_faces == 80
    with pytest.raises(TypeError, match="index: expected face indices, or a bool for each face, got str"):
        mesh.submesh("all")


@pytest.mark.parametrize("name", ["vertex_colors", "face_colors"])
def test_colors_that_are_not_finite_are_named(name):
    vertices, faces = icosphere(1)
    colors = torch.full((len(vertices if name == "vertex_colors" else faces), 3), float("nan"))
    with pytest.raises(ValueError, match=f"^{name}: expected finite numbers"):
        Mesh(vertices, faces, **{name: colors})
    mesh = Mesh(vertices, faces, **{name: torch.zeros_like(colors)})
    getattr(mesh, name)[5] = float("nan")  # after the check
    with pytest.raises(ValueError, match=f"^{name}: expected finite numbers"):
        render(mesh, Camera.look_at((0.0, 0.0, -2.7)), 8)


def test_textures_in_the_memory_of_an_array_are_checked_in_each_call():
    vertices, faces = icosphere(4)
    texels = np.zeros((len(faces), 2, 2, 2, 3), np.float32)
    scene = (vertices, faces, torch.from_numpy(texels)), Camera.look_at((0.0, 0.0, -2.7)), 8
    render(*scene)
    texels[0] = np.nan  # which torch does not count as a change
    with pytest.raises(ValueError, match=r"^textures: expected finite numbers"):
        render(*scene)
