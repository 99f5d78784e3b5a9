"""No step waits for a GPU, and a graph can capture it from the first one on: counted on an emulated GPU."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
import neural_renderer.nvdiffrast as dr
from neural_renderer.base import constants, validate
from neural_renderer.camera import screen
from neural_renderer.raster.ops import half_edges
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
    validate._earlier().clear()
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


def steps(gpu, mesh, gradient, output, count=3):
    """The first steps of a training; returns the waits and the copies that they counted."""
    camera = nr.Camera.look_at(GpuTensor(torch.tensor([[0.0, 1.0, -2.5], [1.0, 0.0, 2.0]])))
    light = nr.Light()
    gpu.waits.clear()
    gpu.copies.clear()
    for _ in range(count):
        images = nr.render(mesh, camera, 16, outputs=(output,), gradient=gradient, light=light)
        getattr(images, output).sum().backward()
    return gpu.waits.total(), gpu.copies.total()


def drop_in(mode, send):
    """The vertices of a scene by the names of nvdiffrast, in "instanced" or "range" mode, and a step, which draws it.

    ``send`` moves tensors to a GPU.
    """
    vertices, faces = nr.icosphere(1)
    vertices, values = torch.cat((0.7 * vertices, torch.ones(42, 1)), 1), torch.rand(42, 5)
    tri, tex, context = send(faces), send(torch.rand(1, 16, 8, 3)), dr.RasterizeCudaContext()
    ranges = torch.tensor([[0, 40], [20, 60]], dtype=torch.int32) if mode == "range" else None
    pos, attr = (send(one if mode == "range" else one[None]) for one in (vertices, values))

    def step():
        rast, rast_db = dr.rasterize(context, pos, tri, (16, 16), ranges=ranges)
        uv, uv_da = dr.interpolate(attr, rast, tri, rast_db, [3, 1])
        colors = dr.texture(tex, uv[..., :2].contiguous(), uv_da)
        image = dr.antialias(torch.cat((colors, dr.interpolate(attr, rast, tri)[0]), 3), rast, pos, tri)
        image.square().sum().backward()
        with dr.DepthPeeler(context, pos, tri, (16, 16), ranges=ranges) as peeler:
            layers = [peeler.rasterize_next_layer()[0] for _ in range(2)]
        return torch.cat((image, *layers), 3).detach()

    return pos, step


def drop_in_steps(gpu, mode, count=2):
    """The first steps of a training by the names of nvdiffrast, as `steps`."""
    _, step = drop_in(mode, on_gpu)
    gpu.waits.clear()
    gpu.copies.clear()
    for _ in range(count):
        step()
    return gpu.waits.total(), gpu.copies.total()


@pytest.mark.two_devices
@pytest.mark.parametrize("mode", ["instanced", "range"])
def test_a_graph_repeats_a_step_of_the_drop_in(monkeypatch, mode):
    """Checks of the step before are still on their way."""
    monkeypatch.setattr(validate, "_wait", False)
    pos, step = drop_in(mode, lambda one: one.cuda().requires_grad_(one.is_floating_point()))
    stream, graph = torch.cuda.Stream(), torch.cuda.CUDAGraph()
    with torch.cuda.stream(stream):
        step()
    torch.cuda.synchronize()
    with torch.cuda.graph(graph, stream=stream):
        image = step()
    with torch.no_grad():
        pos.mul_(0.9)
        pos.grad.zero_()
    graph.replay()
    repeated, gradient = image.clone(), pos.grad.clone()
    pos.grad.zero_()
    torch.testing.assert_close(repeated, step())
    torch.testing.assert_close(gradient, pos.grad, rtol=1e-4, atol=1e-4 * float(pos.grad.abs().max()))
    nr.check_values(True)


@pytest.mark.parametrize("mode", ["instanced", "range"])
def test_nothing_of_the_drop_in_waits_without_checks(gpu, mode):
    """One copy in range mode: that of the ranges, which nvdiffrast's interface has on the CPU."""
    with gpu:
        nr.check_values(False)
        assert drop_in_steps(gpu, mode) == (0, int(mode == "range")), (gpu.waits, gpu.copies)


@pytest.mark.parametrize(
    ("kind", "output"), [("cubes", "alpha"), ("cubes", "rgb"), ("cubes", "depth"), ("images", "rgb")]
)
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_nothing_waits_without_checks(gpu, kind, output, gradient):
    with gpu:
        nr.check_values(False)
        assert steps(gpu, scene(kind), gradient, output) == (0, 0), (gpu.waits, gpu.copies)


@pytest.fixture
def on_the_way(gpu, monkeypatch):
    """The GPU, while nothing arrives from it and no call waits for its checks."""
    monkeypatch.setattr(validate, "_wait", False)
    gpu.arrived = False


