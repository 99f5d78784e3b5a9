"""Fitting: a textured mesh from images, or the texture of a known mesh. `interface` has the public names.

Built on `pose` for --recover camera, and on `view` for --view.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .interface import *
else:
    from ..common.lazy import names_of

    __getattr__, __dir__ = names_of(__name__, CameraFit="pose.camera_fit")
