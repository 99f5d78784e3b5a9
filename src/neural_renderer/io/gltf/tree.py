"""Values in the JSON of a glTF file, checked where they are read."""

from __future__ import annotations

import math
from typing import Any

from ..files import short


class GltfError(ValueError):
    """What does not fit in a file, in a sentence."""


def dicts(tree: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return a list of objects in a JSON object; empty if there is none."""
    values = _list(tree, name)
    if not all(isinstance(value, dict) for value in values):
        raise GltfError(f"{name}: expected a list of objects, got {short(values)}")
    return values


def _list(tree: dict[str, Any], name: str) -> list[Any]:
    values = tree.get(name, [])
    if not isinstance(values, list):
        raise GltfError(f"{name}: expected a list of objects, got {short(values)}")
    return values


def as_object(value: Any, what: str = "") -> dict[str, Any]:
    """Return a value if it is a JSON object."""
    if not isinstance(value, dict):
        raise GltfError(f"{what + ': ' if what else ''}expected an object in its JSON, got {short(value)}")
    return value


def child(owner: dict[str, Any], name: str) -> dict[str, Any]:
    """Return an object in an object; empty if there is none."""
    return as_object(owner.get(name, {}), name)


def extension(owner: dict[str, Any], name: str) -> dict[str, Any] | None:
    """Return an extension of an object; None if it has none of this name."""
    found = child(owner, "extensions").get(name)
    return None if found is None else as_object(found, name)


def item(tree: dict[str, Any], name: str, number: Any) -> dict[str, Any]:
    """Return an entry of a list in the JSON of a file; the others are not checked, which would take quadratic time."""
    values = _list(tree, name)
    if not _is_whole(number) or not 0 <= number < len(values):
        raise GltfError(f"expected one of its {len(values)} {name}, got {short(number)}")
    return as_object(values[int(number)], name)


def whole(owner: dict[str, Any], name: str, default: int | None = None) -> int:
    """Read a whole number ≥ 0; without a default it has to be there."""
    value: Any = owner.get(name, default)
    if not _is_whole(value) or not 0 <= value < 1 << 53:
        raise GltfError(f"expected a whole number as {name}, got {short(value)}")
    return int(value)


def wholes(owner: dict[str, Any], name: str) -> list[int]:
    """Read a list of whole numbers ≥ 0; empty if there is none."""
    values = owner.get(name, [])
    if not isinstance(values, list) or not all(_is_whole(value) and value >= 0 for value in values):
        raise GltfError(f"expected a list of whole numbers as {name}, got {short(values)}")
    return [int(value) for value in values]


def texts(owner: dict[str, Any], name: str) -> list[str]:
    """Read a list of texts; empty if there is none."""
    values = owner.get(name, [])
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise GltfError(f"expected a list of texts as {name}, got {short(values)}")
    return values


def numbers(
    owner: dict[str, Any], name: str, default: tuple[float, ...], least: float | None = 0.0, most: float | None = None
) -> Any:
    """Read a number, or a list of as many as ``default`` has; numbers out of range become the nearest in it."""
    value = owner.get(name, default)
    values = value if isinstance(value, (list, tuple)) else [value]
    known = all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in values)
    if not known or len(values) != len(default) or not all(abs(number) < 1e38 for number in values):
        raise GltfError(f"expected {len(default)} finite numbers as {name}, got {short(value)}")
    low, high = -math.inf if least is None else least, math.inf if most is None else most
    return tuple(min(max(float(number), low), high) for number in values)


def label(owner: dict[str, Any], default: str) -> str:
    """Return the name of an object, cut if it is long."""
    name = owner.get("name")
    return short(name)[1:-1] if isinstance(name, str) and name else default


def _is_whole(value: Any) -> bool:
    """Test whether a number is whole; JSON may write it as 1.0."""
    return not isinstance(value, bool) and (isinstance(value, int) or (isinstance(value, float) and value.is_integer()))
