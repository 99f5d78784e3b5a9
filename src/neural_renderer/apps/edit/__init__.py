"""Mesh editing by gradient descent: style transfer and DeepDream. `interface` has the public names.

Built on `view` for --view.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .interface import *
else:
    from ..common.lazy import names_of

    __getattr__, __dir__ = names_of(__name__)
