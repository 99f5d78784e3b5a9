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


STEPS = """
import os, threading
import torch
import neural_renderer as nr

def threads_of_torch():
    return len(os.listdir("/proc/self/task")) - threading.active_count()

def steps(level, images, size):
    ball = nr.Mesh.icosphere(level)
    camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 30.0, torch.linspace(0.0, 300.0, images)))
    vertices = ball.vertices.clone().requires_grad_()
    cubes, colors = torch.rand(len(ball.faces), 2, 2, 2, 3), ball.vertices.abs()
    meshes = {
        "silhouettes": (vertices, ball.faces),
        "cubes": (vertices, ball.faces, cubes),
        "colours": nr.Mesh(vertices, ball.faces, vertex_colors=colors),
    }
    for name, mesh in meshes.items():
        for gradient in ("nmr", "edge"):
            output = "alpha" if name == "silhouettes" else "rgb"
            yield name, lambda: getattr(nr.render(mesh, camera, size, outputs=(output,), gradient=gradient), output)

    def attributes():
        visible = nr.fragments((vertices, ball.faces), camera, size)
        return visible.composite(visible.interpolate(vertices))

    yield "attributes", attributes

before = threads_of_torch()
for scene in ((5, 1, 64), (3, 8, 128)):
    torch.set_num_threads(1)  # while the scene is made, and its half-edges are found
    for name, draw in steps(*scene):
        torch.set_num_threads(1)
        weights = torch.ones_like(draw())
        draw().backward(weights)
        torch.set_num_threads(2)
        draw().backward(weights)
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
