"""This package's estimators, and the truth: an exact image drawn at a multiple of the size."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

import neural_renderer as nr

from ..picture import Picture


class Ours:
    """``rasterize_images`` with an estimator."""

    def __init__(self, gradient: str) -> None:
        self.name, self.gradient, self.most_shifts = gradient, gradient, 10**6

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        vertices, colors = (t.float().requires_grad_() for t in (picture.vertices, picture.colors))
        image = draw(replace(picture, vertices=vertices, colors=colors), self.gradient)
        to_vertices, to_colors = torch.autograd.grad((image * pull.float()).sum(), (vertices, colors))
        return image.detach(), to_vertices, to_colors


class Reinforce:
    """``reinforce``: 64 samples with a spread of half a pixel. It has no gradient to colours."""

    name, most_shifts, samples, spread = "reinforce", 64, 64, 0.5

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        places = picture.vertices[:, :2].float().requires_grad_()

        def loss(moved: Tensor) -> Tensor:  # a few images at a time
            parts = []
            for some in moved.split(8):
                depth = picture.vertices[:, 2:].float().expand(len(some), -1, -1)
                parts.append((draw(picture, "edge", torch.cat((some, depth), 2)) * pull.float()).sum((1, 2, 3)))
            return torch.cat(parts)

        value = nr.reinforce(loss, places, samples=self.samples, spread=self.spread)
        (found,) = torch.autograd.grad(value, places)
        image = draw(picture, "edge")
        return image, torch.nn.functional.pad(found, (0, 1)), torch.zeros_like(picture.colors)


def draw(picture: Picture, gradient: str, vertices: Tensor | None = None) -> Tensor:
    """Draw a picture, [3, size, size] float32; with several sets of vertices, [B, V, 3], an image of each."""
    several = picture.vertices[None] if vertices is None else vertices
    half = picture.size / 2
    screen = torch.cat((several[..., :2] / half - 1, several[..., 2:]), -1).float()
    # Cubes of two texels along each axis, whose blend is linear in the weights of the corners.
    corner = torch.cartesian_prod(*[torch.arange(2.0)] * 3)  # [8, 3]
    cubes = torch.einsum("nk,fkc->fnc", corner.to(picture.colors.dtype), picture.colors).float()
    cubes = cubes.view(1, -1, 2, 2, 2, 3)
    image = nr.rasterize_images(
        nr.vertices_to_faces(screen, picture.faces),
        picture.size,
        outputs=("rgb",),
        textures=cubes,
        background=picture.background,
        anti_aliasing=False,
        two_sided=True,
        perspective=False,
        eps=1e-4,
        gradient=gradient,
        triangles=picture.faces,
    ).rgb
    return image[0] if vertices is None else image


def mean_loss(picture: Picture, weight: Tensor, supersampling: int) -> float:
    """Compute the mean of Σ weight · image over shifts by up to half a pixel, for an image averaged over its pixels.

    Both averages are boxes; together they are a tent, as in bilinear interpolation of the weights. The image is drawn
    at a multiple of the size, with a margin of a pixel, since a tent is two pixels wide.
    """
    with torch.no_grad():
        scale = torch.tensor([supersampling, supersampling, 1.0], dtype=torch.float64)
        wide = picture.moved(torch.ones(2))
        large = draw(replace(wide, vertices=wide.vertices * scale, size=(picture.size + 2) * supersampling), "edge")
        padded = torch.nn.functional.pad(weight, (1, 1, 1, 1))[None]
        smooth = torch.nn.functional.interpolate(padded, large.shape[1:], mode="bilinear", align_corners=False)[0]
        return float((large.double() * smooth).sum()) / supersampling**2