@pytest.mark.usefixtures("on_the_way")
@pytest.mark.parametrize(("kind", "output"), [("cubes", "alpha"), ("images", "rgb")])
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_nothing_waits_with_checks(gpu, kind, output, gradient):
    with gpu:
        assert steps(gpu, scene(kind), gradient, output) == (0, 0), (gpu.waits, gpu.copies)


@pytest.mark.usefixtures("on_the_way")
@pytest.mark.parametrize("mode", ["instanced", "range"])
def test_nothing_of_the_drop_in_waits_with_checks(gpu, mode):
    with gpu:
        assert drop_in_steps(gpu, mode) == (0, int(mode == "range")), (gpu.waits, gpu.copies)


@pytest.mark.usefixtures("on_the_way")
def test_indices_are_checked_once(gpu):
    """Until they are changed; and again after an error, which comes with the first call that knows of it."""
    context, pos = dr.RasterizeCudaContext(), torch.cat((nr.icosphere(1)[0], torch.ones(42, 1)), 1)[None]
    with gpu:
        pos, tri = on_gpu(pos), GpuTensor(nr.icosphere(1)[1])
        for times in (1, 0, 0):
            gpu.operators.clear()
            dr.rasterize(context, pos, tri, (8, 8))
            assert gpu.operators["ge"] == times
            mesh = pos[0, :, :3].detach(), tri
            nr.render(mesh, nr.Camera.look_at(GpuTensor(torch.tensor([[0.0, 1.0, -2.5]]))), 16, outputs=("alpha",))
        tri += 1
        gpu.arrived = True
        for _ in range(2):
            with pytest.raises(ValueError, match=r"^tri: expected indices in \[0, 42\), got 42; in an earlier call"):
                dr.rasterize(context, pos, tri, (8, 8))


@pytest.fixture
def captured(gpu, monkeypatch):
    """The GPU while a graph is captured, with empty caches, which stay empty."""
    caches = constants._constant, screen._constant
    for cache in caches:
        cache.cache_clear()
    half_edges._cache.clear()
    for module in (constants, screen):
        monkeypatch.setattr(module, "capturing", lambda device: device.type == "cuda")
    monkeypatch.setattr(half_edges, "stream_of", lambda device: None)
    yield gpu
    assert not half_edges._cache
    assert not any(cache.cache_info().currsize for cache in caches)


@pytest.mark.parametrize("mode", ["instanced", "range"])
def test_the_first_step_of_the_drop_in_has_nothing_that_a_graph_cannot_capture(captured, mode):
    with captured as gpu:
        nr.check_values(False)
        assert drop_in_steps(gpu, mode, count=1) == (0, 0), (gpu.waits, gpu.copies)


@pytest.mark.parametrize(("kind", "output"), [("cubes", "alpha"), ("cubes", "rgb"), ("images", "rgb")])
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_the_first_step_has_nothing_that_a_graph_cannot_capture(captured, kind, output, gradient):
    """No copies from the host and no waits; and nothing that the graph has computed is kept for other steps."""
    with captured as gpu:
        nr.check_values(False)  # as while a graph is captured
        assert steps(gpu, scene(kind), gradient, output, count=1) == (0, 0), (gpu.waits, gpu.copies)


@pytest.mark.usefixtures("on_the_way")
def test_the_next_call_tells_what_was_wrong(gpu):
    with gpu:
        camera = nr.Camera.look_at(GpuTensor(torch.tensor([[0.0, 1.0, -2.5]])))
        wrong, right = scene("cubes"), scene("cubes")
        wrong[0].inner[0, 0] = torch.nan
        nr.render(wrong, camera, 16, outputs=("alpha",))
        nr.render(right, camera, 16, outputs=("alpha",))  # before the GPU is there
        gpu.arrived = True
        with pytest.raises(
            ValueError, match=r"^vertices: expected finite numbers, got 1 .*in an earlier call on the GPU"
        ):
            nr.render(right, camera, 16, outputs=("alpha",))
        nr.check_values(True)


@pytest.mark.usefixtures("on_the_way")
def test_check_values_waits_for_what_was_wrong(gpu):
    with gpu:
        camera = nr.Camera.look_at(GpuTensor(torch.tensor([[0.0, 1.0, -2.5]])))
        wrong = scene("cubes")
        wrong[0].inner[0, 0] = torch.nan
        nr.render(wrong, camera, 16, outputs=("alpha",))
        gpu.arrived = True
        with pytest.raises(ValueError, match=r"^vertices: expected finite numbers, got 1 "):
            nr.check_values(False)


@pytest.mark.parametrize("kind", ["cubes", "images"])
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_all_checks_of_a_call_that_waits_are_read_once(request, gpu, kind, gradient):
    if request.config.getoption("--emulated-cuda") is None:
        pytest.skip("checks look at the results of kernels, which run under --emulated-cuda")
    with gpu:
        assert steps(gpu, scene(kind), gradient, "rgb") == (3, 0), (gpu.waits, gpu.copies)


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
