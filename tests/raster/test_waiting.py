"""No step waits for a GPU while values are unchecked, and with checks it does so once: counted on an emulated one."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.base import validate
from neural_renderer.raster.warp import launch, layout
from tests.cuda_emulation.tensors import Gpu, GpuTensor


@pytest.fixture
def gpu(request, monkeypatch):
    """Without --emulated-cuda no kernel runs: what waits does not depend on their results."""
    if request.config.getoption("--emulated-cuda") is None:
        monkeypatch.setattr(launch, "emulator", lambda *launched: True)
    monkeypatch.setattr(layout, "as_on_cuda", True)
    # Values of torch's own kinds of tensors alone are checked.
    monkeypatch.setattr(validate, "values_are_checked", lambda value: validate._check_values)
    yield Gpu()
    validate.check_values(True)


def on_gpu(tensor):
    return GpuTensor(tensor.detach().clone()).requires_grad_(tensor.is_floating_point())


def scene(kind):
    """A mesh, and the tensors of it that get gradients."""
    vertices, faces = nr.icosphere(1)
    if kind == "cubes":
        return tuple(map(on_gpu, (vertices, faces, torch.rand(80, 2, 2, 2, 3))))
    return nr.UVMesh(
        on_gpu(vertices),
        on_gpu(faces),
        on_gpu(torch.rand(80, 3, 2)),
        on_gpu(torch.arange(80, dtype=torch.int32) % 3 - 1),
        (on_gpu(torch.rand(8, 8, 3)), on_gpu(torch.rand(4, 4, 3))),
        on_gpu(torch.rand(80, 3, 3)),
        ("repeat", "clamp"),
    )


def step(gpu, mesh, gradient, output):
    """One step as in a training, after two that may remember what stays the same; returns what the third counted."""
    camera = nr.Camera.look_at(GpuTensor(torch.tensor([[0.0, 1.0, -2.5], [1.0, 0.0, 2.0]])))
    light = nr.Light()
    for _ in range(3):
        gpu.waits.clear()
        gpu.copies.clear()
        images = nr.render(mesh, camera, 16, outputs=(output,), gradient=gradient, light=light)
        getattr(images, output).sum().backward()
    return gpu.waits.total(), gpu.copies.total()


@pytest.mark.parametrize(
    ("kind", "output"), [("cubes", "alpha"), ("cubes", "rgb"), ("cubes", "depth"), ("images", "rgb")]
)
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_nothing_waits_without_checks(gpu, kind, output, gradient):
    with gpu:
        nr.check_values(False)
        assert step(gpu, scene(kind), gradient, output) == (0, 0), (gpu.waits, gpu.copies)


@pytest.mark.parametrize("kind", ["cubes", "images"])
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_all_checks_of_a_call_wait_once(request, gpu, kind, gradient):
    if request.config.getoption("--emulated-cuda") is None:
        pytest.skip("checks look at the results of kernels, which run under --emulated-cuda")
    with gpu:
        assert step(gpu, scene(kind), gradient, "rgb") == (1, 0), (gpu.waits, gpu.copies)


@pytest.mark.parametrize("kind", ["vertices", "faces", "textures"])
def test_checks_that_are_read_at_the_end_say_the_same(request, gpu, kind):
    """The first that fails raises the error that it would have raised on the CPU."""
    if request.config.getoption("--emulated-cuda") is None:
        pytest.skip("checks look at the results of kernels, which run under --emulated-cuda")
    vertices, faces = nr.icosphere(0)
    mesh = {"vertices": vertices, "faces": faces, "textures": torch.rand(20, 2, 2, 2, 3)}
    mesh[kind].view(-1)[3] = 99 if kind == "faces" else torch.nan
    mesh["textures"][1, 1, 1, 1] = torch.inf
    camera = nr.Camera.look_at((0.0, 1.0, -2.5))
    with pytest.raises(ValueError) as here:
        nr.render(tuple(mesh.values()), camera, 16)
    with gpu, pytest.raises(ValueError) as there:
        nr.render(tuple(map(on_gpu, mesh.values())), camera, 16)
    assert str(there.value) == str(here.value)
