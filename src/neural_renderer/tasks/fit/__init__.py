"""Fitting: a textured mesh from images with cameras, the texture of a known mesh, or the camera of one image."""

from ...deprecated import old_names
from ..settings import DetailWeights, FitWeights
from .agreement import check_agreement
from .detail.detail_fit import DetailFit
from .fit_views import Views
from .hull import carve, object_bounds
from .load import load_photo, load_views
from .mesh import MeshFit
from .pose import CameraFit
from .result import FitResult
from .shape import ShapeFit
from .texture import TextureFit

__all__ = [
    "CameraFit",
    "DetailFit",
    "DetailWeights",
    "FitResult",
    "FitWeights",
    "MeshFit",
    "ShapeFit",
    "TextureFit",
    "Views",
    "carve",
    "check_agreement",
    "load_photo",
    "load_views",
    "object_bounds",
]

__getattr__ = old_names(__name__, Weights="FitWeights", frame="object_bounds")
