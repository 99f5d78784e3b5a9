"""nvdiffrast's antialiasing, by this package's implementation of its paper (Laine et al., 2020)."""

from __future__ import annotations

import torch
from torch import Tensor

import neural_renderer.nvdiffrast as dr

from ..picture import Picture


class Antialias:
    """``rasterize``, ``interpolate`` and ``antialias``; edges belong to vertices that faces share."""

    name, most_shifts = "nvdiffrast AA (ours)", 10**6

    def image(self, picture: Picture) -> Tensor:
        """Draw without a gradient."""
        with torch.enable_grad():
            return self.draw(picture, torch.zeros(3, picture.size, picture.size))[0]

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        size, vertices, colors = picture.size, *(t.float().requires_grad_() for t in (picture.vertices, picture.colors))
        # From pixels, and depths up to 100, to a parallel projection's clip space.
        scale, shift = torch.tensor([2 / size, 2 / size, 0.01]), torch.tensor([-1.0, -1.0, 0.0])
        places = torch.nn.functional.pad(vertices * scale + shift, (0, 1), value=1.0)[None]
        faces = picture.faces.int()
        corners = torch.arange(3 * len(faces), dtype=torch.int32).view(-1, 3)
        rast, _ = dr.rasterize(dr.RasterizeCudaContext(), places, faces, (size, size))
        image, _ = dr.interpolate(colors.reshape(1, -1, 3), rast, corners)
        image = torch.where(rast[..., 3:] > 0, image, torch.tensor(picture.background, dtype=torch.float32))
        image = dr.antialias(image, rast, places, faces)[0].flip(0).permute(2, 0, 1)
        to_vertices, to_colors = torch.autograd.grad((image * pull.float()).sum(), (vertices, colors))
        return image.detach(), to_vertices, to_colors
