"""The kernels compile for CUDA: NVRTC inside Warp's wheel needs no GPU for that."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from pathlib import Path

import pytest
import warp as wp

import neural_renderer.raster
from tests.cuda_emulation.cubin import registers, warps

# Every Warp module below raster/. A Python module has two if some of its kernels are for CUDA alone.
MODULES = {
    value.module.name: value.module
    for found in pkgutil.walk_packages(neural_renderer.raster.__path__, "neural_renderer.raster.")
    for value in vars(importlib.import_module(found.name)).values()
    if isinstance(value, wp.Kernel)
}


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp's wheel for macOS has no CUDA compiler")
@pytest.mark.parametrize("name", MODULES)
def test_each_module_for_cuda(name: str, tmp_path: Path) -> None:
    wp.compile_aot_module(MODULES[name], arch=80, module_dir=tmp_path, use_ptx=False)
    [code] = tmp_path.glob("*.cubin")
    used = registers(code)
    assert len(used) == len(MODULES[name].kernels)
    # A multiprocessor holds at least 16 warps of each kernel, so that some compute while others wait for memory.
    assert min(map(warps, used.values())) >= 16, used
