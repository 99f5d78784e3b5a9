"""Modules under the names that they had before version 2.2, such as ``neural_renderer.tasks.fit``.

`KEPT` stay for good, as do the names of the first packages (`first_packages.old_modules`). `MOVED` are kept for one
release, with a warning that names the new module.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType
from typing import Any

_PACKAGE = __name__.partition(".")[0]

# Old name → new name, both relative to `neural_renderer`; submodules are found by their prefix.
KEPT = {
    "nvdiffrast": "compat.nvdiffrast",
    "losses": "optim.losses",
    "metrics": "optim.metrics",
    "rotations": "camera.rotations",
    "data": "apps.many.rendered_views",
}
MOVED = {
    "cli": "apps.command_line",
    "commands": "apps",
    "commands.info": "apps.info.command",
    "comparators": "apps.common.comparators",
    "comparators.opendr": "raster.visibility.opendr",
    "compat.cuda_on_cpu": "apps.run.cuda_on_cpu",
    "features": "apps.common.features",
    "many": "apps.many",
    "meshes.demo_models": "apps.demo.models",
    "rigs": "meshes.rigs",
    "tasks": "apps",
    "tasks.editing": "apps.edit",
    "tasks.masks": "apps.common.masks",
    "tasks.observer": "apps.common.observer",
    "tasks.photos": "apps.fit.photos",
    "tasks.reconstruction": "apps.reconstruct",
    "tasks.rig_fit": "apps.pose.rig_fit",
    "viewer": "apps.view",
}
_NEW_NAMES = KEPT | MOVED


def new_name(name: str) -> str | None:
    """Convert an old full module name to the new one; return None if the name is not old."""
    package, _, rest = name.partition(".")
    parts = rest.split(".")
    if package != _PACKAGE:
        return None
    for end in range(len(parts), 0, -1):
        moved = _NEW_NAMES.get(".".join(parts[:end]))
        if moved is not None:
            return ".".join((_PACKAGE, moved, *parts[end:]))
    return None


class _MovedModules:
    """Import hook and loader that returns the module of the new name."""

    @classmethod
    def find_spec(cls, name: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        new = new_name(name)
        if new is None:
            return None
        if name.split(".")[1] not in KEPT:
            warnings.warn(f"{name} is {new} since version 2.2", DeprecationWarning, stacklevel=2)
        return ModuleSpec(name, cls, origin=new)  # type: ignore[arg-type]

    @staticmethod
    def create_module(spec: ModuleSpec) -> ModuleType:
        module = import_module(str(spec.origin))
        spec.loader_state = module.__spec__
        return module

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        """Restore the specification, which the import system has replaced; the module has already run."""
        module.__spec__ = module.__spec__.loader_state if module.__spec__ else None

    @staticmethod
    def get_code(name: str) -> CodeType:
        """Return code for ``python -m`` that runs the module under its new name, for its relative imports."""
        return compile(f"import runpy; runpy.run_module({new_name(name)!r}, run_name='__main__')", name, "exec")


def register_moved_modules() -> None:
    """Make the old names importable. The hook is first; otherwise the folders of new packages would be searched."""
    sys.meta_path.insert(0, _MovedModules)
