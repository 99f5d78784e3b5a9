"""`generators_stand_in`: imports of modules that generators of meshes build with CUDA find this package."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

MODULES = {
    "cumesh": "cumesh",
    "flex_gemm": None,
    "flex_gemm.ops": None,
    "flex_gemm.ops.grid_sample": "grid_sample",
    "o_voxel._C": "o_voxel_kernels",
}
"""Names of modules, and the modules beside this one that take their places; None for packages without content."""


class _Loader(Loader):
    """Fills a module with the public names of one of this package, at the first import."""

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        file = MODULES[module.__name__]
        if file is not None:
            content: Any = import_module(f".{file}", __package__)
            names = vars(content)
            module.__dict__.update({name: names[name] for name in content.__all__})
            module.__getattr__ = names["__getattr__"]  # type: ignore[method-assign]  # says what is missing
        module.__doc__ = f"This package under the name of {module.__name__}."


class _Finder(MetaPathFinder):
    """Finds the modules of `MODULES`."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname not in MODULES:
            return None
        return ModuleSpec(fullname, _Loader(), is_package=MODULES[fullname] is None)


@contextlib.contextmanager
def generators_stand_in(always: bool = False) -> Iterator[None]:
    """Let imports of the modules in `MODULES` find this package inside the block, unless they are installed.

    ``always``: Replace installed ones, too.
    """
    finder = _Finder()
    sys.meta_path.insert(0 if always else len(sys.meta_path), finder)
    before = {name: sys.modules.pop(name) for name in MODULES if always and name in sys.modules}
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in MODULES:
            if isinstance(getattr(getattr(sys.modules.get(name), "__spec__", None), "loader", None), _Loader):
                del sys.modules[name]
        sys.modules.update(before)
