"""`rasterize`: the visible triangle of each pixel, from vertices in clip space; `DepthPeeler`: those behind it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...base.constants import on_device
from ...raster.clip.attributes import interpolate_attributes
from ...raster.clip.clip_corners import clip_corners
from ...raster.clip.silhouettes import blend_silhouettes
from ...raster.clip.texture_levels import sample_levels
from ...raster.clip.triangles import NEAR, show_triangles
from ...raster.ops.coverage import coverage
from ...raster.ops.draw import DrawingKernels
from ...raster.settings import image_size
from ...raster.warp.launch import load_ahead
from ...raster.warp.registration import is_plain
from . import checks
from .contexts import RasterizeCudaContext, free_context

# Kernels for vertices in clip space, and the devices for which they are compiled.
_KERNELS = (
    sample_levels,
    coverage,
    blend_silhouettes,
    show_triangles,
    interpolate_attributes,
    clip_corners,
    DrawingKernels,
)
_devices: set[torch.device] = set()


@validate.checked_together
def rasterize(
    glctx: RasterizeCudaContext,
    pos: Tensor,
    tri: Tensor,
    resolution: Sequence[int],
    ranges: Tensor | None = None,
    grad_db: bool = True,
) -> tuple[Tensor, Tensor]:
    """Find the visible triangle at each pixel, and the weights of its corners.

    The nearest triangle that covers the pixel's centre is visible, between the planes z = −w and z = w, from both
    sides. A centre on an edge is covered. At equal depth the triangle of lowest number is visible.

    Args:
        glctx: A context.
        pos: Vertices (x, y, z, w) in clip space: [B, V, 4] float32, the same triangles in each image (instanced mode),
            or [V, 4] with ``ranges`` (range mode).
        tri: Vertex indices, [F, 3] int32.
        resolution: Height and width of the images in pixels, 1 to 32768.
        ranges: In range mode first triangle and number of triangles of each image, [B, 2] int32, on the CPU.
        grad_db: Whether gradients reach ``pos`` through the second result.

    Returns:
        ``rast``, [B, H, W, 4] float32: (u, v, z / w, number of the triangle + 1), all 0 where there is none; u and v
        are the weights of corners 0 and 1, and have gradients to ``pos``. ``rast_db``, [B, H, W, 4]: their screen-space
        derivatives, (du/dX, du/dY, dv/dX, dv/dY), for a step of one pixel; [B, H, W, 0] if the context has no
        ``output_db``.

    Raises:
        TypeError, ValueError: An argument of another type, shape, device or range.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> pos = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1]]])
        >>> tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
        >>> rast, rast_db = dr.rasterize(dr.RasterizeCudaContext(), pos, tri, resolution=[64, 64])
        >>> rast.shape, rast_db.shape
        (torch.Size([1, 64, 64, 4]), torch.Size([1, 64, 64, 4]))
    """
    return Layers(glctx, pos, tri, resolution, ranges, grad_db).draw()[:2]


class Layers:
    """Common part of `rasterize` and `DepthPeeler`: checked arguments, and the layers of triangles."""

    def __init__(
        self, glctx: RasterizeCudaContext, pos: Any, tri: Any, resolution: Any, ranges: Any, grad_db: Any
    ) -> None:
        self._output_db = free_context(glctx).output_db
        positions = checks.clip_positions(pos)
        triangles = checks.triangles(tri, positions.shape[1])
        validate.same_device(pos=pos, tri=tri)
        try:
            sides = tuple(resolution)
        except TypeError:
            sides = ()
        if len(sides) != 2:
            raise ValueError(f"resolution: expected (height, width), got {resolution!r}")
        size = image_size("resolution", sides)
        slots = triangles.shape[0]
        ranges_there = None
        if pos.dim() == 2:
            slots = _most_triangles(ranges, slots)
            ranges_there = on_device(ranges, triangles)
        self._grad_db = validate.flag("grad_db", grad_db)
        if positions.device not in _devices and is_plain((positions,)):
            load_ahead(_KERNELS, positions.device)
            _devices.add(positions.device)
        self._inputs = positions, triangles, ranges_there, slots, *size

    def draw(self, floor: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Return the results of `rasterize` for the triangles behind a floor, and the next floor."""
        rast, changes, floor = show_triangles(*self._inputs, floor)
        if not self._output_db:
            changes = changes[..., :0]
        return rast, changes if self._grad_db else changes.detach(), floor

    def first_floor(self) -> Tensor:
        """Return the floor of the first layer."""
        positions, _, ranges, _, height, width = self._inputs
        images = len(positions if ranges is None else ranges)
        return torch.full((images, height, width), NEAR, device=positions.device)


