"""The colours of a surface in photographs: `ColorModel`, its albedo and perhaps a light, which `LightFit` fits."""

from __future__ import annotations

from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from ....raster.fragments import Fragments
from ....shading.spherical_harmonics import harmonics
from ...common.views.views import WHOLE, Views, photos_of

_DECAY = 0.95  # decay rate of the sums over earlier steps
_MOST_PIXELS = 60_000  # most pixels of a step
_EXACT = 0.02  # residual below which weights do not grow
_RIDGE = 1e-3  # weight of the prior that light is uniform, relative to the pixels


class LightFit:
    """Diffuse light of order 2, the same for all photos: nine factors of the spherical harmonics for each channel.

    The colour of a pixel is albedo · Σ c_k Y_k(normal), which is linear in c. Every step adds its pixels to the normal
    equations, in which earlier steps fade away. Weights are those of the sum of absolute residuals, so that highlights
    and cast shadows count little. ``factors`` [9, 3] are c: the coefficients of a `SphericalHarmonicLight`, times the
    factor of their band.
    """

    def __init__(self, like: Tensor) -> None:
        self.factors = like.new_zeros(9, 3)
        self.factors[0] = 1 / float(harmonics(like.new_zeros(3))[0])
        self._left, self._right = like.new_zeros(3, 9, 9), like.new_zeros(3, 9)

    def on(self, normals: Tensor) -> Tensor:
        """Compute the light on surfaces with unit normals [..., 3], which are on the lit side: RGB [..., 3]."""
        return torch.stack(harmonics(normals), -1) @ self.factors

    @torch.no_grad()
    def add(self, normals: Tensor, albedo: Tensor, colors: Tensor) -> None:
        """Add pixels, [P, 3] each, with unit normals and the colours of the photos, and solve for the light."""
        some = slice(None, None, 1 + len(normals) // _MOST_PIXELS)
        normals, albedo, colors = normals[some], albedo[some], colors[some]
        bands = torch.stack(harmonics(normals), 1)
        weights = 1 / (albedo * (bands @ self.factors) - colors).abs().clamp(min=_EXACT)
        rows = albedo.t()[:, :, None] * bands  # [3, P, 9]
        weighted = rows * weights.t()[:, :, None]
        self._left = _DECAY * self._left + weighted.mT @ rows
        self._right = _DECAY * self._right + (weighted.mT @ colors.t()[:, :, None])[..., 0]
        ridge = torch.ones_like(bands[0])
        ridge[0] = 0.0
        size = self._left[:, 0, 0].clamp(min=1e-9)[:, None, None]
        left = self._left + size * (_RIDGE * torch.diag(ridge) + 1e-6 * torch.eye(9).to(size))
        self.factors = torch.linalg.solve(left.double(), self._right.double()).t().to(normals)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        return {"factors": self.factors, "left": self._left, "right": self._right}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        self.factors, self._left, self._right = state["factors"], state["left"], state["right"]


class ColorModel:
    """Draws a surface with an albedo, a light that is the same in all photos, and the gains of the photos.

    With the light "none", colours are the albedo. ``mean`` is the mean colour of the object, [3]. ValueError: the views
    have no photos, or there is no such light.
    """

    def __init__(self, views: Views, light: Literal["fitted", "none"]) -> None:
        photos = photos_for(light, views)
        self.mean = photos.sum((0, 2, 3)) / views.masks.sum()
        self._light = LightFit(views.masks) if light == "fitted" else None

    def draw(self, views: Views, fragments: Fragments, albedo: Tensor, normals: Tensor, learn: bool) -> Tensor:
        """Compute the colours of pixels, [N, h, w, 3], of the size of the fragments of N views.

        Albedo and unit normals, outwards, are those of the corners of faces, [F, 3, 3]. If the light is to ``learn``
        from these views, their fragments have the size of the views.
        """
        if self._light is not None:
            if learn:
                self._light.add(*_pixels(views, fragments, albedo.detach(), normals.detach()))
            albedo = albedo * self._light.on(normals)
        colors = fragments.interpolate(albedo[None])
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


def roughness(colors: Tensor) -> Tensor:
    """Average the absolute differences of colours of corners [F, 3, C], summed over the channels, along edges."""
    return (colors - colors.roll(1, 1)).abs().sum(2).mean()


def _pixels(views: Views, fragments: Fragments, albedo: Tensor, normals: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Collect normals, albedo and colours [P, 3] of the pixels inside the masks; corners have [F, 3, 3]."""
    photos = photos_of(views) if views.gains is None else photos_of(views) / views.gains[:, :, None, None]
    inside = (fragments.face_index >= 0) & (views.masks > WHOLE)
    shown = fragments.face_index[inside].long()
    colors = photos.movedim(1, 3)[inside]
    return F.normalize(normals.mean(1), dim=1)[shown], albedo.mean(1)[shown], colors
