"""Instructions of each kernel of a step, counted exactly: ``python -m benchmarks.instructions``.

The step is that of `benchmarks.deodr`, colours of vertices by ``fragments``, forward and backward on one thread. Each
launch is repeated from the memory before it, outside of Python, under callgrind: the code is what Warp's compiler built
for this processor, and the count does not depend on other programs. Needs valgrind and g++; on the CPU.
"""

from __future__ import annotations

import ctypes
import re
import struct
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
import warp as wp
from torch import Tensor

import neural_renderer as nr
from neural_renderer.base import private
from neural_renderer.raster.warp import launch

# (images, side, icosphere level)
SCENES = [(8, 256, 3), (1, 512, 6), (1, 64, 6)]

# Reads "launches": library, function, number of tasks, arguments, and each tensor with the place of its pointer.
_PROGRAM = """
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>
#include <dlfcn.h>
#include <valgrind/callgrind.h>
FILE* file;
long long number() { long long n = 0; return fread(&n, 8, 1, file) == 1 ? n : -1; }
char* block(long long size) {
    char* found = (char*)aligned_alloc(64, (size + 127) / 64 * 64);
    if (size && fread(found, 1, size, file) != (size_t)size) abort();
    found[size] = 0;
    return found;
}
int main() {
    file = fopen("launches", "rb");
    for (long long size; (size = number()) >= 0;) {
        char* library = block(size);
        char* name = block(number());
        char* bounds = block(number());
        char* arguments = block(number());
        std::vector<char*> tensors;
        for (long long left = number(); left > 0; --left) {
            const long long place = number();
            tensors.push_back(block(number()));
            memcpy(arguments + place, &tensors.back(), 8);
        }
        auto* run = (void (*)(void*, void*))dlsym(dlopen(library, RTLD_NOW), name);
        CALLGRIND_ZERO_STATS;
        run(bounds, arguments);
        CALLGRIND_DUMP_STATS;
        for (char* each : tensors) free(each);
        free(library), free(name), free(bounds), free(arguments);
    }
}
"""


def main() -> None:
    torch.set_num_threads(1)
    for scene in SCENES:
        step, pixels, faces = _scene(*scene)
        step()  # so that kernels are compiled, and values of constants kept
        with tempfile.TemporaryDirectory() as folder:
            names = _write_launches(step, Path(folder))
            counts = _counted(Path(folder), len(names))
        print(f"\n{scene[0]} × {scene[1]}², {20 * 4 ** scene[2]:,} faces: {pixels:,} pixels show {faces:,} faces\n")
        print("| kernel | instructions | a covered pixel | a face |\n|---|---:|---:|---:|")
        for name, count in [*zip(names, counts, strict=True), ("all", sum(counts))]:
            each = count / (scene[0] * 20 * 4 ** scene[2])
            print(f"| `{name}` | {count:,} | {count / pixels:.1f} | {each:.0f} |", flush=True)


def _scene(images: int, side: int, level: int) -> tuple[Any, int, int]:
    """Make a step; return it with the numbers of covered pixels and of visible faces."""
    generator = torch.Generator().manual_seed(0)
    sphere, faces = nr.icosphere(level)
    push = 1 + 0.1 * torch.rand(images, len(sphere), 1, generator=generator)
    vertices = (0.7 * sphere * push).requires_grad_()
    colors = torch.rand(images, len(sphere), 3, generator=generator).requires_grad_()
    grad = torch.randn(images, 3, side, side, generator=generator)
    camera = nr.Camera.look_at((0.0, 0.0, -2.0), orthographic=True)

    def step() -> nr.Fragments:
        shown = nr.fragments((vertices, faces), camera, side, anti_aliasing=False, two_sided=False, gradient="edge")
        shown.composite(shown.interpolate(colors)).backward(grad)
        return shown

    shown = step()
    return step, int(shown.mask.sum()), int(shown.visible_faces().sum())


def _write_launches(step: Any, folder: Path) -> list[str]:
    """Run a step, and write its launches with the memory that they read and write; return their kernels' names."""
    names: list[str] = []
    with open(folder / "launches", "wb") as file:

        def put(value: bytes) -> None:
            file.write(struct.pack("<q", len(value)) + value)

        def write(kernel: wp.Kernel, tasks: int, arguments: Sequence[Any]) -> bool:
            first, call = arguments
            fields = [("first", ctypes.c_int32), ("call", type(call))]
            packed: Any = type("Packed", (ctypes.Structure,), {"_fields_": fields})
            found = private.compiled(kernel)
            if found is None:
                raise RuntimeError("expected a version of Warp whose compiled kernels are known")
            library, name = _library(kernel, folder)
            for each in (library.encode(), name.encode(), bytes(found[2](tasks)), bytes(packed(first, call))):
                put(each)
            tensors = list(_tensors(call, packed.call.offset))
            file.write(struct.pack("<q", len(tensors)))
            for place, tensor in tensors:
                file.write(struct.pack("<q", place))
                put(ctypes.string_at(tensor.data_ptr(), tensor.nbytes))
            names.append(kernel.key)
            return False

        launch.emulator = write
        try:
            step()
        finally:
            launch.emulator = None
    return names


def _tensors(call: Any, start: int) -> Iterator[tuple[int, Tensor]]:
    """Yield the tensors of a call with the places of their pointers."""
    for name, value in call.kept.items():
        place = start + getattr(type(call), name).offset
        if isinstance(value, Tensor):
            yield place, value
        elif hasattr(value, "kept"):
            yield from _tensors(value, place)


def _library(kernel: wp.Kernel, folder: Path) -> tuple[str, str]:
    """Link a kernel's compiled module from Warp's cache; return the library and the name of the kernel's function."""
    identifier = private.identifier(kernel.module, "cpu")
    built = max(Path(wp.config.kernel_cache_dir, str(identifier)).glob("*.o"), key=lambda path: path.stat().st_mtime)
    library = folder / f"{identifier}.so"
    if not library.exists():
        subprocess.run(["g++", "-shared", "-nostartfiles", "-o", library, built], check=True, capture_output=True)
    listed = subprocess.run(["nm", built], check=True, capture_output=True, text=True).stdout
    [name] = re.findall(rf" T ({kernel.key}_[0-9a-f]{{8}}_cpu_forward)$", listed, re.MULTILINE)
    return str(library), name


def _counted(folder: Path, launches: int) -> list[int]:
    """Repeat the launches under callgrind; return the instructions of each."""
    (folder / "repeat.cpp").write_text(_PROGRAM)
    subprocess.run(["g++", "-O1", "repeat.cpp", "-o", "repeat", "-ldl"], cwd=folder, check=True)
    command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=counted", "./repeat"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    texts = [(folder / f"counted.{number}").read_text() for number in range(1, launches + 1)]
    return [int(re.findall(r"^(?:summary|totals): (\d+)", text, re.MULTILINE)[0]) for text in texts]


if __name__ == "__main__":
    main()
