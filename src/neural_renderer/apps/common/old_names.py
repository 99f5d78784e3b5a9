"""`old_keywords`: keywords of the version before, which work for one release with a warning."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

_Callable = TypeVar("_Callable", bound=Callable[..., Any])


def old_keywords(**new: str) -> Callable[[_Callable], _Callable]:
    """Make a decorator of a function or class that takes old keywords, too.

    ``new`` has the keyword that takes the place of each old one, or "" if the old one has no effect.
    """

    def decorate(target: Any) -> Any:
        if isinstance(target, type):
            target.__init__ = decorate(target.__init__)  # type: ignore[misc]
            return target
        name = target.__qualname__.removesuffix(".__init__")

        @functools.wraps(target)
        def call(*arguments: Any, **named: Any) -> Any:
            for old in new.keys() & named.keys():
                value, instead = named.pop(old), new[old]
                if instead in named:
                    raise TypeError(f"{name}: expected one of {instead} and its old name {old}, got both")
                said = f"is {instead}" if instead else "has no effect"
                warnings.warn(f"{name}: {old} {said} since version 2.2", DeprecationWarning, stacklevel=2)
                named |= {instead: value} if instead else {}
            return target(*arguments, **named)

        return call

    return decorate
