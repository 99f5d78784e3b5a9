"""The path of `meshes.demo_models` in version 2.0."""

from ..meshes.demo_models import duck, knot

__all__ = ["duck", "knot"]
