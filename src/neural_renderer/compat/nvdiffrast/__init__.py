"""The interface of nvdiffrast (`nvdiffrast.torch`) on this package's rasteriser, for the CPU and CUDA.

``import neural_renderer.nvdiffrast as dr`` replaces ``import nvdiffrast.torch as dr``. Names, arguments and
conventions are those of nvdiffrast's documentation: images have row 0 at the bottom and channels last, and vertices are
in clip space, (x, y, z, w). The four operations are described in Laine et al., "Modular primitives for high-performance
differentiable rendering", 2020. This is an independent implementation, under this package's licence.
"""

from .antialiasing import antialias, antialias_construct_topology_hash
from .contexts import RasterizeCudaContext, RasterizeGLContext, get_log_level, set_log_level
from .interpolation import interpolate
from .rasterization import DepthPeeler, rasterize
from .texturing import texture, texture_construct_mip

__all__ = [
    "DepthPeeler",
    "RasterizeCudaContext",
    "RasterizeGLContext",
    "antialias",
    "antialias_construct_topology_hash",
    "get_log_level",
    "interpolate",
    "rasterize",
    "set_log_level",
    "texture",
    "texture_construct_mip",
]
