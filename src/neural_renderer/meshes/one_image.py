"""The attributes of a `UVMesh` with one image, from the usual forms of texture coordinates."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from .. import validate
from ..textures.sample_texture import Wrap, checked_wrap
from .mesh import as_tensor


def one_image(vertices: Any, faces: Any, uv: Any, image: Any, wrap: Wrap) -> tuple[Any, ...]:
    """Check the short form of `UVMesh`; return its attributes in order.

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or an index is out of range.
    """
    vertices = validate.floating("vertices", as_tensor(vertices), ("V", 3)).float()
    faces = validate.indices("faces", as_tensor(faces), ("F", 3)).int()
    image = as_tensor(image)
    if isinstance(image, Tensor) and image.ndim == 3 and image.shape[0] == 3 != image.shape[2]:
        got = validate.shape_of(image)
        raise ValueError(f"image: expected [H, W, 3], got {got}, channels first; image.movedim(0, 2) converts it")
    image = validate.floating("image", image, ("H", "W", 3)).float()
    uv = _of_corners(uv, faces, len(vertices))
    validate.same_device(vertices=vertices, faces=faces, uv=uv, image=image)
    validate.in_range("faces", faces, len(vertices))
    checked_wrap(wrap)
    count = len(faces)
    index = torch.zeros(count, dtype=torch.int64, device=faces.device)
    return vertices, faces, uv, index, (image,), torch.ones(count, 3, 3, device=faces.device), (wrap,)


def _of_corners(uv: Any, faces: Tensor, vertices: int) -> Tensor:
    """Convert one of the three forms of texture coordinates to [F, 3, 2] float32."""
    own = faces
    if isinstance(uv, (tuple, list)) and len(uv) == 2 and hasattr(uv[1], "shape"):
        uv, own = as_tensor(uv[0]), validate.indices("uv", as_tensor(uv[1]), (len(faces), 3))
        validate.floating("uv", uv, ("U", 2))
        validate.same_device(uv=uv, **{"indices of uv": own})
        validate.in_range("uv", own, len(uv))
        return uv.float()[own.long()]
    uv = as_tensor(uv)
    if getattr(uv, "ndim", 3) == 2:
        validate.floating("uv", uv, (vertices, 2))
        validate.in_range("faces", faces, vertices)
        return uv.float()[faces.long()]
    return validate.floating("uv", uv, (len(faces), 3, 2)).float()
