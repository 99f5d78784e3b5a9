"""The place of the compiled part of `o_voxel`, so that the rest, such as `o_voxel.postprocess`, can be imported."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

__all__: list[str] = []


def __getattr__(name: str) -> Callable[..., Any]:
    """Return a function that says, when it is called, that it is missing."""
    if name.startswith("__"):
        raise AttributeError(name)

    def missing(*_: Any, **__: Any) -> Any:
        raise NotImplementedError(f"o_voxel._C.{name}: expected o_voxel to be built, because this is not here")

    return missing
