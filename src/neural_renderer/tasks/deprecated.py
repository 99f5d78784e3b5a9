"""Old names of public objects, for one version."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any


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
