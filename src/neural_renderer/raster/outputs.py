"""Rendered images: colour, silhouettes, depth, and attributes of the visible surface."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

from torch import Tensor

from ..base.one_line import one_line

OUTPUTS = ("rgb", "alpha", "depth")
SURFACE = ("normal", "position", "uv", "face_index", "barycentric")
"""Outputs that only `render` has."""


class Images:
    """Rendered images. Row 0 is at the top.

    Unpacking gives three values, ``rgb, alpha, depth = images``, with None for an output that was not requested; the
    others are attributes only. ``vars(images)`` holds the outputs by name. The tensors may be changed in place before
    ``backward``; which ones there are is fixed, and `replace` makes a copy with others.

    Anti-aliasing averages ``rgb``, ``alpha``, ``depth``, ``normal``, ``position`` and ``uv`` over 2 x 2 points in a
    pixel, with the background where no face is visible; so the mean of the visible part of ``position`` is ``position /
    alpha``. All these have gradients, also through visibility. ``face_index`` and ``barycentric`` are those at the
    centre of the pixel, with or without anti-aliasing.

    Attributes:
        rgb: Colours, [B, 3, H, W] float32.
        alpha: Silhouettes, [B, H, W] float32: 1 where a face is visible, 0 elsewhere, in between at smoothed outlines.
        depth: Depth along the viewing axis in world units, [B, H, W] float32. Where no face is visible it is ``far``,
            or as `render` says if that is not given.
        normal: Unit normals in world space, [B, 3, H, W] float32, of the visible side of the surface: of the face for
            ``shading="flat"``, else smooth, without normal maps. 0 where no face is visible.
        position: Points of the surface in world space, [B, 3, H, W] float32; 0 where no face is visible.
        uv: Texture coordinates of a `UVMesh`, [B, 2, H, W] float32, v up; 0 where no face is visible.
        face_index: Visible face, [B, H, W] int32; -1 for none. It has no gradient.
        barycentric: Weights of the face's corners at the point in space, [B, 3, H, W] float32; their sum is 1, or 0
            where no face is visible. They have gradients inside faces, none through visibility.

    Raises:
        AttributeError: In reading an output that was not requested.

    Example:
        >>> images = nr.render(mesh, camera, 32, outputs=("rgb", "alpha"))
        >>> images.rgb.shape, hasattr(images, "depth")
        (torch.Size([1, 3, 32, 32]), False)
        >>> nr.render(mesh, camera, 32, outputs=("normal", "face_index")).normal.shape
        torch.Size([1, 3, 32, 32])
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    normal: Tensor
    position: Tensor
    uv: Tensor
    face_index: Tensor
    barycentric: Tensor

    def __init__(
        self,
        rgb: Tensor | None = None,
        alpha: Tensor | None = None,
        depth: Tensor | None = None,
        *,
        normal: Tensor | None = None,
        position: Tensor | None = None,
        uv: Tensor | None = None,
        face_index: Tensor | None = None,
        barycentric: Tensor | None = None,
    ) -> None:
        images = (rgb, alpha, depth, normal, position, uv, face_index, barycentric)
        for name, image in zip(OUTPUTS + SURFACE, images, strict=True):
            if image is not None:  # missing outputs are no attributes: `__getattr__` explains them
                object.__setattr__(self, name, image)

    def replace(self, **outputs: Tensor | None) -> Images:
        """Copy the images, with some of them exchanged.

        Args:
            **outputs: Images by their names; None for one that the copy lacks.

        Returns:
            The copy. It shares all other images.

        Raises:
            TypeError: A name is not one of the attributes.

        Example:
            >>> images = nr.render(mesh, camera, 32, outputs=("rgb", "face_index"))
            >>> brighter = images.replace(rgb=images.rgb * 1.5)
            >>> brighter.face_index is images.face_index
            True
        """
        return Images(**{**vars(self), **outputs})

    __replace__ = replace  # `copy.replace` of Python 3.13 and later

    def __iter__(self) -> Iterator[Tensor | None]:
        return (vars(self).get(name) for name in OUTPUTS)

    def __repr__(self) -> str:
        return one_line(type(self).__name__, vars(self).items())

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{name}: expected no change, because Images are immutable; `replace` makes a copy")

    def __getattr__(self, name: str) -> Any:
        if name in OUTPUTS + SURFACE:
            raise AttributeError(
                f"{name}: expected an output that was requested, got images of {', '.join(vars(self)) or 'nothing'}; "
                f'add "{name}" to outputs'
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


def checked_outputs(outputs: Collection[str], known: tuple[str, ...] = OUTPUTS) -> Collection[str]:
    """Return the names of outputs as a tuple or raise TypeError or ValueError."""
    if not isinstance(outputs, Collection) or getattr(outputs, "ndim", 1) != 1:
        raise TypeError(f"outputs: expected some of {', '.join(known)}, got {type(outputs).__name__}")
    names = (outputs,) if isinstance(outputs, str) else tuple(outputs)
    if not names or any(not isinstance(name, str) or name not in known for name in names):
        raise ValueError(f"outputs: expected some of {', '.join(known)}, got {', '.join(map(str, names)) or 'none'}")
    return names
