"""Cameras of a batch, and batches put together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from .. import validate
from .parameters import Scalar

if TYPE_CHECKING:
    from .camera import Camera

_TENSORS = ("rotation", "origin", "translation", "K", "dist_coeffs")
_LENSES = ("viewing_angle", "scale")


def chosen(camera: Camera, index: Any) -> dict[str, Any]:
    """Index the attributes of a camera that have a batch; the result has one too.

    Raises:
        IndexError: A number is out of range.
        TypeError: ``index`` is not a number, a slice, a list or a tensor.
    """
    if isinstance(index, bool) or (isinstance(index, Tensor) and index.ndim == 0 and index.dtype == torch.bool):
        raise TypeError("index: expected a number, a slice, a list or a tensor, got a bool")
    rows = torch.arange(len(camera), device=camera.rotation.device)
    if isinstance(index, (slice, range)):  # torch knows no negative steps
        index = list(range(len(camera))[index]) if isinstance(index, slice) else list(index)
    try:
        rows = torch.atleast_1d(rows[index])
    except (TypeError, IndexError) as error:
        kind = IndexError if isinstance(error, IndexError) else TypeError
        raise kind(f"index: expected some of {len(camera)} cameras, got {index!r}") from None
    if rows.ndim > 1:
        raise IndexError(f"index: expected some of {len(camera)} cameras, got {index!r}")
    parts = {name: value[rows] for name in _TENSORS if (value := getattr(camera, name)) is not None}
    for name in _LENSES:
        value = getattr(camera, name)
        if isinstance(value, Tensor) and value.ndim and len(value) == len(camera):
            parts[name] = value[rows.to(value.device)]
    return parts


def concatenated(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Concatenate the attributes of cameras that have a batch.

    Raises:
        ValueError: They differ in lens, device or mirroring.
    """
    first = cameras[0]
    if len({_lens(camera) for camera in cameras}) > 1:
        found = " and ".join(sorted({_lens(camera) for camera in cameras}))
        raise ValueError(f"cameras: expected one kind of lens, got {found}")
    if len({camera.mirrored for camera in cameras}) > 1:
        raise ValueError("cameras: expected all mirrored or none, got both")
    validate.same_device(**{f"cameras[{i}]": camera.rotation for i, camera in enumerate(cameras)})
    parts: dict[str, Any] = {
        name: torch.cat([getattr(c, name) for c in cameras]) for name in ("rotation", "origin", "translation")
    }
    for name in _LENSES:
        if getattr(first, name) is not None:
            parts[name] = _numbers([getattr(camera, name) for camera in cameras], list(map(len, cameras)))
    if first.K is not None:
        parts["K"] = torch.cat([_resized(camera, first.orig_size) for camera in cameras])
    if any(camera.dist_coeffs is not None for camera in cameras):
        parts["dist_coeffs"] = torch.cat([_distortion(camera) for camera in cameras])
    return parts


def _lens(camera: Camera) -> str:
    if camera.K is not None:
        return "fisheye" if camera.is_fisheye else "K"
    return "orthographic" if camera.viewing_angle is None else "viewing_angle"


def _numbers(values: list[Scalar], counts: list[int]) -> Scalar:
    """Put one number, or one tensor [] or [B], for each batch together; equal numbers stay a number."""
    if not any(isinstance(value, Tensor) for value in values) and len(set(values)) == 1:
        return values[0]
    like = next((v for v in values if isinstance(v, Tensor)), torch.empty(0))
    parts = [torch.as_tensor(value, dtype=like.dtype, device=like.device) for value in values]
    return torch.cat([part.expand(count) for part, count in zip(parts, counts, strict=True)])


def _resized(camera: Camera, size: tuple[float, float] | None) -> Tensor:
    """Convert a camera's K to an image of another size, which shows the same."""
    K: Any = camera.K
    if camera.orig_size is None or size is None or camera.orig_size == size:
        return K
    return K * K.new_tensor([size[1] / camera.orig_size[1], size[0] / camera.orig_size[0], 1.0])[:, None]


def _distortion(camera: Camera) -> Tensor:
    return camera.rotation.new_zeros(len(camera), 5) if camera.dist_coeffs is None else camera.dist_coeffs
