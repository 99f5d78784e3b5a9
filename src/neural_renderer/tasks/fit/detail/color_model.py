"""`ColorModel`: the colours of a surface in photographs, from its albedo and perhaps a light."""

from __future__ import annotations

from typing import Any, Literal

import torch.nn.functional as F
from torch import Tensor

from ....deferred import Fragments
from ..fit_views import Views, photos_of
from .light_fit import LightFit

_INSIDE = 0.999  # mask of pixels that tell the light


class ColorModel:
    """Draws a surface with an albedo, a light that is the same in all photos, and the gains of the photos.

    Args:
        views: Views with photos.
        light: "fitted", or "none": colours are the albedo.

    Attributes:
        mean: [3], the mean colour of the object.

    Raises:
        ValueError: The views have no photos, or there is no such light.
    """

    def __init__(self, views: Views, light: Literal["fitted", "none"]) -> None:
        photos = photos_for(light, views)
        self.mean = photos.sum((0, 2, 3)) / views.masks.sum()
        self._light = LightFit(views.masks) if light == "fitted" else None

    def draw(self, views: Views, seen: Fragments, albedo: Tensor, normals: Tensor, learn: bool) -> Tensor:
        """Compute the colours of pixels.

        Args:
            views: N views.
            seen: Their fragments.
            albedo: [F, 3, 3], of the corners of faces.
            normals: [F, 3, 3] unit normals of the corners, outwards.
            learn: Whether the light learns from these views; their fragments have the size of the views then.

        Returns:
            [N, h, w, 3], of the size of the fragments.
        """
        if self._light is not None:
            if learn:
                self._light.add(*_pixels(views, seen, albedo.detach(), normals.detach()))
            albedo = albedo * self._light.on(normals)
        colors = seen.interpolate(albedo[None])
        return colors if views.gains is None else colors * views.gains[:, None, None]

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        return {} if self._light is None else self._light.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        if self._light is not None:
            self._light.load_state_dict(state)


def photos_for(light: str, views: Views) -> Tensor:
    """Return the photos of views; raise ValueError if there are none, or no such light."""
    if light not in ("fitted", "none"):
        raise ValueError(f'light: expected "fitted", "none" or None, got {light!r}')
    if views.photos is None:
        raise ValueError(f"light: expected None for views without photos, got {light!r}")
    return views.photos


def roughness(colors: Tensor, faces: Tensor) -> Tensor:
    """Average the absolute differences of colours [V, C], summed over the channels, along the edges of faces [F, 3]."""
    return (colors[faces] - colors[faces.roll(1, 1)]).abs().sum(2).mean()


def _pixels(views: Views, seen: Fragments, albedo: Tensor, normals: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Collect normals, albedo and colours [P, 3] of the pixels inside of masks, from those of corners [F, 3, 3]."""
    photos = photos_of(views) if views.gains is None else photos_of(views) / views.gains[:, :, None, None]
    inside = (seen.face_index >= 0) & (views.masks > _INSIDE)
    shown = seen.face_index[inside].long()
    colors = photos.movedim(1, 3)[inside]
    return F.normalize(normals.mean(1), dim=1)[shown], albedo.mean(1)[shown], colors
