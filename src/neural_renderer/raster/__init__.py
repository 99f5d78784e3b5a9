"""The rasteriser: faces in screen space in, images out, with gradients. It knows nothing of cameras, files or tasks."""

from .rasterize import Images, rasterize_images, vertices_to_faces
from .settings import GRADIENTS

__all__ = ["GRADIENTS", "Images", "rasterize_images", "vertices_to_faces"]
