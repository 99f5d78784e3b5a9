"""A textured mesh from images with known cameras, a texture for a known mesh, or the camera of one image."""

from .hull import carve, frame
from .load import load_views
from .shape import ShapeFit, Weights
from .texture import TextureFit
from .views import Views

__all__ = ["ShapeFit", "TextureFit", "Views", "Weights", "carve", "frame", "load_views"]
