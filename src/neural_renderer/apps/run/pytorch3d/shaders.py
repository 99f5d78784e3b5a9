"""Shaders: from fragments to images [N, H, W, 4]; `MeshRenderer`."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from .lighting import Materials, PointLights, lit
from .meshes import Meshes
from .ops import interpolate_face_attributes
from .rasterizer import Fragments
from .textures import TexturesVertex


class BlendParams(NamedTuple):
    """Widths of the blur at outlines, ``sigma``, and in depth, ``gamma``; colour of the background."""

    sigma: float = 1e-4
    gamma: float = 1e-4
    background_color: Any = (1.0, 1.0, 1.0)


def hard_rgb_blend(colors: Tensor, fragments: Fragments, blend_params: BlendParams) -> Tensor:
    """Show the nearest face; the last channel is 1 on faces."""
    seen = fragments.pix_to_face[..., :1] >= 0
    background = torch.as_tensor(blend_params.background_color, dtype=colors.dtype, device=colors.device)
    return torch.cat((torch.where(seen, colors[..., 0, :], background), seen.to(colors.dtype)), -1)


def sigmoid_alpha_blend(colors: Tensor, fragments: Fragments, blend_params: BlendParams) -> Tensor:
    """Compute SoftRas' silhouettes, 1 − Π (1 − sigmoid(−dists / sigma)) over the faces of a pixel."""
    alpha = 1 - _misses(fragments, blend_params.sigma).prod(-1, keepdim=True)
    return torch.cat((colors[..., 0, :3], alpha), -1)


def softmax_rgb_blend(
    colors: Tensor, fragments: Fragments, blend_params: BlendParams, znear: Any = 1.0, zfar: Any = 100
) -> Tensor:
    """Blend faces by their coverage and nearness, as SoftRas (Liu et al., 2019)."""
    near, far = (value.view(-1, 1, 1, 1) if isinstance(value, Tensor) else value for value in (znear, zfar))
    misses, least = _misses(fragments, blend_params.sigma), 1e-10
    nearness = (far - fragments.zbuf) / (far - near) * (fragments.pix_to_face >= 0)
    most = nearness.amax(-1, keepdim=True).clamp(min=least)
    weights = (1 - misses) * ((nearness - most) / blend_params.gamma).exp()
    behind = ((least - most) / blend_params.gamma).exp().clamp(min=least)
    background = torch.as_tensor(blend_params.background_color, dtype=colors.dtype, device=colors.device)
    total = (weights[..., None] * colors).sum(-2) + behind * background
    return torch.cat((total / (weights.sum(-1, keepdim=True) + behind), 1 - misses.prod(-1, keepdim=True)), -1)


def _misses(fragments: Fragments, sigma: float) -> Tensor:
    """Compute the probability that each face does not cover its pixel."""
    return 1 - torch.sigmoid(-fragments.dists / sigma) * (fragments.pix_to_face >= 0)


def phong_shading(
    meshes: Meshes, fragments: Fragments, lights: Any, cameras: Any, materials: Materials, texels: Tensor
) -> Tensor:
    """Light each pixel."""
    faces, pixels = meshes.faces_packed(), (fragments.pix_to_face, fragments.bary_coords)
    points = interpolate_face_attributes(*pixels, meshes.verts_packed()[faces])
    normals = interpolate_face_attributes(*pixels, meshes.verts_normals_packed()[faces])
    factors, shine = lit(points, normals, lights, cameras, materials)
    return factors * texels + shine


def flat_shading(
    meshes: Meshes, fragments: Fragments, lights: Any, cameras: Any, materials: Materials, texels: Tensor
) -> Tensor:
    """Light each face at its centre."""
    faces, seen = fragments.pix_to_face.clamp(min=0), fragments.pix_to_face[..., None] >= 0
    centers, normals = meshes.verts_packed()[meshes.faces_packed()].mean(1), meshes.faces_normals_packed()
    points, normals = (torch.where(seen, each[faces], 0.0) for each in (centers, normals))
    factors, shine = lit(points, normals, lights, cameras, materials)
    return factors * texels + shine


def gouraud_shading(
    meshes: Meshes, fragments: Fragments, lights: Any, cameras: Any, materials: Materials
) -> Tensor:  # fmt: skip
    """Light each vertex; textures are colours of vertices."""
    if not isinstance(meshes.textures, TexturesVertex):
        raise ValueError("meshes: expected TexturesVertex for the shading of Gouraud")
    points, normals = meshes.verts_padded(), meshes.verts_normals_padded()
    factors, shine = lit(points, normals, lights, cameras, materials)
    colors = factors * meshes.textures.verts_features_padded() + shine
    packed = torch.cat([each[:count] for each, count in zip(colors, meshes.num_verts_per_mesh(), strict=True)])
    corners = packed[meshes.faces_packed()]
    return interpolate_face_attributes(fragments.pix_to_face, fragments.bary_coords, corners)


