"""`DepthPeeler`: the triangles of each pixel in order of depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor

from .. import validate
from .contexts import RasterizeCudaContext, free_context
from .rasterization import Layers


class DepthPeeler:
    """Rasterise depth layers one after the other, in a ``with`` block (Everitt, 2001).

    The first layer is that of `rasterize`; each further one shows what lies behind the layer before. Surfaces nearer to
    each other than 3e-6 in z / w count as one.

    Args:
        glctx, pos, tri, resolution, ranges, grad_db: As in `rasterize`. The context serves no other call inside the
            block.

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
        self._layers = _layers(glctx, pos, tri, resolution, ranges, grad_db)

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
        return self._layers.next()


_layers = validate.checked_together(Layers)
