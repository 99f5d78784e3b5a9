"""The rasteriser: faces in screen space in, images out, with gradients. It knows nothing of cameras, files or tasks."""

from .rasterize import GRADIENTS, Images, rasterize_images, vertices_to_faces

__all__ = ["GRADIENTS", "Images", "rasterize_images", "vertices_to_faces"]
