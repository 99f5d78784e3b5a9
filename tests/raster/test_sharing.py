"""Sharing of a step's work by the threads of a GPU, counted on an emulated one."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr


@pytest.fixture
def counter(request, emulated_modules):
    if request.config.getoption("--emulated-cuda") is None:
        pytest.skip("operations are counted under --emulated-cuda")
    from tests.cuda_emulation.device import EmulatedDevice

    return EmulatedDevice(emulated_modules, "counts")


def backdrop():
    """Small faces before two that fill the image."""
    vertices, faces = nr.icosphere(3)
    wall = torch.tensor([[-9.0, -9, 2], [9, -9, 2], [9, 9, 2], [-9, 9, 2]])
    quad = torch.tensor([[0, 1, 2], [0, 2, 3]]) + len(vertices)
    return torch.cat((0.5 * vertices, wall)), torch.cat((faces, quad))


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
@pytest.mark.parametrize("output", ["rgb", "depth"])
def test_large_faces_keep_no_thread_busy_for_long(emulated_cuda, counter, output, gradient):
    """A thread for the rows or edges of a face would have thousands of operations for each of the small faces'."""
    vertices, faces = backdrop()
    vertices.requires_grad_()
    textures = torch.rand(len(faces), 2, 2, 2, 3, requires_grad=True)
    camera = nr.Camera.look_at((0.0, 0.0, -2.7))
    with counter:
        images = nr.render((vertices, faces, textures), camera, 64, outputs=(output,), gradient=gradient)
        image = getattr(images, output)
        (image * torch.rand(image.shape, generator=torch.Generator().manual_seed(0))).sum().backward()
    # A scan line has 128 pixels, each with 4 numbers, and a thread one of 8 lanes of 16 lines of 3 edges, along 2 axes.
    longest = {kernel: counts[1] for kernel, counts in counter.measured.items()}
    assert max(longest.values()) <= 2 * 3 * 16 * (16 + 2 * 128 * 4 // 8), longest


@pytest.mark.parametrize(
    ("output", "gradient", "most"), [("alpha", "nmr", 12), ("alpha", "edge", 14), ("rgb", "nmr", 17)]
)
def test_launches_of_a_step(emulated_cuda, counter, output, gradient, most):
    vertices, faces = nr.icosphere(1)
    vertices.requires_grad_()
    mesh = (vertices, faces, torch.rand(len(faces), 2, 2, 2, 3, requires_grad=True))
    with counter:
        images = nr.render(mesh, nr.Camera.look_at((0.0, 0.0, -2.7)), 32, outputs=(output,), gradient=gradient)
        getattr(images, output).sum().backward()
    assert counter.launches.total() <= most, counter.launches
