"""Kernels of the headers in ``raster/kernels``, compiled alone and with a sanitizer, for Python."""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import warp as wp

from neural_renderer.raster.warp.native import HEADERS, Call, struct, with_includes
from tests.programs import one_process

from .compiler import compile_source

_KERNEL = re.compile(r"(?<!>\n)^NR_FUNC void (\w+)\(const (\w+)& \w+, int \w+\) \{", re.MULTILINE)
_HEADER = re.compile(r"^// (\w+\.h)$", re.MULTILINE)


def _kernels(header: str) -> list[tuple[str, str]]:
    """Find the kernels of a header and of those it includes: the names of their functions and of their structs."""
    texts = [(HEADERS / each).read_text(encoding="utf-8") for each in with_includes(header)]
    return [found for text in texts for found in _KERNEL.findall(text)]


def source_of(header: str) -> str:
    """Write the C++ of a library with a C function for each kernel of a header, which is included first."""
    exports = [f"NR_EXPORT({name}, {call}, {ctypes.sizeof(struct(header, call))})" for name, call in _kernels(header)]
    return "\n".join([f'#include "{header}"', '#include "run.h"', *exports, ""])


class NativeKernels:
    """Kernels by header and name. A header's library is compiled when it is first needed.

    Args:
        folder: Where the libraries are kept; several processes can share it.
        sanitizer: Key of `SANITIZERS`. Python has to be started with its `environment`.
        threads: On which the tasks of a launch run at once.

    Example:
        >>> kernels = NativeKernels(tmp_path)
        >>> kernels.run("voxels.h", "flood", _Grids(state=state, size=8), tasks=len(state))
    """

    def __init__(self, folder: Path, sanitizer: str = "none", threads: int = 1) -> None:
        self._folder = folder
        self._sanitizer = sanitizer
        self._threads = threads
        self._libraries: dict[str, ctypes.CDLL] = {}

    def run(self, header: str, name: str, call: Call, tasks: int, first: int = 0) -> None:
        """Run the tasks [first, first + tasks) of a kernel.

        Raises:
            AttributeError: The header has no such kernel.
            ctypes.ArgumentError: The kernel has another struct.
        """
        if header not in self._libraries:
            self._libraries[header] = self._library(header)
        getattr(self._libraries[header], f"run_{name}")(ctypes.byref(call), first, tasks, self._threads)

    def launch(self, kernel: wp.Kernel, tasks: int, arguments: Sequence[Any]) -> bool:
        """Run a launch, as `launch.emulator` does; False for a kernel in Warp's own language."""
        first, call, *others = arguments
        if others or not isinstance(call, Call):
            return False
        header = _HEADER.findall(kernel.module.options["extra_build_options"].extra_cpu_preamble)[-1]
        self.run(header, kernel.key, call, tasks, first)
        return True

    def _library(self, header: str) -> ctypes.CDLL:
        source = self._folder / f"{Path(header).stem}.{self._sanitizer}.cpp"
        result = source.with_suffix(".so")
        with one_process(source.with_suffix(".lock")):
            if not result.exists():
                source.write_text(source_of(header), encoding="utf-8")
                partial = result.with_suffix(".part")
                compile_source(source, self._sanitizer, "-shared", "-fPIC", "-o", partial)
                os.replace(partial, result)
        library = ctypes.CDLL(str(result))
        for name, call in _kernels(header):
            getattr(library, f"run_{name}").argtypes = [ctypes.POINTER(struct(header, call)), *[ctypes.c_int] * 3]
        return library
