"""Estimate a GPU step without a GPU: ``python -m benchmarks.cuda_counts``.

The kernels' CUDA code runs on a processor (`tests/cuda_emulation`), which counts memory operations. Operations of torch
itself are not counted. The columns, for each scene and kernel:

- launches, threads, operations: their numbers; operations are those on memory.
- longest: operations of the longest thread, relative to the mean of the threads that do anything. A launch ends with
  its longest thread.
- busy: fraction of the lanes that work. The other lanes of a warp wait for its longest thread.
- MB moved: between warps and the cache, in sectors of 32 bytes, each counted once for each warp.
- to least: these, relative to the sectors of the launch, each counted once.
- H200 ms: estimated from data sheets; measured kernels took 2 to 7 times as long. Each launch takes
  `OVERHEAD`, plus the longest of four times: the launch's sectors at the memory's bandwidth; the warps' sectors at the
  cache's bandwidth; one memory operation of a warp per clock on each multiprocessor; the operations of the longest
  thread in sequence, four of them in flight.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from rich.console import Console
from rich.table import Table

import neural_renderer as nr
import neural_renderer.nvdiffrast as dr
from neural_renderer.raster.warp import launch, layout, native
from tests.cuda_emulation.device import EmulatedDevice
from tests.cuda_emulation.tensors import Gpu, GpuTensor

OVERHEAD = 3e-6  # seconds from launch to launch
MEMORY, CACHE = 4.8e12, 7e12  # bytes a second
OPERATIONS = 132 * 1.7e9  # of warps a second: multiprocessors times clock
LATENCY = 160e-9 / 4  # seconds from operation to operation of a thread


def sphere(batch: int, level: int) -> tuple[tuple[torch.Tensor, ...], nr.Camera]:
    vertices, faces = nr.icosphere(level)
    textures = torch.rand(len(faces), 2, 2, 2, 3, generator=torch.Generator().manual_seed(0))
    eyes = nr.get_points_from_angles(2.7, 30.0, torch.linspace(0, 300, batch))
    return (vertices, faces, textures), nr.Camera.look_at(eyes, viewing_angle=30.0)


def backdrop(level: int) -> tuple[tuple[torch.Tensor, ...], nr.Camera]:
    """Place a fine mesh in front of four large triangles."""
    (vertices, faces, textures), camera = sphere(1, level)
    wall = camera.rotation[0].T @ torch.tensor([[-4.0, -4, 2], [4, -4, 2], [4, 4, 2], [-4, 4, 2], [0, 0, 2]]).T
    fan = torch.tensor([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]) + len(vertices)
    return (
        torch.cat((vertices, wall.T)),
        torch.cat((faces, fan)),
        torch.cat((textures, textures[:4])),
    ), camera


SCENES: dict[str, tuple[Callable[[], tuple[tuple[torch.Tensor, ...], nr.Camera]], int]] = {
    "4 x 128², 1280 faces": (lambda: sphere(4, 3), 128),
    "1 x 256², 20480 faces": (lambda: sphere(1, 5), 256),
    "1 x 256², 20480 faces before 4": (lambda: backdrop(5), 256),
}
STEPS = [("alpha", "nmr"), ("alpha", "edge"), ("rgb", "nmr"), ("rgb", "edge")]


def counted(device: EmulatedDevice, scene: str, output: str, gradient: str) -> dict[str, tuple[int, list[int]]]:
    """Run one step; returns launches and counts by kernel (see `run` in runtime.h)."""
    make, size = SCENES[scene]
    (vertices, faces, textures), camera = make()
    vertices.requires_grad_()
    textures.requires_grad_()
    device.launches.clear()
    device.measured.clear()
    with device:
        images = nr.render((vertices, faces, textures), camera, size, outputs=(output,), gradient=gradient)
        image = getattr(images, output)
        image.backward(torch.rand(image.shape, generator=torch.Generator().manual_seed(1)) - 0.5)
    return {kernel: (device.launches[kernel], counts) for kernel, counts in device.measured.items()}


def milliseconds(launches: int, counts: list[int]) -> float:
    """Estimate the time on an H200."""
    _, longest, by_warps, _, _, moved, touched = counts
    return 1e3 * (OVERHEAD * launches + max(touched / MEMORY, moved / CACHE, by_warps / OPERATIONS, longest * LATENCY))


def longest_to_mean(counts: list[int]) -> float:
    return counts[1] * counts[3] / counts[0] if counts[0] else math.nan


def busy(counts: list[int]) -> float:
    return counts[0] / (32 * counts[2]) if counts[2] else math.nan


def of_the_host() -> Iterator[tuple[str, ...]]:
    """Count third steps of small scenes, without kernels and checks of values: the cells of `HOST`."""
    numbers: Counter[str] = Counter()

    def launched(kernel: Any, tasks: int, arguments: Sequence[Any]) -> bool:
        numbers["launches"] += 1
        return True

    def made(self: native.Call, **fields: Any) -> None:
        numbers["structs"] += 1
        plain(self, **fields)

    plain = native.Call.__init__
    with (
        mock.patch.object(launch, "emulator", launched),
        mock.patch.object(layout, "as_on_cuda", True),
        mock.patch.object(native.Call, "__init__", made),
        Gpu() as gpu,
    ):
        for (name, gradient), step in small_steps().items():
            counters = numbers, gpu.operators, gpu.made, gpu.copies, gpu.waits
            for _ in range(3):
                for counter in counters:
                    counter.clear()
                step()
            counts = (numbers["launches"], numbers["structs"], *(each.total() for each in counters[1:]))
            yield name, gradient, *map(str, counts)


def small_steps() -> dict[tuple[str, str], Callable[[], None]]:
    """Make steps of small scenes on the emulated GPU, forward and backward, by scene and gradient."""
    vertices, faces = nr.icosphere(1)
    uv, picture, cubes = torch.rand(80, 3, 2), torch.rand(8, 8, 3), torch.rand(80, 2, 2, 2, 3)
    camera = nr.Camera.look_at(GpuTensor(torch.tensor([[0.0, 1.0, -2.5]])))
    corners = GpuTensor(vertices), GpuTensor(faces)
    corners[0].requires_grad_()
    scenes = {
        "silhouettes": corners,
        "cubes": (*corners, GpuTensor(cubes)),
        "texture": nr.UVMesh(*corners, GpuTensor(uv), image=GpuTensor(picture)),
    }

    def draw(name: str, gradient: str) -> None:
        output = "alpha" if name == "silhouettes" else "rgb"
        images = nr.render(scenes[name], camera, 16, outputs=(output,), gradient=gradient)
        getattr(images, output).sum().backward()

    clip = GpuTensor(torch.cat((0.7 * vertices, torch.ones(len(vertices), 1)), 1)[None])
    values, image = GpuTensor(torch.rand(1, len(vertices), 3)), GpuTensor(torch.rand(1, 8, 8, 3))
    for one in (clip, values, image):
        one.requires_grad_()
    context = dr.RasterizeCudaContext()

    def drop_in(textured: bool) -> None:
        rast, rast_db = dr.rasterize(context, clip, corners[1], (16, 16))
        if textured:
            places, changes = dr.interpolate(values[..., :2], rast, corners[1], rast_db, "all")
            colors = dr.texture(image, places, changes)
        else:
            colors, _ = dr.interpolate(values, rast, corners[1])
        dr.antialias(colors, rast, clip, corners[1]).sum().backward()

    steps = {(name, gradient): partial(draw, name, gradient) for name in scenes for gradient in ("nmr", "edge")}
    return {**steps, ("dr: attributes", ""): partial(drop_in, False), ("dr: texture", ""): partial(drop_in, True)}


HOST = ("scene", "gradient", "launches", "structs", "operators", "new tensors", "copies", "waits")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=SCENES, action="append", help="one of the scenes; by default all")
    parser.add_argument("--host", action="store_true", help="count what Python does in a step")
    arguments = parser.parse_args()
    console = Console(width=132)
    if arguments.host:
        found = Table(*HOST)
        for row in of_the_host():
            found.add_row(*row)
        console.print(found)
        return
    with tempfile.TemporaryDirectory() as folder:
        device = EmulatedDevice(Path(folder), "counts")
        for scene in arguments.scene or SCENES:
            for output, gradient in STEPS:
                console.print(table(f"{scene}: {output}, {gradient}", counted(device, scene, output, gradient)))


def table(title: str, kernels: dict[str, tuple[int, list[int]]]) -> Table:
    result = Table(title=title, title_justify="left")
    for name in ("kernel", "launches", "threads", "operations", "longest", "busy", "MB moved", "to least", "H200 ms"):
        result.add_column(name, justify="left" if name == "kernel" else "right")
    total = [0] * 7
    launches, time = 0, 0.0
    for kernel, (count, counts) in kernels.items():
        result.add_row(kernel, *_cells(count, counts, milliseconds(count, counts)))
        launches, time = launches + count, time + milliseconds(count, counts)
        total = [a + b for a, b in zip(total, counts, strict=True)]
    result.add_section()
    cells = _cells(launches, total, time)
    cells[3] = f"{max(longest_to_mean(counts) for _, counts in kernels.values() if counts[0]):.0f}"
    result.add_row("all (the worst for the longest thread)", *cells)
    return result


def _cells(launches: int, counts: list[int], time: float) -> list[str]:
    operations, _, _, _, threads, moved, touched = counts
    numbers = [
        f"{launches}",
        f"{threads:,}",
        f"{operations:,}",
        f"{longest_to_mean(counts):.1f}",
        f"{busy(counts):.2f}",
    ]
    return [*numbers, f"{moved / 1e6:.1f}", f"{moved / max(touched, 1):.1f}", f"{time:.3f}"]


if __name__ == "__main__":
    main()
