"""Kernels in C++: structs and functions of the headers in ``raster/kernels``, for `launch`.

A kernel is a C++ function ``void name(const Call& call, int task)``. ``Call`` is a struct of pointers and numbers that
the header documents with shapes and units. Python reads its fields from there, so that they are declared once; Warp's
compiler checks that both layouts are equal. Only this file uses Warp's experimental API for native C++.
"""

from __future__ import annotations

import ctypes
import os
import re
import zlib
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import torch
import warp as wp
from warp import build_experimental

from .memory import contiguous

N = TypeVar("N", int, float)

FOR_CUDA = "_for_cuda"  # suffix of Warp modules that the CPU does not need
BACKWARD = ".backward"  # suffix of modules that only gradients need
HEADERS = Path(__file__).parent.parent / "kernels"
_SHORT = HEADERS / "cpu"  # short versions of Warp's own headers
_INCLUDE = re.compile(r'^#include "(\w+\.h)"$', re.MULTILINE)
_COMMENT = re.compile(r" *//.*")
_FIELD = re.compile(r"    (const )?(\w+)(\*?) (\w+(?:, \w+)*);(?: *//.*)?")
_STRUCT = re.compile(r"^struct (\w+) \{\n(.*?)^\};", re.MULTILINE | re.DOTALL)
_CONSTANTS = re.compile(r"^constexpr (\w+) (.*)", re.MULTILINE)
_CONSTANT = re.compile(r"(\w+) = (0x[0-9A-Fa-f]+|[-.\d]+(?:e-?\d+)?)[fuUlL]*[,;]")
_NUMBERS: dict[str, Any] = {"int": ctypes.c_int32, "int64": ctypes.c_int64, "float": ctypes.c_float}
_TENSORS = {
    "byte": torch.uint8,
    "int": torch.int32,
    "int64": torch.int64,
    "float": torch.float32,
    "double": torch.float64,
    "vec2": torch.float32,
    "vec2i": torch.int32,
    "vec3": torch.float32,
}


_calls: dict[wp.Kernel, type[Call]] = {}  # of kernels in C++


class Call(ctypes.Structure):
    """Base class of the arguments of a kernel; it keeps the tensors alive to which its pointers refer.

    Args:
        fields: Value of each field by name: a tensor or None for a pointer, a number, or another `Call`. Fields that
            are left out are 0. A tensor that the kernel only reads, by a const pointer, is made contiguous.

    Raises:
        TypeError: A tensor whose dtype is not the pointer's, or a non-contiguous tensor to write.
        AttributeError: An unknown field, or a pointer field without a tensor.
    """

    __slots__ = ("kept",)  # without a dictionary, setting an unknown field is an error
    _pointers: dict[str, torch.dtype]
    _read: frozenset[str]

    def __init__(self, **fields: Any) -> None:
        self.kept = fields
        pointers = self._pointers
        for name, value in fields.items():
            if value is None:
                continue
            dtype = pointers.get(name)
            if dtype is not None:
                if value.dtype is not dtype or not value.is_contiguous():
                    value = fields[name] = self._contiguous(name, value)
                value = value.data_ptr()
            setattr(self, name, value)

    def _contiguous(self, name: str, value: torch.Tensor) -> torch.Tensor:
        dtype = self._pointers[name]
        if value.dtype is dtype and name in self._read:
            return contiguous(value)
        layout = "" if value.is_contiguous() else " that is not contiguous"
        raise TypeError(f"{name}: expected a contiguous tensor of {dtype}, got a tensor of {value.dtype}{layout}")


@cache
def with_includes(header: str) -> tuple[str, ...]:
    """Return the names of a header and of those that it includes, the deepest first."""
    found: dict[str, None] = {}
    for included in _INCLUDE.findall(_text(header)):
        found.update(dict.fromkeys(with_includes(included)))
    return (*found, header)


@cache
def source(header: str) -> str:
    """Join a header and those that it includes into one text without comments.

    Warp's key of compiled kernels is a hash of this text. So all checkouts share them, and editing a comment compiles
    nothing again. The paths of included files would be part of the key.
    """
    return "".join(f"// {each}\n{_code(each)}" for each in with_includes(header))


@cache
def _code(header: str) -> str:
    lines = _COMMENT.sub("", _text(header)).splitlines()
    joined = ("#pragma once", '#include "')  # lines that joined headers do not need
    return "".join(f"{line}\n" for line in lines if line.strip() and not line.startswith(joined))


@cache
def _text(header: str) -> str:
    return (HEADERS / header).read_text(encoding="utf-8")


@cache
def _structs(header: str) -> dict[str, str]:
    """Return the fields of each struct of a header as text. Its methods follow an empty line."""
    return {name: body.split("\n\n")[0] for name, body in _STRUCT.findall(_text(header))}


@cache
def _constants(header: str) -> dict[str, tuple[str, str]]:
    """Return the type and the value of each number that a header declares with ``constexpr``, as text."""
    lines = _CONSTANTS.findall(_text(header))
    return {name: (kind, value) for kind, line in lines for name, value in _CONSTANT.findall(line)}


