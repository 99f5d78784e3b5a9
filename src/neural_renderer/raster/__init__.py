"""The rasteriser: faces in screen space in, images out, with gradients. It knows nothing of cameras, files or tasks."""

from .faces import vertices_to_faces
from .outputs import Images
from .rasterize import rasterize_images

__all__ = ["Images", "rasterize_images", "vertices_to_faces"]
