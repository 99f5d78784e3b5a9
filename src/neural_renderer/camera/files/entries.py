"""Camera files with matrices: K, R and t, view matrices, matrices to clip space, or an eye and a direction.

A file is one camera, or ``{"cameras": [{…}, …]}``. Each has one of

- ``K``, ``R``, ``t`` of OpenCV, and optionally ``dist_coeffs``: five numbers, or four with ``"fisheye": true``;
- ``world_to_camera`` or ``camera_to_world``, [3, 4] or [4, 4], and optionally ``convention`` (as in
  `Camera.from_matrix`; the default is "opencv"), with ``K`` and so on, ``viewing_angle`` (half, vertical, in degrees)
  or ``fov`` (the whole angle), or ``"orthographic": true`` and ``scale``;
- ``clip``, [4, 4], as in `Camera.from_clip`;
- ``rotation``, ``origin`` and other attributes of `Camera`, as `Camera.save` writes them;
- ``eye``, ``direction``, ``up``, and ``viewing_angle`` or ``fov``, as in `Camera.look` and in ``report.json`` of
  `fit`; or ``at`` in place of ``direction``, as in `Camera.look_at`; without either, the camera looks at the origin.

``width`` and ``height`` are the size in pixels of the image that K describes, and of the picture.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from ...io.files import short
from ..camera import Camera
from .keys import matrix, number, value_of

KINDS = ("K", "world_to_camera", "camera_to_world", "clip", "eye", "rotation")
_ATTRIBUTES = tuple(part.name for part in fields(Camera))
_KEYS = {
    "K": ("R", "t", "dist_coeffs", "fisheye"),
    "world_to_camera": ("convention", "K", "dist_coeffs", "fisheye", "viewing_angle", "fov", "orthographic", "scale"),
    "clip": (),
    "eye": ("direction", "at", "up", "viewing_angle", "fov"),
    "rotation": _ATTRIBUTES,
}
_KEYS["camera_to_world"] = _KEYS["world_to_camera"]
_NEEDED = {"K": ("K", "R", "t"), "rotation": ("rotation", "origin", "translation")}
_SHAPES: dict[str, tuple[tuple[int, ...], ...]] = {
    **dict.fromkeys(("K", "R", "rotation"), ((3, 3),)),
    **dict.fromkeys(("eye", "direction", "at", "up", "origin", "translation"), ((3,),)),
    "t": ((3,), (3, 1)),
    **dict.fromkeys(("world_to_camera", "camera_to_world"), ((4, 4), (3, 4))),
    "clip": ((4, 4),),
    "dist_coeffs": ((5,), (4,), (5, 1), (4, 1)),
}
_FREE = ("width", "height", "file", "mask")


def entry_camera(where: str, entry: dict[str, Any], size: tuple[int, int] | None) -> Camera:
    """Make the camera of an entry; ``size`` is its height and width in pixels, if the entry has none.

    ValueError: A key is missing or unknown, or a value does not fit; the message names the place.
    """
    # K is tested last: together with another key it is the lens.
    kind = next((name for name in (*KINDS[1:], "K") if name in entry), None)
    if kind is None:
        raise ValueError(f"{where}: expected one of the keys {', '.join(KINDS)}, got {short(', '.join(entry))}")
    unknown = [name for name in entry if name not in (kind, *_KEYS[kind], *_FREE)]
    if unknown:
        raise ValueError(f"{where}: expected the keys {', '.join((kind, *_KEYS[kind]))}, got {short(unknown[0])}")
    arguments = {
        name: _value(where, entry, name) for name, value in entry.items() if name not in _FREE and value is not None
    }
    for name in (*_NEEDED.get(kind, (kind,)), *(("orig_size",) if kind == "rotation" and "K" in arguments else ())):
        value_of(where, arguments, name)
    if "K" in arguments and kind != "rotation":
        arguments["orig_size"] = entry_size(where, entry) or size
    try:
        if kind == "rotation":
            parts: dict[str, Any] = {name: v[None] if isinstance(v, Tensor) else v for name, v in arguments.items()}
            return Camera(**parts)
        if kind == "clip":
            return Camera.from_clip(arguments["clip"])
        if kind == "eye":
            return (
                Camera.look(**arguments)
                if "direction" in arguments and "at" not in arguments
                else Camera.look_at(**arguments)
            )
        if kind != "K":
            return Camera.from_matrix(**arguments)
        make = Camera.fisheye if arguments.pop("fisheye", False) else Camera.projection
        return make(**arguments)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from None


def _value(where: str, entry: dict[str, Any], name: str) -> Any:
    """Check and convert the value of a key: tensors have torch's default dtype."""
    value = entry[name]
    if name in _SHAPES:
        return matrix(where, entry, name, *_SHAPES[name]).to(torch.get_default_dtype())
    if name in ("viewing_angle", "scale"):
        return number(where, entry, name)
    if name == "orig_size":
        height, width = matrix(where, entry, name, (2,)).tolist()
        return height, width
    if not isinstance(value, str if name == "convention" else bool):
        expected = "a name" if name == "convention" else "true or false"
        raise ValueError(f"{where}: {name}: expected {expected}, got {short(value)}")
    return value


def entries_of(camera: Camera) -> list[dict[str, Any]]:
    """Convert each camera to an entry of its attributes, without rounding."""
    entries = []
    for one in camera:
        values = {name: getattr(one, name) for name in _ATTRIBUTES if getattr(one, name) is not None}
        numbers = {n: v.reshape(v.shape[v.ndim > 0 :]).tolist() for n, v in values.items() if isinstance(v, Tensor)}
        entries.append({**values, **numbers})
    return entries


def entry_size(where: str, entry: dict[str, Any]) -> tuple[int, int] | None:
    """Return the height and width of an entry in pixels, or None if it has neither."""
    pair = entry.get("height"), entry.get("width")
    if pair == (None, None):
        return None
    height, width = pair
    if not all(isinstance(side, int) and not isinstance(side, bool) and side > 0 for side in pair):
        raise ValueError(f"{where}: expected width and height in pixels, got {short(width)} and {short(height)}")
    return height, width  # type: ignore[return-value]
