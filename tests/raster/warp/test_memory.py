"""Memory that is kept for the images of the next step: used again only when nothing needs it, and bounded."""

from __future__ import annotations

import copy
import gc
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster.warp import memory

CPU = torch.device("cpu")
LARGE = memory.LEAST // 4  # numbers


@pytest.fixture(autouse=True)
def nothing_kept() -> Iterator[None]:
    gc.collect()
    memory._free.clear()
    yield
    memory._free.clear()


def kept() -> list[int]:
    return [block.size for block in memory._free.values()]


@pytest.mark.parametrize("dtype", [torch.float32, torch.int32])
def test_memory_of_the_same_size_is_used_again(dtype: torch.dtype) -> None:
    first = memory.empty((2, LARGE), CPU, torch.float32)
    place = first.data_ptr()
    assert not kept()
    del first
    assert kept() == [8 * LARGE]
    other = memory.empty((LARGE,), CPU, dtype)
    assert other.data_ptr() != place
    again = memory.empty((LARGE, 2), CPU, dtype)
    assert (again.data_ptr(), again.dtype, again.shape) == (place, dtype, (LARGE, 2)) and not kept()


def test_zeros_are_cleared_memory() -> None:
    place = memory.empty((LARGE,), CPU).fill_(7).data_ptr()
    zeros = memory.zeros((LARGE,), CPU)
    assert zeros.data_ptr() == place and not zeros.any()
    large = memory.zeros((memory.MOST_CLEARED // 4 + 1,), CPU)
    del large
    assert not kept()


def test_small_tensors_are_torchs_own() -> None:
    tensor = memory.empty((LARGE - 1,), CPU)
    del tensor
    assert not kept()
    assert memory.empty((0, LARGE), CPU).shape == (0, LARGE)


@pytest.mark.parametrize(
    "hold",
    [
        lambda tensor: tensor[5:6],
        lambda tensor: tensor.numpy(),
        lambda tensor: tensor.view(torch.uint8),
        lambda tensor: memoryview(tensor.numpy()),
        lambda tensor: tensor.requires_grad_().square().sum(),  # its graph needs the numbers
        lambda tensor: torch.from_dlpack(tensor),
        lambda tensor: tensor.untyped_storage(),
    ],
)
def test_memory_that_something_needs_is_not_used(hold) -> None:
    tensor = memory.empty((LARGE,), CPU).fill_(7)
    place = tensor.data_ptr()
    holder = hold(tensor)
    del tensor
    gc.collect()
    assert not kept() and memory.empty((LARGE,), CPU).data_ptr() != place
    del holder
    gc.collect()
    assert kept()[0] == 4 * LARGE


def test_what_is_kept_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest goes first; what is larger than all that may be kept drives nothing out."""
    monkeypatch.setattr(memory, "MOST", 6 * memory.LEAST)
    tensors = {size: memory.empty((size * LARGE,), CPU) for size in (3, 2, 1, 4, 7)}
    found = []
    for size in (3, 2, 1, 4, 7):
        del tensors[size]
        found.append([bytes_ // memory.LEAST for bytes_ in kept()])
    assert found == [[3], [3, 2], [3, 2, 1], [1, 4], [1, 4]]


def test_copies_and_shared_memory() -> None:
    tensor = memory.empty((LARGE,), CPU).fill_(3)
    twin = copy.deepcopy(tensor)
    shared = memory.empty((LARGE,), CPU).fill_(4).share_memory_()
    del tensor
    memory.empty((LARGE,), CPU).fill_(5)
    assert (twin == 3).all() and (shared == 4).all()


def test_images_of_many_threads_are_their_own() -> None:
    mesh, camera = nr.Mesh.icosphere(1), nr.Camera.look_at((0.0, 0.0, -3.0))
    colors = torch.linspace(0.1, 0.9, 8)

    def draw(n: int) -> bool:
        background = float(colors[n % 8])
        fragments = nr.fragments(mesh, camera, 300, anti_aliasing=False)
        images = [fragments.composite(torch.zeros(1, 300, 300, 4), background=background) for _ in range(3)]
        return all(bool((image[:, :, 0, 0] == background).all()) for image in images)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(draw, range(64)))
