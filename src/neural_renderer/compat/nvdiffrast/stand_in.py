"""`stand_in`: ``import nvdiffrast.torch`` where nvdiffrast is not installed."""

from __future__ import annotations

import contextlib
import importlib.util
import sys
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from types import ModuleType

from ...version import __version__

_NAMES = ("nvdiffrast", "nvdiffrast.torch")


@contextlib.contextmanager
def stand_in(always: bool = False) -> Iterator[None]:
    """Let ``import nvdiffrast.torch`` find this package inside the block, unless nvdiffrast is installed.

    Args:
        always: Whether to replace an installed nvdiffrast, too.

    Returns:
        Context manager.

    Example:
        >>> with stand_in():
        ...     import nvdiffrast.torch as dr
        >>> glctx = dr.RasterizeCudaContext()
    """
    if not always and (_NAMES[0] in sys.modules or importlib.util.find_spec(_NAMES[0])):
        yield
        return
    package = ModuleType(_NAMES[0], "This package's rasteriser under the name of nvdiffrast.")
    package.__path__ = []
    package.__spec__ = ModuleSpec(_NAMES[0], None, is_package=True)
    package.__version__ = __version__  # type: ignore[attr-defined]
    package.torch = sys.modules[__package__ or ""]  # type: ignore[attr-defined]
    before = {name: sys.modules.get(name) for name in _NAMES}
    sys.modules.update(zip(_NAMES, (package, package.torch), strict=True))
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module
