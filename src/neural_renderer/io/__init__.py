"""Files: meshes in and out (OBJ with materials by our own reader, others through trimesh), images, animations."""

from neural_renderer.io.formats import load_mesh, save_mesh
from neural_renderer.io.images import load_image, save_animation, save_image
from neural_renderer.io.obj import load_obj, save_obj

__all__ = ["load_image", "load_mesh", "load_obj", "save_animation", "save_image", "save_mesh", "save_obj"]
