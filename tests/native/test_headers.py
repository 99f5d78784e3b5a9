"""The headers in ``raster/kernels``, compiled alone by this machine's compiler, and its sanitizers."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from neural_renderer.raster.warp.native import HEADERS, struct
from tests.native.compiler import HERE, MISSING, compile_source, compiler, environment, without_sanitizer
from tests.native.kernels import NativeKernels, source_of
from tests.native.wrong import gather


@pytest.fixture(autouse=True)
def _needs_a_compiler() -> None:
    if compiler() is None:
        pytest.skip(MISSING)


@pytest.mark.parametrize("header", sorted(path.name for path in HEADERS.glob("*.h")))
def test_header_compiles_alone(header: str, tmp_path: Path) -> None:
    """Without warnings, and with structs of the size that they have in Python."""
    source = tmp_path / "alone.cpp"
    source.write_text(source_of(header), encoding="utf-8")
    compile_source(source, "none", "-fsyntax-only")


@pytest.mark.parametrize("name", sorted(path.stem for path in HERE.glob("*.cpp")))
def test_cpp(name: str, tmp_path: Path) -> None:
    """Each C++ program passes its own checks, under the address and the undefined behaviour sanitizer."""
    program = tmp_path / name
    compile_source(HERE / f"{name}.cpp", "address", "-o", program)
    done = subprocess.run([program], capture_output=True, text=True, env=without_sanitizer())
    assert done.returncode == 0, done.stderr


def test_kernel_of_a_header_runs_from_python(tmp_path: Path) -> None:
    vertices, corners = torch.rand(1, 5, 3), torch.zeros(1, 4, 3, 3)
    gather(NativeKernels(tmp_path, threads=3), "gather_corners", vertices, corners, groups=4)
    assert torch.equal(corners.reshape(12, 3), vertices[0, torch.arange(12) % 5])


def test_struct_of_another_kernel_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ctypes.ArgumentError):
        NativeKernels(tmp_path).run("corners.h", "gather_corners", struct("voxels.h", "Grids")(), tasks=1)


@pytest.mark.parametrize(("sanitizer", "message"), [("address", "heap-buffer-overflow"), ("thread", "data race")])
def test_sanitizers_find_wrong_accesses(sanitizer: str, message: str, tmp_path: Path) -> None:
    try:
        variables = environment(sanitizer)
    except LookupError as error:
        pytest.skip(str(error))
    command = [sys.executable, "-m", "tests.native.wrong", sanitizer, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, env={**without_sanitizer(), **variables})
    if "unexpected memory mapping" in done.stderr:
        pytest.skip("the sanitizer finds no room for its tables here: see vm.mmap_rnd_bits")
    assert done.returncode != 0
    assert message in done.stderr and "corners.h:" in done.stderr


@pytest.mark.parametrize("name", [None, "clang++"])
def test_environment_of_a_missing_runtime(name: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.native.compiler.compiler", lambda: name)
    monkeypatch.setattr("subprocess.run", lambda *_, **__: subprocess.CompletedProcess([], 0, "libasan.so"))
    with pytest.raises(LookupError, match="expected g\\+\\+"):
        environment("address")


@pytest.mark.parametrize("backwards", [False, True])
def test_headers_go_together(backwards: bool, tmp_path: Path) -> None:
    """No two of them give one name to different things."""
    source = tmp_path / "together.cpp"
    names = sorted((path.name for path in HEADERS.glob("*.h")), reverse=backwards)
    source.write_text("".join(f'#include "{name}"\n' for name in names), encoding="utf-8")
    compile_source(source, "none", "-fsyntax-only")
