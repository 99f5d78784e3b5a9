"""Modules of the first packages, for ``from neural_renderer.projection import projection``.

They exist in `sys.modules` only. Importing a file of such a name would replace the function of the same name.
Their members are loaded at first use.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_PACKAGE = __name__.partition(".")[0]

# Each old module, its members, and the modules of this package that define them.
OLD_MODULES: dict[str, dict[str, tuple[str, ...]]] = {
    "cross": {"compat.first_packages.old_functions": ("cross",)},
    "get_points_from_angles": {"interface": ("get_points_from_angles",)},
    "lighting": {"interface": ("lighting",)},
    "load_obj": {"interface": ("load_obj",), "compat.first_packages.old_functions": ("load_mtl", "load_textures")},
    "look": {"interface": ("look",)},
    "look_at": {"interface": ("look_at",)},
    "mesh": {"interface": ("Mesh",)},
    "optimizers": {"interface": ("Adam",)},
    "perspective": {"interface": ("perspective",)},
    "projection": {"interface": ("projection",)},
    "rasterize": {
        "interface": ("rasterize", "rasterize_rgbad", "rasterize_silhouettes", "rasterize_depth", "Rasterize"),
        "compat.first_packages.old_functions": ("RasterizeFunction",),
        "compat.first_packages.rasterize": (
            *("DEFAULT_IMAGE_SIZE", "DEFAULT_ANTI_ALIASING", "DEFAULT_NEAR", "DEFAULT_FAR", "DEFAULT_EPS"),
            "DEFAULT_BACKGROUND_COLOR",
        ),
    },
    "renderer": {"interface": ("Renderer",)},
    "save_obj": {"interface": ("save_obj",), "compat.first_packages.old_functions": ("create_texture_image",)},
    "vertices_to_faces": {"interface": ("vertices_to_faces",)},
}


class _OldModule(ModuleType):
    """Module that loads its members at first use."""

    def __init__(self, name: str) -> None:
        super().__init__(f"{_PACKAGE}.{name}", f"`{name}` under its name in the first packages.")
        self.__spec__ = ModuleSpec(self.__name__, None)
        self._homes = {member: home for home, members in OLD_MODULES[name].items() for member in members}
        self.__all__ = list(self._homes)

    def __getattr__(self, name: str) -> Any:
        home = self.__dict__["_homes"].get(name) if "_homes" in self.__dict__ else None
        if home is None:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        value = getattr(import_module(f"{_PACKAGE}.{home}"), name)
        setattr(self, name, value)
        return value

    def __dir__(self) -> list[str]:
        return [*self.__dict__, *self._homes]


class _NoExtensions:
    """Import hook that raises ImportError, with advice, for the compiled extensions of the first packages."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> None:
        if f"{name}.".startswith(f"{_PACKAGE}.cuda."):
            raise ImportError(
                f"{name}: this package has no compiled extensions; use {_PACKAGE}.rasterize_rgbad, "
                "load_obj(..., load_texture=True) or save_obj, which run on every device",
                name=name,
            )


def register_old_modules() -> None:
    """Make the old modules importable."""
    for name in OLD_MODULES:
        sys.modules[f"{_PACKAGE}.{name}"] = _OldModule(name)
    sys.meta_path.append(_NoExtensions)