def struct(header: str, name: str) -> type[Call]:
    """Read a struct of a header, or of those it includes, as a class of the arguments of kernels.

    Raises:
        ValueError: No such struct, or a line in it that is neither a field nor a comment. Methods follow an empty line.
    """
    for each in with_includes(header):
        if name in _structs(each):
            return _struct(each, name, _structs(each)[name])
    raise ValueError(f"{header}: expected a struct {name}, found none")


@cache
def _struct(header: str, name: str, body: str) -> type[Call]:
    fields: list[tuple[str, Any]] = []
    pointers, read = {}, []
    for line in body.splitlines():
        if line.strip().startswith("//"):
            continue
        field = _FIELD.fullmatch(line)
        if field is None:
            raise ValueError(f"{header}, struct {name}: expected a field such as `const vec3* faces;`, got {line!r}")
        const, kind, star, names = field.groups()
        for each in names.split(", "):
            if star:
                fields.append((each, ctypes.c_void_p))
                pointers[each] = _TENSORS[kind]
                read += [each] if const else []
            else:
                fields.append((each, _NUMBERS[kind] if kind in _NUMBERS else struct(header, kind)))
    namespace = {"_fields_": fields, "_pointers": pointers, "_read": frozenset(read), "__slots__": ()}
    made = type(name, (Call,), namespace)
    build_experimental.add_native_type(made, native_name=f"nr::{name}")
    return made


def constant(header: str, name: str, kind: type[N] = int) -> N:
    """Read a number that a header declares with ``constexpr``, as an int or, by ``kind``, a float.

    Raises:
        ValueError: No such number.
    """
    declared, value = _constants(header).get(name, ("", ""))
    if not declared or (declared == "float") != (kind is float):
        raise ValueError(f"{header}: expected a constexpr {name} of kind {kind.__name__}, found none")
    return kind(value) if kind is float else kind(int(value, 0))


class Kernels:
    """The kernels of a header: a Warp module.

    Args:
        module: Name of the Python module that launches them, which names the compiled files.
        header: File in ``raster/kernels``.
        fused: Whether products and sums may be fused, which rounds once instead of twice. Not where results have to be
            equal to the bit on all devices.
    """

    def __init__(self, module: str, header: str, fused: bool = True) -> None:
        text = source(header)
        self._header = header
        self._module = wp.get_module(module)
        build = wp.ModuleBuildOptions(extra_cpu_preamble=text, extra_cuda_preamble=text)
        self._options = {"enable_backward": False, "fuse_fp": fused, "extra_build_options": build}
        wp.set_module_options(self._options, self._module)

    def struct(self, name: str) -> type[Call]:
        """Read a struct of the header; see `struct`."""
        return struct(self._header, name)

    def kernel(
        self, name: str, call: type[Call], only_cuda: bool = False, launch_bounds: tuple[int, int] | None = None
    ) -> wp.Kernel:
        """Make the kernel that runs the header's function ``void name(const Call& call, int task)`` for each task.

        With ``only_cuda`` the CPU does not compile it. ``launch_bounds`` are, on CUDA, the threads of a block and the
        least number of blocks on a multiprocessor.
        """
        module = self._module
        if only_cuda:
            module = wp.get_module(module.name + FOR_CUDA)
            wp.set_module_options(self._options, module)
        run = _native(name, call, module)

        def kernel(first: int, call: Any) -> None:
            run(call, first + wp.tid())  # type: ignore[operator]  # Warp's language, not Python

        kernel.__annotations__ = {"first": int, "call": call}
        made = wp.kernel(kernel, name=name, module=module, launch_bounds=launch_bounds)
        _calls[made] = call
        return made


def call_of(kernel: wp.Kernel) -> type[Call] | None:
    """Return the struct that a kernel in C++ takes; None for another kernel."""
    return _calls.get(kernel)


def short_headers(module: wp.Module) -> str:
    """Return compiler flags that replace Warp's headers by the few lines of them that kernels in C++ need.

    The flags are part of the key of compiled kernels (`source`), so they name copies of the headers in Warp's cache.

    Raises:
        OSError: The cache cannot be written.
    """
    cache_folder = str(wp.config.kernel_cache_dir)
    if module.options["extra_build_options"] is None or re.search(r"\s", cache_folder):  # spaces divide flags
        return ""
    texts = {path.name: path.read_bytes() for path in sorted(_SHORT.iterdir())}
    folder = Path(cache_folder, f"neural_renderer_{zlib.crc32(b''.join(texts.values())):08x}")
    for name, text in texts.items():
        if not (folder / name).exists():
            folder.mkdir(parents=True, exist_ok=True)
            temporary = folder / f"{name}.{os.getpid()}"
            temporary.write_bytes(text)
            temporary.replace(folder / name)  # whole at any time, for other processes
    return f"-iquote {folder}"


def _native(name: str, call: type[Call], module: wp.Module) -> wp.Function:
    """Make the Warp function that calls a function of a header."""

    def stub(call: Any, task: int) -> None: ...

    stub.__module__, stub.__qualname__ = module.name, f"call_{name}"
    stub.__annotations__ = {"call": call, "task": int}
    return wp.func_native(f"nr::{name}(call, task);")(stub)
