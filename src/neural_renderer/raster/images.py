"""Rendered images: colour, silhouettes and depth."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from torch import Tensor

OUTPUTS = ("rgb", "alpha", "depth")


class _Outputs(NamedTuple):
    """Storage of `Images`: None for an output that was not requested."""

    rgb: Tensor | None = None
    alpha: Tensor | None = None
    depth: Tensor | None = None


class Images(_Outputs):
    """Rendered images. Row 0 is at the top.

    Unpacking gives three values, ``rgb, alpha, depth = images``, with None for an output that was not requested.
    Images may be changed in place before ``backward``.

    Attributes:
        rgb: Colours, [B, 3, H, W] float32.
        alpha: Silhouettes, [B, H, W] float32: 1 where a face is visible, 0 elsewhere, in between at smoothed outlines.
        depth: Depth along the viewing axis in world units, [B, H, W] float32; ``far`` where no face is visible.

    Raises:
        AttributeError: In reading an output that was not requested.

    Example:
        >>> images = nr.render(mesh, camera, 32, outputs=("rgb", "alpha"))
        >>> images.rgb.shape, hasattr(images, "depth")
        (torch.Size([1, 3, 32, 32]), False)
    """

    __slots__ = ()

    @property
    def rgb(self) -> Tensor:
        """Colours, [B, 3, H, W] float32."""
        return self._drawn(0)

    @property
    def alpha(self) -> Tensor:
        """Silhouettes, [B, H, W] float32: 1 where a face is visible, 0 elsewhere, in between at smoothed outlines."""
        return self._drawn(1)

    @property
    def depth(self) -> Tensor:
        """Depth along the viewing axis in world units, [B, H, W] float32; ``far`` where no face is visible."""
        return self._drawn(2)

    def _drawn(self, index: int) -> Tensor:
        image = self[index]
        if image is None:
            name, drawn = OUTPUTS[index], [name for name, value in zip(OUTPUTS, self, strict=True) if value is not None]
            raise AttributeError(
                f"{name}: expected an output that was requested, got images of {', '.join(drawn) or 'nothing'}; "
                f'add "{name}" to outputs'
            )
        return image


def checked_outputs(outputs: Collection[str]) -> Collection[str]:
    """Return the names of outputs as a tuple or raise TypeError or ValueError."""
    if not isinstance(outputs, Collection) or getattr(outputs, "ndim", 1) != 1:
        raise TypeError(f"outputs: expected some of {', '.join(OUTPUTS)}, got {type(outputs).__name__}")
    names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    if not names or any(not isinstance(name, str) or name not in OUTPUTS for name in names):
        raise ValueError(f"outputs: expected some of {', '.join(OUTPUTS)}, got {', '.join(map(str, names)) or 'none'}")
    return names
