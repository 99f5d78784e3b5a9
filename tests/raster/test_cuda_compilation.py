"""The kernels compile for CUDA: NVRTC inside Warp's wheel needs no GPU for that."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest
import warp as wp

NAMES = ["barycentrics", "boundaries", "corners", "coverage", "edges", "interpolate", "intersections"]
NAMES += ["mipmaps", "neighbors", "scanlines", "seen", "textures", "voxels"]


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp's wheel for macOS has no CUDA compiler")
@pytest.mark.parametrize("name", NAMES)
def test_kernels_compile_for_cuda(name: str, tmp_path: Path) -> None:
    module = importlib.import_module(f"neural_renderer.raster.{name}")
    wp.compile_aot_module(module, arch=80, module_dir=tmp_path)
    assert list(tmp_path.glob("*.cubin")) or list(tmp_path.glob("*.ptx"))
