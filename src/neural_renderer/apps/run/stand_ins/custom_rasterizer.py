"""The interface of Hunyuan3D's `custom_rasterizer` (`rasterize`, `interpolate`): an independent implementation.

Row 0 is at y = −1, as in nvdiffrast; but the centres of the first and the last column are at x = −1 and x = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ....base import validate
from ....compat import nvdiffrast as dr

__all__ = ["interpolate", "rasterize"]


def __getattr__(name: str) -> Any:
    raise AttributeError(f"custom_rasterizer: expected one of {', '.join(__all__)}, got {name}, which is not here")


def rasterize(
    pos: Tensor, tri: Tensor, resolution: Sequence[int], clamp_depth: Any = None, use_depth_prior: int = 0
) -> tuple[Tensor, Tensor]:
    """Find the nearest triangle at each pixel, and the weights of its corners.

    Args:
        pos: Vertices in clip space, [1, V, 4] floating. Only their order in z / w counts: nothing is clipped in depth.
        tri: Vertex indices, [F, 3] integer.
        resolution: Height and width.
        clamp_depth, use_depth_prior: Not here.

    Returns:
        Number of the triangle + 1, [H, W] int32, 0 for none; weights of its corners in space, [H, W, 3] float32.

    Raises:
        NotImplementedError: ``use_depth_prior`` is not 0.
        TypeError, ValueError: As `nvdiffrast.rasterize`.
    """
    if use_depth_prior:
        raise NotImplementedError("use_depth_prior: expected 0, because depth priors are not in this package")
    positions = validate.floating("pos", pos, (1, "V", 4)).float()
    validate.indices("tri", tri, ("F", 3))
    height, width = (int(side) for side in resolution)
    with torch.no_grad():
        depth = positions[..., 2] / positions[..., 3]
        farthest = depth.abs()[depth.isfinite()].amax().clamp(min=1.0) if depth.numel() else 1.0
        factors = torch.tensor([(width - 1) / width, (height - 1) / height, 1.0, 1.0]).to(positions)
        factors[2] /= 1.001 * farthest
        rast, _ = dr.rasterize(
            dr.RasterizeGLContext(output_db=False), positions * factors, tri.int().contiguous(), [height, width]
        )
    number = rast[0, ..., 3].int()
    weights = torch.stack((rast[0, ..., 0], rast[0, ..., 1], 1 - rast[0, ..., 0] - rast[0, ..., 1]), -1)
    return number, weights * (number > 0)[..., None]


def interpolate(col: Tensor, findices: Tensor, barycentric: Tensor, tri: Tensor) -> Tensor:
    """Interpolate attributes of vertices at pixels.

    Args:
        col: [1, V, C] floating.
        findices: [H, W], number of the triangle + 1, of any dtype.
        barycentric: [H, W, 3] floating.
        tri: Indices into the attributes, [F, 3] integer.

    Returns:
        [1, H, W, C]; 0 where the weights are.

    Raises:
        TypeError, ValueError: A type or shape does not fit.
    """
    values = validate.floating("col", col, (1, "V", "C"))[0]
    validate.floating("barycentric", barycentric, (*findices.shape, 3))
    face = (findices.long() - 1).clamp(min=0)
    corners = values[validate.indices("tri", tri, ("F", 3)).long()[face]]  # [H, W, 3, C]
    return (barycentric[..., None] * corners).sum(2)[None]
