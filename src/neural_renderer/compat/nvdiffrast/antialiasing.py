"""`antialias`: anti-aliased silhouettes with gradients to vertices."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from ...base import validate
from ...base.one_line import OneLine
from ...raster.clip.silhouettes import blend_silhouettes
from ...raster.ops.half_edges import find_half_edges
from . import checks


@dataclass(frozen=True, eq=False, repr=False)
class TopologyHash(OneLine):
    """The adjacency of triangles, from `antialias_construct_topology_hash`."""

    siblings: Tensor


@validate.checked_together
def antialias(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    topology_hash: TopologyHash | None = None,
    pos_gradient_boost: float = 1.0,
) -> Tensor:
    """Anti-alias an image at silhouettes.

    A silhouette is a boundary edge, or an edge between a front and a back face. It is searched in the triangle of the
    nearer of two adjacent pixels that show different triangles. If it crosses the line between their centres at
    distance d from the nearer pixel's centre, the pixel that it crosses changes by (d − 1/2) of their colour difference
    (Laine et al., 2020, on antialiasing). So the image is a continuous function of the vertices there.
    Edges steeper than 45° blend horizontal neighbours, others vertical ones. Vertices must be shared: duplicated
    vertices make silhouettes.

    Args:
        color: [B, H, W, C] float32. It gets gradients.
        rast: As from `rasterize`, [B, H, W, 4] float32.
        pos: As in `rasterize`. It gets gradients.
        tri: As in `rasterize`.
        topology_hash: The result of `antialias_construct_topology_hash`, or None. The adjacency of the last meshes is
            cached in any case.
        pos_gradient_boost: Factor of the gradient to ``pos``.

    Returns:
        [B, H, W, C] float32.

    Raises:
        TypeError, ValueError: An argument of another type, shape, device or range.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> pos = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1]]], requires_grad=True)
        >>> tri = torch.tensor([[0, 1, 2]], dtype=torch.int32)
        >>> rast, _ = dr.rasterize(dr.RasterizeCudaContext(), pos, tri, resolution=[64, 64])
        >>> image = dr.antialias((rast[..., 3:] > 0).float(), rast, pos, tri)
        >>> image.sum().backward()
        >>> bool(pos.grad[0, 1, 0] > 0)  # a vertex that moves outwards makes the triangle larger
        True
    """
    color = checks.float32("color", color, ("B", "H", "W", "C"))
    rast = checks.float32("rast", rast, (*color.shape[:3], 4))
    positions = checks.clip_positions(pos)
    tri = checks.triangles(tri, positions.shape[1])
    validate.same_device(color=color, rast=rast, pos=pos, tri=tri)
    checks.batch_like("pos", positions, color.shape[0], "color")
    boost = validate.number("pos_gradient_boost", pos_gradient_boost)
    if topology_hash is None:
        topology_hash = TopologyHash(find_half_edges(tri).siblings)
    if not isinstance(topology_hash, TopologyHash):
        expected = "the result of antialias_construct_topology_hash"
        raise TypeError(f"topology_hash: expected {expected}, got {type(topology_hash).__name__}")
    if topology_hash.siblings.shape[1] != tri.shape[0]:
        raise ValueError(f"topology_hash: expected that of {len(tri)} triangles, got {topology_hash.siblings.shape[1]}")
    return blend_silhouettes(color, rast.detach(), positions, tri, topology_hash.siblings, boost)[0]


def antialias_construct_topology_hash(tri: Tensor) -> TopologyHash:
    """Compute the adjacency of triangles once for several calls of `antialias`.

    Args:
        tri: As in `rasterize`.

    Returns:
        An object for the argument ``topology_hash`` of `antialias`.

    Raises:
        TypeError, ValueError: ``tri`` is not [F, 3] int32.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> topology_hash = dr.antialias_construct_topology_hash(torch.tensor([[0, 1, 2]], dtype=torch.int32))
    """
    return TopologyHash(find_half_edges(checks.triangles(tri, 2**31 - 1)).siblings)
