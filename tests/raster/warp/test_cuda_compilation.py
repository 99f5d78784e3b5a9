"""The kernels compile for CUDA: NVRTC inside Warp's wheel needs no GPU for that."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from pathlib import Path

import pytest
import warp as wp

import neural_renderer.raster

# Every module below raster/ that defines Warp kernels or functions.
NAMES = [
    found.name
    for found in pkgutil.walk_packages(neural_renderer.raster.__path__, "neural_renderer.raster.")
    if any(isinstance(value, wp.Kernel) for value in vars(importlib.import_module(found.name)).values())
]


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp's wheel for macOS has no CUDA compiler")
@pytest.mark.parametrize("name", NAMES)
def test_kernels_compile_for_cuda(name: str, tmp_path: Path) -> None:
    wp.compile_aot_module(importlib.import_module(name), arch=80, module_dir=tmp_path)
    assert list(tmp_path.glob("*.cubin")) or list(tmp_path.glob("*.ptx"))
