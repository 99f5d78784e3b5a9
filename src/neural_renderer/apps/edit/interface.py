"""Mesh editing by gradient descent: style transfer and DeepDream."""

from .dream import PUBLISHED_DREAM, Dream, DreamWeights
from .edit import EditSettings, MeshEdit
from .options import DREAM_LAYER, STYLE_LAYERS
from .random_views import RandomViews
from .style import PUBLISHED_STYLE, Style, StyleWeights

__all__ = [
    "DREAM_LAYER",
    "PUBLISHED_DREAM",
    "PUBLISHED_STYLE",
    "STYLE_LAYERS",
    "Dream",
    "DreamWeights",
    "EditSettings",
    "MeshEdit",
    "RandomViews",
    "Style",
    "StyleWeights",
]
