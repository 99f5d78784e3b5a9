"""Where users meet the limits: second derivatives, default dtypes, huge indices, broadcasting, flags."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensor, FakeTensorMode
from torch.fx.experimental.proxy_tensor import make_fx
from torch.utils.flop_counter import FlopCounterMode

import neural_renderer as nr
from tests.rounding import rounding

# Torch computes the light of tensors that kernels cannot read. A component of a normal is a quotient of a difference of
# two products, and of a square root of a sum of three squares; here none of them cancels by more than a factor of 4.
LIT = rounding(64)


@pytest.fixture
def scene(device):
    mesh = nr.Mesh.icosphere(1, texture_size=2).to(device)
    return (mesh.vertices.detach(), mesh.faces, mesh.textures.detach()), nr.Camera.look_at((0.0, 0.0, -3.0))


@pytest.mark.parametrize("output", ["rgb", "alpha", "depth"])
def test_second_derivatives_are_refused(scene, output):
    (vertices, faces, textures), camera = scene
    vertices = vertices.clone().requires_grad_()
    image = getattr(nr.render((vertices, faces, textures), camera, 16, outputs=output), output)
    (first,) = torch.autograd.grad(image.square().sum(), vertices, create_graph=True)
    with pytest.raises(RuntimeError, match="first derivatives only"):
        torch.autograd.grad(first.square().sum(), vertices)


def test_the_default_dtype_does_not_matter(scene):
    mesh, camera = scene
    want = nr.render(mesh, camera, 16)
    torch.set_default_dtype(torch.float64)
    try:
        found = nr.render(mesh, camera, 16)
    finally:
        torch.set_default_dtype(torch.float32)
    assert all(torch.equal(a, b) for a, b in zip(found, want, strict=True))


@pytest.mark.parametrize("default", ["meta", "cuda"])
def test_the_default_device_does_not_matter(tmp_path, default):
    """Whatever `torch.set_default_device` says, lists and files are read on the CPU; without CUDA making one fails."""
    path = tmp_path / "ball.obj"
    nr.save_obj(path, *nr.icosphere(0))
    with torch.device(default):
        meshes = nr.Mesh.icosphere(0), nr.Mesh.load(path).normalize()
        cameras = (
            nr.Camera.look_at((0, 0, 3.0)),
            nr.Camera.look((0, 0, 3.0), (0, 0, -1)),
            nr.Camera.look_at(nr.get_points_from_angles(3, [0.0, 30.0], 0)),
            nr.Camera.projection([[8, 0, 4], [0, 8, 4], [0, 0, 1]], np.eye(3), [0, 0, 3], orig_size=8),
        )
        for mesh, camera in itertools.product(meshes, cameras):
            images = nr.render(mesh, camera, 8, background=[0.5, 0.5, 0.5])
            assert images.rgb.device.type == "cpu" and images.alpha.any()
        mesh = meshes[0]
        found = nr.Renderer(8, camera_mode="look")(mesh.vertices[None], mesh.faces[None], mesh.textures[None])
        assert found[0].device.type == "cpu" and nr.perspective(mesh.vertices).device.type == "cpu"


def test_views_that_numpy_does_not_know(tmp_path, scene):
    (vertices, faces, textures), camera = scene
    want = nr.render((vertices, faces, textures), camera, 16, light=nr.Light())
    views = torch._neg_view(-vertices), torch.complex(vertices, -vertices).conj().imag
    for view in views:
        assert view.is_neg()
        found = nr.render((view, faces, textures), camera, 16, light=nr.Light())
        assert torch.equal(found.alpha, want.alpha) and torch.equal(found.depth, want.depth)
        torch.testing.assert_close(found.rgb, want.rgb, **LIT)
        nr.save_obj(tmp_path / "ball.obj", view, faces)
        assert torch.equal(nr.load_obj(tmp_path / "ball.obj", False)[0], vertices.cpu())
        with pytest.raises(ValueError, match="vertices: expected finite numbers, got"):
            nr.render((view / 0, faces, textures), camera, 16)


def test_tracers_are_not_asked_for_numbers(scene):
    mesh, camera = scene
    vertices, *others = mesh
    traced = make_fx(lambda v: nr.render((v, *others), camera, 16, light=nr.Light()).rgb)(vertices)
    torch.testing.assert_close(traced(vertices), nr.render(mesh, camera, 16, light=nr.Light()).rgb, **LIT)
    with FakeTensorMode() as mode:
        fakes = [mode.from_tensor(tensor) for tensor in mesh]
        found = nr.render(tuple(fakes), nr.Camera.look_at((0.0, 0.0, -3.0)), 16)
    assert type(found.rgb) is FakeTensor and found.rgb.shape == (1, 3, 16, 16)
    with FlopCounterMode(display=False), pytest.raises(ValueError, match="vertices: expected finite numbers"):
        nr.render((vertices / 0, *others), camera, 16)


def test_indices_that_wrap_in_32_bits_are_out_of_range(scene):
    (vertices, faces, _), camera = scene
    for shift in (2**32, -(2**40)):
        with pytest.raises(ValueError, match="faces: expected indices"):
            nr.render((vertices, faces.long() + shift), camera, 16, outputs="alpha")
        nr.check_values(False)
        try:
            assert nr.render((vertices, faces.long() + shift), camera, 16, outputs="alpha").alpha.sum() == 0
        finally:
            nr.check_values(True)


WHOLE = [torch.uint8, torch.int8, torch.int16, torch.uint16, torch.uint32, torch.uint64, torch.int64]
WHOLE += [torch.float16, torch.bfloat16, torch.float32, torch.float64]


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("dtype", WHOLE)
def test_faces_of_any_dtype_that_holds_whole_numbers(tmp_path, scene, dtype):
    (vertices, faces, textures), camera = scene
    other = faces.to(dtype)
    renderer = nr.Renderer(16, camera_mode="look_at")
    calls = {
        "render": lambda f: nr.render((vertices, f, textures), camera, 16).rgb,
        "list": lambda f: nr.render([nr.Mesh(vertices, f, textures)], camera, 16).rgb,
        "Renderer": lambda f: renderer(vertices[None], f[None], textures[None])[0],
        "silhouettes": lambda f: renderer(vertices[None], f, mode="silhouettes"),
        "corners": lambda f: nr.vertices_to_faces(vertices[None], f[None]),
        "normals": lambda f: nr.vertex_normals(vertices, f),
        "Mesh": lambda f: nr.Mesh(vertices, f).faces,
        "fragments": lambda f: nr.fragments((vertices, f), camera, 16).interpolate(vertices, f),
        "losses": lambda f: nr.losses.smoothness(vertices, f),
    }
    for name, call in calls.items():
        assert torch.equal(call(other), call(faces)), name
    nr.save_obj(tmp_path / "ball.obj", vertices, other)
    assert torch.equal(nr.load_obj(tmp_path / "ball.obj", False)[1], faces.cpu())
    assert other.dtype == dtype


def test_files_never_hold_fractions(tmp_path, scene):
    (vertices, faces, _), _ = scene
    nr.check_values(False)
    try:
        with pytest.raises(ValueError, match="faces: expected whole numbers"):
            nr.save_obj(tmp_path / "ball.obj", vertices, faces + 0.5)
    finally:
        nr.check_values(True)


def test_checks_are_not_switched_off_by_accident():
    with pytest.raises(TypeError, match="enabled: expected True or False"):
        nr.check_values(None)


def test_one_mesh_for_faces_of_a_batch(device, scene):
    (vertices, faces, textures), _ = scene
    renderer = nr.Renderer(16, camera_mode="look_at")
    renderer.eye = torch.tensor([[0.0, 0.0, -3.0], [0.0, 2.0, -3.0]], device=device)
    batched = renderer(vertices[None], faces[None].repeat(2, 1, 1), textures[None])
    shared = renderer(vertices[None], faces, textures[None])
    assert all(torch.equal(a, b) for a, b in zip(batched, shared, strict=True))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"outputs": None}, "outputs"),
        ({"two_sided": "x"}, "two_sided"),
        ({"anti_aliasing": "no"}, "anti_aliasing"),
        ({"background": [float("nan")] * 3}, "background"),
    ],
)
def test_what_does_not_fit_is_named(scene, change, message):
    mesh, camera = scene
    with pytest.raises((TypeError, ValueError), match=message):
        nr.render(mesh, camera, 16, **change)


def test_arrays_and_bad_angles_are_named(scene):
    (vertices, faces, _), camera = scene
    arrays = nr.render((vertices.cpu().double().numpy(), faces.tolist()), camera, 16)
    assert torch.equal(arrays.rgb, nr.render((vertices.cpu(), faces.cpu()), camera, 16).rgb)
    with pytest.raises(TypeError, match="vertices"):
        nr.render(([[0.0, 1.0, 2.0], [0.0]], faces.cpu().numpy()), camera)
    with pytest.raises(ValueError, match="viewing_angle"):
        nr.Renderer(camera_mode="look_at", viewing_angle=0)


def test_strided_background_colours(device, scene):
    mesh, camera = scene
    colour = torch.rand(3, 4, device=device)[:, 0]
    found = nr.render(mesh, camera, 16, outputs="rgb", background=colour).rgb
    assert torch.equal(found, nr.render(mesh, camera, 16, outputs="rgb", background=colour.tolist()).rgb)
