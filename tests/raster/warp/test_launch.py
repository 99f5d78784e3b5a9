"""How kernels run: the same bits from run to run, whatever the threads; from many threads, after fork, under spawn."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from subprocess import CompletedProcess

import pytest
import torch

import neural_renderer as nr
from neural_renderer.base import private
from neural_renderer.raster.warp import launch
from tests.programs import run_python
from tests.raster.scenes import FRONT, Scene


def everything(device="cpu", batch=1, seed=0):
    """All images of a scene and all gradients."""
    scene = Scene(seed, batch, 40, 48, 40, True, True, FRONT)
    faces = scene.faces.to(device).requires_grad_()
    cubes = scene.noise(1, 40, 3, 3, 3, 3).to(device).requires_grad_()
    light = scene.noise(1, 2, 40, 3).to(device).requires_grad_()
    images = nr.rasterize_images(faces, (48, 40), textures=cubes, light=light, two_sided=True)
    loss = sum((image * scene.noise(*image.shape).to(device)).sum() for image in images)
    return [*images, *torch.autograd.grad(loss, (faces, cubes, light))]


def equal(one, other):
    return all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.usefixtures("deterministic")
def test_launched_by_warp_as_directly(monkeypatch, device):
    """Where the compiled code is not known, Warp's public function launches kernels."""
    expected = everything(device)
    entries = "_entries" if device == "cpu" else "_on_cuda"
    monkeypatch.setattr(private, "compiled", lambda kernel: None)
    monkeypatch.setattr(private, "compiled_on_cuda", lambda kernel, device: None)
    monkeypatch.setattr(launch, entries, {})
    found = everything(device)
    assert getattr(launch, entries) and equal(found, expected)


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("batch", [1, 2, 3, 16])
def test_same_bits_whatever_the_threads(threads, batch):
    results = []
    for count in (1, 2, 3, 1, 8):
        threads(count)
        results.append(everything(batch=batch))
    assert all(equal(results[0], other) for other in results[1:])
    assert all(t.any() for t in results[0])


@pytest.mark.usefixtures("deterministic")
def test_same_bits_from_run_to_run(device):
    first = everything(device, 2)
    assert all(equal(first, everything(device, 2)) for _ in range(5))


def test_batch_is_its_images_one_by_one(device):
    scene = Scene(1, 3, 40, 30, 30, True, True, FRONT)
    faces = scene.faces.to(device)
    together = nr.rasterize_images(faces, 30, outputs=("alpha", "depth"))
    for b in range(3):
        alone = nr.rasterize_images(faces[b : b + 1], 30, outputs=("alpha", "depth"))
        assert torch.equal(alone.alpha[0], together.alpha[b]) and torch.equal(alone.depth[0], together.depth[b])


def test_several_python_threads_at_once(device):
    expected = [everything(device, 2, seed) for seed in range(4)]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda n: everything(device, 2, n % 4), range(48)))
    for n, result in enumerate(found):
        if device == "cpu":
            assert equal(result, expected[n % 4])
        else:  # several CUDA threads share a face's sums
            for a, b in zip(result, expected[n % 4], strict=True):
                torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3)


PRELUDE = """
import multiprocessing, os, sys, threading, torch
import neural_renderer as nr
torch.set_num_threads(2)
def total(_=0):
    random = torch.Generator().manual_seed(0)
    faces = (torch.rand(3, 9, 3, 3, generator=random) * 2 - 1 + torch.tensor([0, 0, 2.0])).requires_grad_()
    nr.rasterize_silhouettes(faces, 32).square().sum().backward()
    return float(faces.grad.abs().sum())
"""

FORK = """
first = total()
# While another thread renders, the pool and the locks are in use at the moment of the fork.
stop = threading.Event()
busy = threading.Thread(target=lambda: [total() for _ in iter(stop.is_set, True)])
busy.start()
torch.set_num_threads(2)
for _ in range(10):
    child = os.fork()
    if child == 0:
        os._exit(0 if total() == first else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
stop.set()
busy.join()
"""

# As data loaders do: workers forked before and after the first kernel has run.
WORKERS = """
if __name__ == "__main__":
    method = sys.argv[1]
    # One spawned worker is like another; forked ones share what was there before.
    workers = 2 if method == "fork" else 1
    with multiprocessing.get_context(method).Pool(workers) as pool:
        early = pool.map(total, range(4))
    first = total()
    assert early == [first] * 4 and first > 0
    if method == "fork":  # a spawned worker knows nothing of what ran before
        with multiprocessing.get_context(method).Pool(workers) as pool:
            assert pool.map(total, range(4)) == early
"""


def run(tmp_path, code: str, *arguments: str) -> CompletedProcess[str]:
    script = tmp_path / "script.py"
    script.write_text(PRELUDE + code)
    done = run_python(script, *arguments)
    assert done.returncode == 0, done.stderr
    return done


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_after_fork(tmp_path):
    run(tmp_path, FORK)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_in_worker_processes(tmp_path, method):
    if method == "fork" and not hasattr(os, "fork"):
        pytest.skip("the system has no fork")
    run(tmp_path, WORKERS, method)


AHEAD = """
from neural_renderer.raster.warp import launch
loaded = []
load = launch.load_module
def record(kernel, device):
    loaded.append(kernel.module.name)
    load(kernel, device)
launch.load_module = record
mesh = nr.Mesh.icosphere()
vertices = mesh.vertices.clone().requires_grad_()
camera = nr.Camera.look_at((0, 0, -2.7))

def check(gradient, outputs):
    images = nr.render((vertices, mesh.faces, mesh.textures), camera, 16, gradient=gradient, outputs=outputs)
    together = set(loaded)
    sum(image.sum() for image in images if image is not None).backward()
    assert set(loaded) == together == {kernel.module.name for kernel in launch._entries}, (loaded, together)

# A child process each, which has loaded nothing yet.
for gradient in "nmr", "edge":
    for outputs in ("rgb", "alpha", "depth"), ("alpha",):
        child = os.fork()
        if child == 0:
            check(gradient, outputs)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, (gradient, outputs)

# The core imports no application, nor does the package for it, before a notebook shows a picture or a name is used.
def applications():
    return [name for name in sys.modules if name.startswith("neural_renderer.apps")]

images = nr.render(mesh, camera, 16)
assert not applications()
assert images._repr_png_().startswith(b"\\x89PNG") and applications()
assert callable(nr.finish)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_kernels_that_a_render_needs_are_loaded_together(tmp_path):
    """All of them before the first one runs, and no others; and none of them prints."""
    done = run(tmp_path, AHEAD)
    assert (done.stdout, done.stderr) == ("", "")