class ShaderBase(nn.Module):
    """Common part of shaders: cameras, lights, materials and blending, each also as a keyword of calls."""

    soft = False

    def __init__(
        self, device: Any = "cpu", cameras: Any = None, lights: Any = None, materials: Any = None,
        blend_params: BlendParams | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        self.lights = PointLights(device=device) if lights is None else lights
        self.materials = Materials(device=device) if materials is None else materials
        self.cameras = cameras
        self.blend_params = BlendParams() if blend_params is None else blend_params

    def to(self, device: Any) -> Any:  # type: ignore[override]
        self.cameras = None if self.cameras is None else self.cameras.to(device)
        self.lights, self.materials = self.lights.to(device), self.materials.to(device)
        return self

    def forward(self, fragments: Fragments, meshes: Meshes, **kwargs: Any) -> Tensor:
        cameras = kwargs.get("cameras", self.cameras)
        if cameras is None:
            raise ValueError("cameras: expected those of the shader or of this call, got none")
        scene = {"lights": kwargs.get("lights", self.lights), "materials": kwargs.get("materials", self.materials)}
        colors = self.colors(meshes, fragments, cameras=cameras, **scene)
        blend = kwargs.get("blend_params", self.blend_params)
        if not self.soft:
            return hard_rgb_blend(colors, fragments, blend)
        near = kwargs.get("znear", getattr(cameras, "znear", 1.0))
        return softmax_rgb_blend(colors, fragments, blend, near, kwargs.get("zfar", getattr(cameras, "zfar", 100.0)))

    def colors(self, meshes: Meshes, fragments: Fragments, **scene: Any) -> Tensor:
        """Compute the colours of all fragments, [N, H, W, K, 3]."""
        return phong_shading(meshes, fragments, texels=meshes.sample_textures(fragments), **scene)


class HardPhongShader(ShaderBase):
    """Light in each pixel, nearest faces."""


class SoftPhongShader(ShaderBase):
    """Light in each pixel, blended faces."""

    soft = True


class HardGouraudShader(ShaderBase):
    """Light at vertices, nearest faces."""

    def colors(self, meshes: Meshes, fragments: Fragments, **scene: Any) -> Tensor:
        return gouraud_shading(meshes, fragments, **scene)


class SoftGouraudShader(HardGouraudShader):
    """Light at vertices, blended faces."""

    soft = True


class HardFlatShader(ShaderBase):
    """Light on faces, nearest faces."""

    def colors(self, meshes: Meshes, fragments: Fragments, **scene: Any) -> Tensor:
        return flat_shading(meshes, fragments, texels=meshes.sample_textures(fragments), **scene)


class SoftSilhouetteShader(nn.Module):
    """Silhouettes in the last channel, 1 in the others."""

    def __init__(self, blend_params: BlendParams | None = None) -> None:
        super().__init__()
        self.blend_params = BlendParams() if blend_params is None else blend_params

    def forward(self, fragments: Fragments, meshes: Meshes, **kwargs: Any) -> Tensor:
        blend = kwargs.get("blend_params", self.blend_params)
        return sigmoid_alpha_blend(torch.ones_like(fragments.bary_coords), fragments, blend)


class MeshRendererWithFragments(nn.Module):
    """A rasteriser and a shader; returns images and fragments."""

    def __init__(self, rasterizer: Any, shader: Any) -> None:
        super().__init__()
        self.rasterizer, self.shader = rasterizer, shader

    def to(self, device: Any) -> Any:  # type: ignore[override]
        self.rasterizer.to(device)
        self.shader.to(device)
        return self

    def forward(self, meshes_world: Meshes, **kwargs: Any) -> Any:
        fragments = self.rasterizer(meshes_world, **kwargs)
        return self.shader(fragments, meshes_world, **kwargs), fragments


class MeshRenderer(MeshRendererWithFragments):
    """A rasteriser and a shader; returns images."""

    def forward(self, meshes_world: Meshes, **kwargs: Any) -> Tensor:
        return super().forward(meshes_world, **kwargs)[0]


TexturedSoftPhongShader = SoftPhongShader
