"""Reading and writing of meshes and images."""

from .formats import load_mesh
from .images import load_image, save_image
from .mesh_writer import save_mesh
from .obj import load_obj, save_obj

__all__ = ["load_image", "load_mesh", "load_obj", "save_image", "save_mesh", "save_obj"]
