"""PyTorch3D: from source. Its hard image, or SoftRas's: faces blended by their distance and depth."""

from __future__ import annotations

import math

import torch
from pytorch3d.renderer.blending import BlendParams, softmax_rgb_blend
from pytorch3d.renderer.mesh.rasterize_meshes import rasterize_meshes
from pytorch3d.renderer.mesh.rasterizer import Fragments
from pytorch3d.structures import Meshes
from torch import Tensor

from ..picture import Picture


class PyTorch3D:
    """``rasterize_meshes``, with one face of each pixel, or 50 and ``softmax_rgb_blend`` with σ = γ = 10⁻⁴.

    The blend's colours fill every pixel within reach of a face; its alpha is the soft silhouette, and mixes them with
    the background.
    """

    most_shifts = 10**6

    def __init__(self, soft: bool) -> None:
        self.name, self.soft = "PyTorch3D soft" if soft else "PyTorch3D hard", soft

    def image(self, picture: Picture) -> Tensor:
        """Draw without a gradient."""
        return self._draw(picture, picture.vertices.float(), picture.colors.float())

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        vertices, colors = (t.float().requires_grad_() for t in (picture.vertices, picture.colors))
        image = self._draw(picture, vertices, colors)
        to_vertices, to_colors = torch.autograd.grad((image * pull.float()).sum(), (vertices, colors))
        return image.detach(), to_vertices, to_colors

    def _draw(self, picture: Picture, vertices: Tensor, colors: Tensor) -> Tensor:
        half = picture.size / 2
        mirror = vertices.new_tensor([-1.0, 1.0])  # x to the left
        screen = torch.cat(((vertices[:, :2] / half - 1) * mirror, vertices[:, 2:]), 1)
        blend = BlendParams(1e-4, 1e-4, picture.background)
        seen = Fragments(*rasterize_meshes(
            Meshes([screen], [picture.faces]), picture.size,
            blur_radius=math.log(1 / 1e-4 - 1) * blend.sigma if self.soft else 0.0,
            faces_per_pixel=50 if self.soft else 1, perspective_correct=False, clip_barycentric_coords=self.soft,
        ))  # fmt: skip
        background = colors.new_tensor(picture.background)
        own = (colors[seen.pix_to_face.clamp(min=0)] * seen.bary_coords[..., None]).sum(-2)  # [1, H, W, K, 3]
        if self.soft:
            rgb, alpha = softmax_rgb_blend(own, seen, blend, znear=1.0, zfar=10.0)[0].split((3, 1), -1)
            return (alpha * rgb + (1 - alpha) * background).permute(2, 0, 1)
        outside = seen.pix_to_face[0, ..., 0] < 0
        return torch.where(outside[..., None], background, own[0, ..., 0, :]).permute(2, 0, 1)


def adapters() -> list[PyTorch3D]:
    """Make the adapters."""
    return [PyTorch3D(soft=False), PyTorch3D(soft=True)]
