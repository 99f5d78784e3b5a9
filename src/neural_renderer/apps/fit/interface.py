"""Fitting: a textured mesh from images with cameras, or the texture of a known mesh."""

from ..common.masks.rule import MaskRule
from ..common.views.load import load_photo, load_views
from ..common.views.maps import MapFormat
from ..common.views.views import Views
from .agreement import check_agreement
from .colors.texture import TextureFit
from .detail.detail_fit import DetailFit
from .hull import carve, object_bounds
from .mesh import MeshFit
from .result import FitResult
from .settings import CameraSettings, DescentSettings, DetailSettings, ShapeSettings, TextureSettings
from .shape import ShapeFit
from .weights import DetailWeights, FitWeights

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
