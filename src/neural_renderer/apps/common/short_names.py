"""`short_names`: single settings as keywords of a function that takes groups of settings."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar, cast

from ...base import validate

_Function = TypeVar("_Function", bound=Callable[..., Any])


def short_names(*names: str, **places: str) -> Callable[[_Function], _Function]:
    """Make a decorator of a function with groups of settings that takes single settings, too.

    ``places`` are keywords with the "group.field" that each sets; ``names`` are those that are named like their field.
    A group may be in a group: "group.inner.field".
    """
    places |= {name.rpartition(".")[2]: name for name in names}

    def decorate(function: _Function) -> _Function:
        defaults = {name: each.default for name, each in inspect.signature(function).parameters.items()}

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            for name in places.keys() & named.keys():
                group, *path = places[name].split(".")
                with validate.called(**{path[-1]: name}):
                    named[group] = _replaced(named.get(group, defaults[group]), path, named.pop(name))
            return function(*arguments, **named)

        return cast(_Function, call)

    return decorate


def _replaced(group: Any, path: list[str], value: Any) -> Any:
    """Copy a group of settings with another value of a field, which may be in an inner group."""
    name, *inner = path
    return replace(group, **{name: _replaced(getattr(group, name), inner, value) if inner else value})
