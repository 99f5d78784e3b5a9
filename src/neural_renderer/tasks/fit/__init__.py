"""Fitting: a textured mesh from images with cameras, or the texture of a known mesh."""

from ..masks.rule import MaskRule
from ..settings import DetailWeights, FitWeights
from .agreement import check_agreement
from .detail.detail_fit import DetailFit
from .detail.maps import MapFormat
from .fit_views import Views
from .hull import carve, object_bounds
from .load import load_photo, load_views
from .mesh import MeshFit
from .result import FitResult
from .settings import CameraSettings, DescentSettings, DetailSettings, ShapeSettings, TextureSettings
from .shape import ShapeFit
from .texture import TextureFit

__all__ = [
    "CameraSettings",
    "DescentSettings",
    "DetailFit",
    "DetailSettings",
    "DetailWeights",
    "FitResult",
    "FitWeights",
    "MapFormat",
    "MaskRule",
    "MeshFit",
    "ShapeFit",
    "ShapeSettings",
    "TextureFit",
    "TextureSettings",
    "Views",
    "carve",
    "check_agreement",
    "load_photo",
    "load_views",
    "object_bounds",
]
