"""A differentiable mesh renderer for PyTorch, on the CPU and on CUDA (Kato, Ushiku and Harada, CVPR 2018).

New code: `Mesh`, `Camera`, `Light`, `render`, `fragments`, `losses`. Code written for the first packages: `Renderer`
and the rest.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from .version import __version__ as __version__

if TYPE_CHECKING:
    from .interface import *
else:

    def __getattr__(name: str) -> Any:
        """Modules and public names, when they are first used: `neural-renderer --help` answers without torch."""
        if not name.startswith("_") and find_spec(f"{__name__}.{name}"):
            return import_module(f"{__name__}.{name}")
        if not name.startswith("_") or name == "__all__":
            public = vars(import_module(f"{__name__}.interface"))
            globals().update({key: public[key] for key in public if key == "__all__" or not key.startswith("_")})
        if name not in globals():
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return globals()[name]

    def __dir__() -> list[str]:
        return [*globals(), *__getattr__("__all__")]
