"""Public names of a package that load at first use, so that its options can be read without torch (PEP 562)."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def names_of(package: str, **old: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Make ``__getattr__`` and ``__dir__`` of a package whose public names are in its module `interface`.

    ``old`` are names of the version before, which are not listed, with the modules of applications that define them.
    """

    def get(name: str) -> Any:
        if name in old:
            return getattr(import_module(f"neural_renderer.apps.{old[name]}"), name)
        if name == "__all__" or not name.startswith("_"):
            interface = import_module(f"{package}.interface")
            if name in (*interface.__all__, "__all__"):
                return getattr(interface, name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return get, lambda: sorted(import_module(f"{package}.interface").__all__)
