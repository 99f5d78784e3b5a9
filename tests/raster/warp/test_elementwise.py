"""Large tensors on the CPU: the same numbers as torch's, without torch's threads, also in a whole step."""

from __future__ import annotations

import sys

import pytest
import torch

from neural_renderer.raster.warp import elementwise
from tests.programs import run_python

LARGE = elementwise.FEW + 5


@pytest.mark.parametrize("count", [7, LARGE])
def test_functions_are_those_of_torch(count):
    values = torch.randn(3, count)[:, ::2]
    assert torch.equal(elementwise.copy(values), values) and elementwise.copy(values).is_contiguous()
    assert torch.equal(elementwise.quarter(values), values / 4)
    assert elementwise.any_of(values) and not elementwise.any_of(torch.zeros(count))
    faces = torch.arange(count, dtype=torch.int32)
    other = faces.clone()
    assert elementwise.equal(faces, other) and not elementwise.equal(faces, other[1:])
    other[-1] = 0
    assert not elementwise.equal(faces, other)


@pytest.mark.parametrize("count", [7, LARGE])
def test_gradients_of_several_uses_are_summed(count):
    tensor = torch.randn(count).requires_grad_()
    first, second, _ = elementwise.apart(tensor, 3)
    weights = torch.randn(2, count)
    (grad,) = torch.autograd.grad((weights[0] * first.square() + weights[1] * second).sum(), tensor, create_graph=True)
    torch.testing.assert_close(grad, 2 * weights[0] * tensor + weights[1])
    (again,) = torch.autograd.grad(grad.sum(), tensor)  # a second derivative
    torch.testing.assert_close(again, 2 * weights[0])
    with torch.no_grad():
        assert elementwise.apart(tensor, 2) == (tensor, tensor)


@pytest.mark.parametrize("count", [7, LARGE])
def test_pieces_are_the_whole(count):
    one, other, each = (torch.randn(2, size, 3, requires_grad=True) for size in (count, count, 1))

    def product(one, other, each):
        return torch.sin(one) * other + each

    pieces, whole = elementwise.in_pieces(product, one, other, each, dim=1), product(one, other, each)
    assert torch.equal(pieces, whole)
    grads = (torch.autograd.grad(image.square().sum(), (one, other, each)) for image in (pieces, whole))
    for ours, theirs in zip(*grads, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("count", [7, LARGE])
def test_joined_and_its_parts_are_those_of_torch(count):
    one, other = (torch.randn(2, size, count, requires_grad=True) for size in (2, 1))
    both = elementwise.joined((one, other), 1)
    assert torch.equal(both, torch.cat((one, other), 1))
    first, _, last = elementwise.views(both, [1, 1, 1], 1)
    assert torch.equal(first, one[:, :1]) and torch.equal(last, other)
    weights = torch.randn(2, 1, count)
    grads = torch.autograd.grad((weights * first * last).sum(), (one, other), create_graph=True)
    expected = torch.autograd.grad((weights * one[:, :1] * other).sum(), (one, other), create_graph=True)
    assert all(map(torch.equal, grads, expected))
    again = (torch.autograd.grad(grads_of[0].square().sum(), other)[0] for grads_of in (grads, expected))
    assert torch.equal(*again)  # a second derivative


STEPS = """
import os, threading
import torch
import neural_renderer as nr

def threads_of_torch():
    return len(os.listdir("/proc/self/task")) - threading.active_count()

def drawn(mesh, camera, size, outputs, **options):
    images = nr.render(mesh, camera, size, outputs=outputs, **options)
    return [getattr(images, name) for name in outputs if getattr(images, name).requires_grad]

def steps(level, images, size):
    ball = nr.Mesh.icosphere(level)
    camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 30.0, torch.linspace(0.0, 300.0, images)))
    vertices = ball.vertices.clone().requires_grad_()
    cubes, colors = torch.rand(len(ball.faces), 2, 2, 2, 3), ball.vertices.abs()
    colored = nr.Mesh(vertices, ball.faces, vertex_colors=colors)
    photo, behind = torch.rand(64, 64, 3, requires_grad=True), torch.rand(3, size, size)
    scenes = {
        "silhouettes": ((vertices, ball.faces), "alpha"),
        "cubes": ((vertices, ball.faces, cubes), "rgb"),
        "colours": (colored, "rgb"),
        "surface": (colored, "depth", "position", "face_index", "barycentric"),
        "image": (nr.UVMesh(vertices, ball.faces, ball.vertices[:, :2], photo), "rgb", "alpha", "depth", "uv"),
    }
    for name, (mesh, *outputs) in scenes.items():
        for gradient in ("nmr", "edge"):
            yield name, lambda: drawn(mesh, camera, size, outputs, gradient=gradient, background=behind)

    yield "plain depth", lambda: drawn(colored, camera, size, ("rgb", "depth"), anti_aliasing=False)

    def attributes():
        visible = nr.fragments((vertices, ball.faces), camera, size)
        return [visible.composite(visible.interpolate(vertices))]

    yield "attributes", attributes

before = threads_of_torch()
for scene in ((5, 1, 64), (3, 8, 128)):
    torch.set_num_threads(1)  # while the scene is made, and its half-edges are found
    for name, draw in steps(*scene):
        torch.set_num_threads(1)
        weights = [torch.ones_like(image) for image in draw()]
        torch.autograd.backward(draw(), weights)
        torch.set_num_threads(2)
        torch.autograd.backward(draw(), weights)
        assert threads_of_torch() == before, (scene, name)
torch.zeros(1 << 20).add(1.0)
assert threads_of_torch() > before  # this is what is looked for
"""


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_a_step_starts_no_threads_of_torch(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(STEPS)
    done = run_python(script, OMP_NUM_THREADS="2")
    assert done.returncode == 0, done.stderr
