"""Where users meet the limits: second derivatives, default dtypes, huge indices, broadcasting, flags."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr


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
    with pytest.raises(TypeError, match="vertices"):
        nr.render((vertices.cpu().numpy(), faces.cpu().numpy()), camera)
    with pytest.raises(ValueError, match="viewing_angle"):
        nr.Renderer(camera_mode="look_at", viewing_angle=0)


def test_strided_background_colours(device, scene):
    mesh, camera = scene
    colour = torch.rand(3, 4, device=device)[:, 0]
    found = nr.render(mesh, camera, 16, outputs="rgb", background=colour).rgb
    assert torch.equal(found, nr.render(mesh, camera, 16, outputs="rgb", background=colour.tolist()).rgb)
