"""Old names of public objects and arguments, for one version."""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])


def old_names(module: str, **names: str) -> Callable[[str], Any]:
    """Make the function ``__getattr__`` of a module that finds objects by their old names, with a DeprecationWarning.

    Args:
        module: Name of the module.
        names: Old name to new name.
    """

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warnings.warn(
            f"{module}.{name} is now {names[name]}; the old name goes in 2.1", DeprecationWarning, stacklevel=2
        )
        return getattr(sys.modules[module], names[name])

    return find


def old_argument(old: str, new: str) -> Callable[[_Function], _Function]:
    """Make a decorator of a function that takes an argument by its old name too, with a DeprecationWarning.

    Args:
        old: Old name of the argument.
        new: New name.
    """

    def decorate(function: _Function) -> _Function:
        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            if old in named:
                warnings.warn(
                    f"{function.__qualname__}: {old} is now {new}; the old name goes in 2.1",
                    DeprecationWarning,
                    stacklevel=2,
                )
                named[new] = named.pop(old)
            return function(*arguments, **named)

        return cast(_Function, call)

    return decorate
