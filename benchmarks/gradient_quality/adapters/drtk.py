"""DRTK: from source; its operators for the CPU need no CUDA. Edges move with the colours of two neighbouring pixels."""

from __future__ import annotations

import torch
from drtk import edge_grad_estimator, interpolate, rasterize, render
from torch import Tensor

from ..picture import Picture


class Drtk:
    """``rasterize``, ``render``, ``interpolate`` and ``edge_grad_estimator``."""

    name, most_shifts = "DRTK", 10**6

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        size, vertices, colors = picture.size, *(t.float().requires_grad_() for t in (picture.vertices, picture.colors))
        # y down, pixel centres at the integers; 1 / z is linear on the screen, as depth is.
        far = 1 / (1.2 - 0.1 * vertices[:, 2])
        places = torch.stack((vertices[:, 0] - 0.5, size - 0.5 - vertices[:, 1], far), 1)[None].contiguous()
        faces = picture.faces.int()
        corners = torch.arange(3 * len(faces), dtype=torch.int32).view(-1, 3)
        with torch.no_grad():
            index = rasterize(places, faces, size, size)
        _, weights = render(places, faces, index)
        image = interpolate(colors.reshape(1, -1, 3), corners, index, weights)
        image = torch.where(index[:, None] >= 0, image, torch.tensor(picture.background)[:, None, None])
        image = edge_grad_estimator(places, faces, weights, image, index)[0]
        to_vertices, to_colors = torch.autograd.grad((image * pull.float()).sum(), (vertices, colors))
        return image.detach(), to_vertices, to_colors


def adapters() -> list[Drtk]:
    """Make the adapter."""
    return [Drtk()]
