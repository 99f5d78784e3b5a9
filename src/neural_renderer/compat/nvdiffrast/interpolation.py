"""`interpolate`: attributes of vertices at every pixel."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor

from ...base import validate
from ...base.constants import constant, on_device
from ...raster.clip.attributes import interpolate_attributes
from . import checks


@validate.checked_together
def interpolate(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None = None,
    diff_attrs: str | Sequence[int] | None = None,
) -> tuple[Tensor, Tensor]:
    """Interpolate attributes of vertices at pixels.

    Gradients reach ``attr``, ``rast`` and ``rast_db``.

    Args:
        attr: [B or 1, V, A] float32, or [V, A] in range mode.
        rast: As from `rasterize`, [B, H, W, 4] float32.
        tri: Indices into the attributes, [F, 3] int32.
        rast_db: As from `rasterize`, or None.
        diff_attrs: Attributes whose screen-space derivatives are returned: indices, or "all".

    Returns:
        [B, H, W, A] float32, 0 where there is no triangle. The derivatives of the attributes in ``diff_attrs``,
        (dA/dX, dA/dY) for each in turn, [B, H, W, 2 N]; [B, H, W, 0] unless ``rast_db`` and ``diff_attrs`` are given.

    Raises:
        TypeError, ValueError: An argument of another type, shape, device or range.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> pos = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1]]])
        >>> tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
        >>> rast, rast_db = dr.rasterize(dr.RasterizeCudaContext(), pos, tri, resolution=[64, 64])
        >>> color, change = dr.interpolate(torch.eye(3)[None], rast, tri, rast_db=rast_db, diff_attrs="all")
        >>> color.shape, change.shape
        (torch.Size([1, 64, 64, 3]), torch.Size([1, 64, 64, 6]))
    """
    values = checks.per_vertex("attr", attr, "A")
    rast = checks.float32("rast", rast, ("B", "H", "W", 4))
    tri = checks.triangles(tri, values.shape[1])
    validate.same_device(attr=attr, rast=rast, tri=tri, rast_db=rast_db)
    checks.batch_like("attr", values, rast.shape[0], "rast")
    if rast_db is None or diff_attrs is None:
        return interpolate_attributes(values, rast, tri, None, 0, None)
    checks.float32("rast_db", rast_db, tuple(rast.shape))
    return interpolate_attributes(values, rast, tri, rast_db, *_chosen(diff_attrs, values, tri))


def _chosen(diff_attrs: str | Sequence[int], values: Tensor, tri: Tensor) -> tuple[int, Tensor | None]:
    """Return the number of attributes and, unless they are all, their indices; raise unless these are in range."""
    count = values.shape[2]
    if isinstance(diff_attrs, str):
        if diff_attrs != "all":
            raise ValueError(f"diff_attrs: expected 'all' or numbers of attributes, got {diff_attrs!r}")
        return count, None
    if not isinstance(diff_attrs, Iterable):
        raise TypeError(f"diff_attrs: expected 'all' or numbers of attributes, got {type(diff_attrs).__name__}")
    numbers = [validate.whole("diff_attrs", number, 0) for number in diff_attrs]
    if any(number >= count for number in numbers):
        raise ValueError(f"diff_attrs: expected numbers below {count}, got {numbers}")
    if numbers == list(range(len(numbers))):
        return len(numbers), None
    known = constant(numbers, torch.int32, values.device)
    return len(numbers), on_device(torch.tensor(numbers, dtype=torch.int32), tri) if known is None else known
