"""Command `finish`: a light mesh with charts and images that looks like a heavy one. `interface` has the public names.

Built on `compare`, which measures how different both look, and on `view` for --view.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .interface import *
else:
    from ..common.lazy import names_of

    __getattr__, __dir__ = names_of(__name__)
