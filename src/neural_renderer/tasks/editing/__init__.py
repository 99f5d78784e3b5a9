"""A mesh edited by gradients: the style of a painting, or what a network dreams of it."""

from ..settings import DREAM_LAYER, STYLE_LAYERS
from .dream import PUBLISHED_DREAM, Dream, DreamWeights
from .edit import MeshEdit
from .random_views import Views
from .style import PUBLISHED_STYLE, Style, StyleWeights

__all__ = [
    "DREAM_LAYER",
    "PUBLISHED_DREAM",
    "PUBLISHED_STYLE",
    "STYLE_LAYERS",
    "Dream",
    "DreamWeights",
    "MeshEdit",
    "Style",
    "StyleWeights",
    "Views",
]
