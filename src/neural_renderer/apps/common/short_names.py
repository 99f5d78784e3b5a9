"""`short_names`: single settings as keywords of a function that takes groups of settings."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])


def short_names(*names: str, **places: str) -> Callable[[_Function], _Function]:
    """Make a decorator of a function with groups of settings that takes single settings, too.

    ``places`` are keywords with the "group.field" that each sets; ``names`` are those that are named like their field.
    """
    places |= {name.partition(".")[2]: name for name in names}

    def decorate(function: _Function) -> _Function:
        defaults = {name: each.default for name, each in inspect.signature(function).parameters.items()}

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            for name in places.keys() & named.keys():
                group, _, member = places[name].partition(".")
                named[group] = replace(named.get(group, defaults[group]), **{member: named.pop(name)})
            return function(*arguments, **named)

        return cast(_Function, call)

    return decorate
