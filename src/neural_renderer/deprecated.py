"""Old names of public objects and arguments, for one version."""

from __future__ import annotations

import functools
import importlib
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


def old_method(old: str, new: str) -> Callable[..., Any]:
    """Make a method that calls another one of its object, with a DeprecationWarning.

    Args:
        old: Old name of the method.
        new: New name.
    """

    def call(self: Any, *arguments: Any, **named: Any) -> Any:
        kind = type(self).__qualname__
        warnings.warn(f"{kind}.{old} is now {new}; the old name goes in 2.1", DeprecationWarning, stacklevel=2)
        return getattr(self, new)(*arguments, **named)

    call.__name__, call.__doc__ = old, f"Call `{new}`, the new name of this method."
    call.is_old_name = True  # type: ignore[attr-defined]
    return call


def old_module(module: str, new: str, **names: str) -> Callable[[str], Any]:
    """Make the function ``__getattr__`` of a module whose objects are elsewhere now, with a DeprecationWarning.

    Args:
        module: Old name of the module.
        new: New name.
        names: Old name to new name of objects that have another name there.
    """

    def find(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        found = getattr(importlib.import_module(new), names.get(name, name))
        now = f"{new}.{names.get(name, name)}"
        warnings.warn(f"{module}.{name} is now {now}; the old name goes in 2.1", DeprecationWarning, stacklevel=2)
        return found

    return find
