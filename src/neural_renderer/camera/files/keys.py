"""Reading of values from camera files by key, with errors that name the place in the file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...io.files import read_text, reason, short

LARGEST = torch.finfo(torch.float32).max


def read_json(path: Path) -> Any:
    """Parse a JSON file; raise ValueError if it is malformed."""
    try:
        return json.loads(read_text(path))
    except RecursionError:
        raise ValueError(f"{path}: expected JSON, got lists in lists, too many to read") from None
    except ValueError as error:
        raise ValueError(f"{path}: expected JSON, got text that is none ({reason(error)})") from None


def rows_of(path: Path, rows: Any) -> list[tuple[str, dict[str, Any]]]:
    """Check a list of entries: return the place in the file, for messages, and the keys of each."""
    if not isinstance(rows, list) or not rows:
        raise ValueError(f"{path}: expected at least one image, got none")
    for index, row in enumerate(rows):
        if not isinstance(row, dict):
            raise ValueError(f"{path}: image {index}: expected an object with keys, got {short(row)}")
    return [(f"{path}: image {index}", row) for index, row in enumerate(rows)]


def value_of(where: str, row: dict[str, Any], key: str) -> Any:
    """Return the value of a key; raise ValueError if it is missing or empty."""
    if key in row and row[key] in (None, ""):
        raise ValueError(f'{where}: expected a value for the key "{key}", got none')
    if key not in row:
        raise ValueError(f'{where}: expected the key "{key}", got {short(", ".join(row) or "none")}')
    return row[key]


def number(where: str, row: dict[str, Any], key: str, default: float | None = None) -> float:
    """Return the number of a key, or ``default`` if it is missing; raise ValueError if it is not finite."""
    value = row.get(key, default) if default is not None else value_of(where, row, key)
    try:
        found = validate.number(key, float(value if value not in (None, "") else default))  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        found = math.inf
    if not abs(found) <= LARGEST:
        raise ValueError(f"{where}: {key}: expected a finite number, got {short(value)}")
    return found


def above_zero(where: str, row: dict[str, Any], key: str, default: float | None = None) -> float:
    """Return a number as `number` does; raise ValueError if it is not > 0."""
    value = number(where, row, key, default)
    if value <= 0:
        raise ValueError(f"{where}: {key}: expected a number above 0, got {value:g}")
    return value


def matrix(where: str, row: dict[str, Any], key: str, *shapes: tuple[int, ...]) -> Tensor:
    """Return the finite numbers of a key as a float64 tensor of one of the shapes; raise ValueError otherwise."""
    value = value_of(where, row, key)
    try:
        found = torch.tensor(value, dtype=torch.float64)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        found = torch.zeros(0)
    if tuple(found.shape) not in shapes or not bool((found.abs() <= LARGEST).all()):
        shape = " x ".join(map(str, shapes[0]))
        raise ValueError(f"{where}: {key}: expected {shape} finite numbers, got {short(value)}")
    return found


def check_rotation(where: str, key: str, rotation: Tensor, value: Any) -> None:
    """Raise ValueError if a matrix [3, 3] is not a rotation."""
    if (
        not torch.allclose(rotation @ rotation.t(), torch.eye(3, dtype=rotation.dtype), atol=1e-3)
        or torch.det(rotation) < 0
    ):
        raise ValueError(f"{where}: {key}: expected a rotation without scale or mirroring, got {short(value)}")


def mask_of(row: dict[str, Any], key: str = "mask") -> str | None:
    """Return the name of a mask, or None if there is none."""
    return str(row[key]) if row.get(key) else None
