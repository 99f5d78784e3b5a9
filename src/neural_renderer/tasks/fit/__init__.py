"""A textured mesh from images with known cameras, a texture for a known mesh, or the camera of one image."""

from .fit_views import Views
from .hull import carve, frame
from .load import load_photo, load_views
from .mesh import MeshFit
from .pose import CameraFit
from .shape import ShapeFit, Weights
from .texture import TextureFit

__all__ = [
    "CameraFit",
    "MeshFit",
    "ShapeFit",
    "TextureFit",
    "Views",
    "Weights",
    "carve",
    "frame",
    "load_photo",
    "load_views",
]
