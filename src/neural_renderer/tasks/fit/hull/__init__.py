"""Visual hull of silhouettes: the initial shape of a fit, with the right holes and handles."""

from .space_carving import carve, object_bounds, view_center

__all__ = ["carve", "object_bounds", "view_center"]
