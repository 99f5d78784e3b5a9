"""An emulated CUDA device: Warp compiles a kernel's module to PTX for a GPU, and the PTX runs here, translated to C.

It needs no GPU, but Warp's CUDA compiler (not in the wheel for macOS) and a C compiler. Not emulated: shared memory
between threads, barriers, shuffles and streams.
"""

from __future__ import annotations

import ctypes
import math
import os
import struct
import subprocess
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import torch
import warp as wp
from warp._src.types import launch_bounds_t

from neural_renderer.raster.warp import launch as launching
from neural_renderer.raster.warp import layout
from tests.programs import one_process

from .ptx import Kernel, parse
from .translate import translate

Mode = Literal["plain", "races", "counts"]
_ARCHITECTURE = 90
_FLAGS = {"plain": [], "races": ["-DRACES"], "counts": ["-DCOUNTS"]}
# Kernels that ask a Warp mesh questions: its tree lives on one device only.
_ON_THE_CPU = {"_wind"}
_BLOCK = 256
_GOLDEN = (math.sqrt(5) - 1) / 2


class EmulatedDevice:
    """Runs every launch through the emulation while it is entered.

    Args:
        folder: Where compiled modules are kept; several devices can share it.
        mode: "races" counts unordered accesses to memory, "counts" memory operations.
        shuffled: Run threads in an order in which neighbours are far apart, and in the reverse order the next time.

    Attributes:
        launches: Number of launches by kernel.
        measured: Results of `run` in runtime.h by kernel, summed over launches; the longest thread is a maximum.
        unordered: Kernels that sum floats in any order although torch asks for deterministic results; of "races".

    Example:
        >>> with EmulatedDevice(tmp_path, "races") as device:
        ...     nr.render(mesh, camera).rgb.sum().backward()
        >>> assert not any(device.measured.values())
    """

    def __init__(self, folder: Path, mode: Mode = "plain", shuffled: bool = True) -> None:
        self.launches: Counter[str] = Counter()
        self.measured: dict[str, list[int]] = {}
        self.unordered: set[str] = set()
        self._folder = folder
        self._mode = mode
        self._shuffled = shuffled
        self._libraries: dict[str, tuple[ctypes.CDLL, dict[str, Kernel]]] = {}

    def __enter__(self) -> EmulatedDevice:
        launching.emulator, layout.as_on_cuda = self._launch, True
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        launching.emulator, layout.as_on_cuda = None, None

    def _launch(self, kernel: wp.Kernel, tasks: int, arguments: Sequence[Any]) -> bool:
        """Run a launch; False for a kernel that has to run on the CPU."""
        if kernel.key in _ON_THE_CPU:
            return False
        name = kernel.module.name
        if name not in self._libraries:
            self._libraries[name] = self._library(kernel.module)
        library, kernels = self._libraries[name]
        entry = kernels[kernel.key]
        buffers = [
            _packed(value, size, argument)
            for value, size, argument in zip(
                [launch_bounds_t((tasks,)), *arguments], entry.parameters, [None, *kernel.adj.args], strict=True
            )
        ]
        pointers = (ctypes.c_void_p * len(buffers))(*map(ctypes.addressof, buffers))
        result = (ctypes.c_int64 * 7)()
        where = f"{name.removeprefix('neural_renderer.raster.')}.{kernel.key}"
        backward = self.launches[where] % 2 == 1
        stride = ctypes.c_uint64(_stride(tasks, backward) if self._shuffled else 1)
        if library.run(entry.name.encode(), pointers, ctypes.c_uint64(tasks), stride, result):
            raise RuntimeError(f"{entry.name}: expected a kernel of the module {name}, found none")
        self.launches[where] += 1
        if self._mode == "races" and result[2] and torch.are_deterministic_algorithms_enabled():
            self.unordered.add(where)
        sums = self.measured.setdefault(where, [0] * 7)
        for place, value in enumerate(result):
            sums[place] = max(sums[place], value) if place == 1 else sums[place] + value
        return True

    def _library(self, module: wp.Module) -> tuple[ctypes.CDLL, dict[str, Kernel]]:
        name = module.name
        ptx, library = self._folder / f"{name}.ptx", self._folder / f"{name}.{self._mode}.so"
        with one_process(self._folder / f"{name}.lock"):
            if not ptx.exists():
                build = self._folder / name
                wp.compile_aot_module(module, arch=_ARCHITECTURE, module_dir=build, use_ptx=True)
                os.replace(next(build.rglob("*.ptx")), ptx)
            kernels = _kernels(ptx)
            if not library.exists():
                source, partial = library.with_suffix(".c"), library.with_suffix(".part")
                source.write_text(translate(kernels), encoding="utf-8")
                # One rounding for each operation, as on the GPU: contraction would fuse what PTX keeps apart.
                options = ["-O1", "-w", "-fPIC", "-shared", "-ffp-contract=off", "-fno-strict-aliasing"]
                options += [*_FLAGS[self._mode], str(source), "-o", str(partial), "-lm"]
                subprocess.run(["cc", *options], check=True)
                os.replace(partial, library)
        keys = {kernel.name.rsplit("_cuda_kernel", 1)[0].rsplit("_", 1)[0]: kernel for kernel in kernels}
        return ctypes.CDLL(str(library)), keys


@cache
def _kernels(ptx: Path) -> list[Kernel]:
    return parse(ptx.read_text(encoding="utf-8"))


def _stride(tasks: int, backward: bool) -> int:
    """A step through the padded thread numbers that visits each once and puts neighbours far apart."""
    padded = -(-tasks // _BLOCK) * _BLOCK
    stride = int(_GOLDEN * padded) | 1
    while math.gcd(stride, padded) != 1:
        stride += 1
    return padded - stride if backward else stride


def _packed(value: Any, size: int, argument: Any) -> ctypes.Array[ctypes.c_char]:
    """The bytes of a kernel's argument."""
    if isinstance(value, float) or (argument is not None and argument.type is wp.float32):
        data = struct.pack("<f", value)
    elif isinstance(value, (bool, int)):
        data = int(value).to_bytes(size, "little", signed=True)
    else:
        data = bytes(value)
    if len(data) != size:
        raise ValueError(f"argument {argument and argument.label}: expected {size} bytes, got {len(data)}")
    return ctypes.create_string_buffer(data, size + 16)
