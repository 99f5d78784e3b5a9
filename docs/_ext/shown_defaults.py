"""Shows defaults that are named constants, such as ``views=CompareOptions.views``, as numbers and texts: ``views=24``.

Sphinx writes other defaults as the source has them.
"""

import inspect
import re
from typing import Any

from sphinx.application import Sphinx

_NAME = re.compile(r"[A-Za-z_][\w.]*")


def _show(app: Sphinx, function: Any, bound: bool) -> None:
    """Replace the names in the signature that Sphinx has written for a function."""
    written = getattr(function, "__signature__", None)
    inner: Any = inspect.unwrap(getattr(function, "__func__", function))
    if written is None or not hasattr(inner, "__defaults__"):
        return
    positional = inner.__code__.co_varnames[: inner.__code__.co_argcount]
    values = dict(zip(reversed(positional), reversed(inner.__defaults__ or ()), strict=False))
    values |= inner.__kwdefaults__ or {}
    parameters = []
    for each in written.parameters.values():
        value = values.get(each.name)
        if _NAME.fullmatch(repr(each.default)) and type(value) in (int, float, str):
            each = each.replace(default=value)
        parameters.append(each)
    function.__dict__["__signature__"] = written.replace(parameters=parameters)  # also of a bound method


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-before-process-signature", _show, priority=900)  # after Sphinx's own
    return {"parallel_read_safe": True}