class DepthPeeler:
    """Rasterise depth layers one after the other, in a ``with`` block (Everitt, 2001).

    The first layer is that of `rasterize`; each further one shows what lies behind the layer before. Surfaces nearer to
    each other than 3e-6 in z / w count as one.

    Args:
        glctx, pos, tri, resolution, ranges, grad_db: As in `rasterize`. The context cannot be used by other calls
            inside the block.

    Raises:
        TypeError, ValueError: As in `rasterize`.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> pos = torch.tensor([[-1.0, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1]])
        >>> pos = torch.cat((pos, pos + torch.tensor([0, 0, 0.5, 0])))[None]
        >>> tri = torch.tensor([[3, 4, 5], [0, 1, 2]], dtype=torch.int32)
        >>> with dr.DepthPeeler(dr.RasterizeCudaContext(), pos, tri, [8, 8]) as peeler:
        ...     [peeler.rasterize_next_layer()[0][0, 0, 0, 3].item() for _ in range(3)]
        [2.0, 1.0, 0.0]
    """

    def __init__(
        self,
        glctx: RasterizeCudaContext,
        pos: Tensor,
        tri: Tensor,
        resolution: Sequence[int],
        ranges: Tensor | None = None,
        grad_db: bool = True,
    ) -> None:
        self._context = free_context(glctx)
        self._layers = validate.checked_together(Layers)(glctx, pos, tri, resolution, ranges, grad_db)
        self._floor = self._layers.first_floor()

    def __enter__(self) -> DepthPeeler:
        free_context(self._context).peels = True
        return self

    def __exit__(self, *_: Any) -> None:
        self._context.peels = False

    def rasterize_next_layer(self) -> tuple[Tensor, Tensor]:
        """Rasterise the next layer.

        Returns:
            ``rast`` and ``rast_db`` as from `rasterize`; 0 where there is no further triangle.

        Raises:
            RuntimeError: Outside of the ``with`` block.
        """
        if not self._context.peels:
            raise RuntimeError("rasterize_next_layer: expected a call inside `with DepthPeeler(...) as peeler:`")
        rast, changes, floor = self._layers.draw(self._floor)
        self._floor = floor.detach()
        return rast, changes


def _most_triangles(ranges: Any, count: int) -> int:
    """Return the most triangles of an image; raise unless the ranges are [B, 2] int32 on the CPU, and valid."""
    if not isinstance(ranges, Tensor):
        raise TypeError(f"ranges: expected a tensor [B, 2] for pos [V, 4], got {type(ranges).__name__}")
    validate.indices("ranges", ranges, ("B", 2))
    if ranges.dtype != torch.int32 or ranges.device.type != "cpu":
        raise TypeError(f"ranges: expected int32 on the CPU, got {validate.shape_of(ranges)} on {ranges.device}")
    if len(ranges) == 0:
        raise ValueError("ranges: expected at least one image, got [0, 2]")
    pairs = ranges.tolist()
    if any(first < 0 or number < 0 or first + number > count for first, number in pairs):
        raise ValueError(f"ranges: expected first triangles and numbers within {count} triangles, got {pairs}")
    return max(number for _, number in pairs)
