"""`stand_in`: ``import pytorch3d`` where PyTorch3D is not installed."""

from __future__ import annotations

import contextlib
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from ....version import __version__

_PACKAGE = "pytorch3d"
# Modules of PyTorch3D, and the files beside this one whose names they have.
_MODULES = {
    "": (),
    "io": ("files",),
    "io.obj_io": ("files",),
    "io.ply_io": ("files",),
    "io.utils": ("files",),
    "loss": ("losses",),
    "ops": ("ops",),
    "renderer": ("cameras", "lighting", "rasterizer", "shaders", "textures"),
    "renderer.blending": ("shaders",),
    "renderer.cameras": ("cameras",),
    "renderer.lighting": ("lighting",),
    "renderer.materials": ("lighting",),
    "renderer.mesh": ("rasterizer", "shaders", "textures"),
    "renderer.mesh.rasterize_meshes": ("rasterizer",),
    "renderer.mesh.rasterizer": ("rasterizer",),
    "renderer.mesh.renderer": ("shaders",),
    "renderer.mesh.shader": ("shaders",),
    "renderer.mesh.shading": ("shaders",),
    "renderer.mesh.textures": ("textures",),
    "renderer.utils": ("properties",),
    "structures": ("meshes",),
    "structures.meshes": ("meshes",),
    "structures.utils": ("meshes",),
    "transforms": ("transforms",),
    "transforms.rotation_conversions": ("transforms",),
    "transforms.so3": ("transforms",),
    "transforms.transform3d": ("transforms",),
    "utils": ("ops", "cameras"),
    "utils.ico_sphere": ("ops",),
}
_PRIVATE = {"_open_file"}  # that programs import
_HELP = "neural-renderer run stands in for a part of PyTorch3D only; the guide for PyTorch3D lists it"


class _Module(ModuleType):
    """A module of PyTorch3D. Names that are not there can be imported; a call of one raises an error that names it."""

    def __init__(self, name: str) -> None:
        super().__init__(name, "This package under the name of PyTorch3D.")
        self.__path__: list[str] = []
        self.__version__ = __version__
        for file in _MODULES.get(name.partition(".")[2], ()):
            module = importlib.import_module(f"{__package__}.{file}")
            names = {key: value for key, value in vars(module).items() if not key.startswith("_") or key in _PRIVATE}
            vars(self).update(names)

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, _Module) and name in vars(self)):  # a function goes before a module of its name
            super().__setattr__(name, value)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        full_name = f"{self.__name__}.{name}"
        if full_name.partition(".")[2] in _MODULES:
            return importlib.import_module(full_name)
        setattr(self, name, _missing(full_name))
        return getattr(self, name)


class _Finder:
    """Import hook for PyTorch3D's modules."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        inside = name == _PACKAGE or name.startswith(f"{_PACKAGE}.")
        return ModuleSpec(name, _Finder, is_package=True) if inside else None  # type: ignore[arg-type]

    @staticmethod
    def create_module(spec: ModuleSpec) -> ModuleType:
        return _Module(spec.name)

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        """Do nothing: the module is complete."""


def _missing(name: str) -> type:
    """Make a class in place of what is not there."""

    def refuse(*_: Any, **__: Any) -> None:
        raise NotImplementedError(f"{name}: {_HELP}")

    return type(name.rpartition(".")[2], (), {"__init__": refuse, "__doc__": f"{name}, which is not there."})


@contextlib.contextmanager
def stand_in(always: bool = False) -> Iterator[None]:
    """Let ``import pytorch3d`` find this package inside the block, unless PyTorch3D is installed.

    Args:
        always: Whether to replace an installed PyTorch3D, too.

    Returns:
        Context manager.
    """
    if not always and (_PACKAGE in sys.modules or importlib.util.find_spec(_PACKAGE)):
        yield
        return
    before = {name: sys.modules.pop(name) for name in _loaded()}
    sys.meta_path.insert(0, _Finder)
    try:
        yield
    finally:
        sys.meta_path.remove(_Finder)
        for name in _loaded():
            del sys.modules[name]
        sys.modules.update(before)


def _loaded() -> list[str]:
    return [name for name in sys.modules if name.partition(".")[0] == _PACKAGE]
