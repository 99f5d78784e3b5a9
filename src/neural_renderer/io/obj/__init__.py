"""OBJ files with their materials: reading and writing."""

from .reader import load_obj, obj_surface_colors
from .writer import save_obj

__all__ = ["load_obj", "obj_surface_colors", "save_obj"]
