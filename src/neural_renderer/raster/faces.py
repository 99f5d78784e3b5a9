"""Faces as corners: gathered from vertices, validated at the public border."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..base import validate
from .ops.corners import gather_corners


def vertices_to_faces(vertices: Tensor, faces: Tensor) -> Tensor:
    """Gather the corners of each face.

    Args:
        vertices: [B, V, 3] floating.
        faces: Vertex indices in [0, V), [F, 3] for all meshes or [B or 1, F, 3]; whole numbers of any real dtype. A
            face of (-1, -1, -1) is padding, in a batch of meshes of different sizes.

    Returns:
        [B, F, 3, 3] float32; zeros for padding.

    Raises:
        TypeError: Another dtype.
        ValueError: Another shape, device or index.

    Example:
        >>> nr.vertices_to_faces(torch.rand(2, 4, 3), torch.tensor([[0, 1, 2], [0, 2, 3]])).shape
        torch.Size([2, 2, 3, 3])
    """
    return corners_of(validate.floating("vertices", vertices, ("B", "V", 3)), checked_faces(faces))


def corners_of(vertices: Tensor, faces: Tensor, in_range: bool = False) -> Tensor:
    """Gather the corners of each face as `vertices_to_faces`, from tensors of valid types and shapes.

    With ``in_range`` the indices are known to be valid. Raises ValueError for another device, batch or index.
    """
    faces = corner_indices(vertices, faces, len(vertices), in_range)
    return gather_corners(vertices.float(), faces)


def corner_indices(vertices: Tensor, faces: Tensor, images: int, in_range: bool = False) -> Tensor:
    """Convert the vertex indices of faces for operators that gather corners of B images: [B or 1, F, 3] int32.

    Vertices [..., V, 3] are on the device of the faces, [F, 3] or [B or 1, F, 3] int32 or int64; the rest is as in
    `corners_of`.
    """
    validate.same_device(vertices=vertices, faces=faces)
    given, faces = faces, faces[None] if faces.dim() == 2 else faces
    if faces.shape[0] not in (1, images):
        raise ValueError(f"faces: expected a batch of {images} like vertices, got {faces.shape[0]}")
    if not in_range:
        validate.in_range("faces", given, vertices.shape[-2], padded=True)  # which is known, if it was checked before
    if faces.dtype == torch.int64:  # an index that is out of range stays so in 32 bits
        faces = faces.clamp(-1, 2**31 - 1)
    return faces.int()


def world_corners(vertices: Tensor, faces: Tensor, images: int, in_range: bool = False) -> Tensor:
    """Gather the corners of faces in world space, for lighting; arguments as in `corner_indices`.

    If there are faces for each image, one mesh is repeated for all of them.
    """
    vertices = vertices if vertices.dim() == 3 else vertices[None]
    if faces.dim() == 3 and len(faces) == images:
        vertices = vertices.expand(images, -1, -1)
    return corners_of(vertices, faces, in_range)


def checked_faces(faces: Any) -> Tensor:
    """Return ``faces`` [F, 3] or [B, F, 3] as int32 or int64 (`validate.indices`) or raise TypeError or ValueError."""
    return validate.indices("faces", faces, ("F", 3) if getattr(faces, "ndim", 3) == 2 else ("B", "F", 3))


def checked_triangles(triangles: Any, corners: Tensor) -> Tensor:
    """Return ``triangles`` as indices that fit to ``corners`` [B, F, 3, 3] or raise TypeError or ValueError."""
    batch, count = corners.shape[:2]
    shape = ("F", 3) if getattr(triangles, "ndim", 3) == 2 else ("B", "F", 3)
    triangles = validate.indices("triangles", triangles, shape)
    if triangles.shape[-2] != count or (triangles.dim() == 3 and len(triangles) not in (1, batch)):
        raise ValueError(
            f"triangles: expected [{count}, 3] or [{batch} or 1, {count}, 3] like faces, "
            f"got {validate.shape_of(triangles)}"
        )
    validate.same_device(faces=corners, triangles=triangles)
    return triangles
