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
    return torch.cat((colors[..., 0, :3], _Seen.of(fragments).alpha(fragments, blend_params.sigma)), -1)


def softmax_rgb_blend(
    colors: Tensor, fragments: Fragments, blend_params: BlendParams, znear: Any = 1.0, zfar: Any = 100
) -> Tensor:
    """Blend faces by their coverage and nearness, as SoftRas (Liu et al., 2019)."""
    seen = _Seen.of(fragments)
    return seen.blended(_at(seen.place, colors), fragments, blend_params, znear, zfar)


class _Seen(NamedTuple):
    """Fragments that show a face. Most of the K layers are empty at most pixels, and empty fragments are left out.

    M is the largest number of such fragments in an image; other images are padded with empty ones.
    """

    place: Tensor  # [N, M], in the H · W · K fragments of an image
    faces: Tensor  # [N, 1, M, 1], -1 where there is none
    size: torch.Size  # N, H, W, K

    @staticmethod
    def of(fragments: Fragments) -> _Seen:
        shown = fragments.pix_to_face.flatten(1) >= 0
        image, place = shown.nonzero(as_tuple=True)
        number = shown.sum(1)
        rank = torch.arange(len(image), device=image.device) - (number.cumsum(0) - number)[image]
        places = place.new_zeros(len(shown), int(number.max())).index_put((image, rank), place)
        empty = torch.arange(places.shape[1], device=image.device) >= number[:, None]
        faces = _at(places, fragments.pix_to_face).masked_fill(empty[:, None, :, None], -1)
        return _Seen(places, faces, fragments.pix_to_face.shape)

    def among(self, fragments: Fragments) -> Fragments:
        """Return these fragments as those of images of 1 × M pixels with one face each."""
        values = (fragments.zbuf, fragments.bary_coords, fragments.dists)
        return Fragments(self.faces, *(_at(self.place, each) for each in values))

    def alpha(self, fragments: Fragments, sigma: float) -> Tensor:
        """Compute the probability that any face covers each pixel, [N, H, W, 1]."""
        misses = torch.nn.functional.softplus(-_at(self.place, fragments.dists) / sigma)  # -log(1 - coverage)
        return -torch.expm1(-self._summed(torch.where(self.faces < 0, 0.0, misses)[..., None]))

    def blended(self, colors: Tensor, fragments: Fragments, blend: BlendParams, znear: Any, zfar: Any) -> Tensor:
        """Blend colours [N, 1, M, 1, 3] of these fragments to images [N, H, W, 4]."""
        near, far = (each.view(-1, 1, 1, 1) if isinstance(each, Tensor) else each for each in (znear, zfar))
        shown, least = self.faces >= 0, 1e-10
        nearness = (far - _at(self.place, fragments.zbuf)) / (far - near) * shown
        pixel, most = self._pixel(), colors.new_full((len(shown), self.size[1] * self.size[2]), least)
        most = most.scatter_reduce(1, pixel, nearness[:, 0, :, 0], "amax")
        cover = torch.sigmoid(-_at(self.place, fragments.dists) / blend.sigma) * shown
        weights = (cover * ((nearness - most.gather(1, pixel)[:, None, :, None]) / blend.gamma).exp())[..., None]
        behind = ((least - most) / blend.gamma).exp().clamp(min=least).view(*self.size[:3], 1)
        background = torch.as_tensor(blend.background_color, dtype=colors.dtype, device=colors.device)
        total = self._summed(weights * colors) + behind * background
        return torch.cat((total / (self._summed(weights) + behind), self.alpha(fragments, blend.sigma)), -1)

    def _pixel(self) -> Tensor:
        return self.place // self.size[3]

    def _summed(self, values: Tensor) -> Tensor:
        """Sum values [N, 1, M, 1, C] of the fragments of each pixel, [N, H, W, C]."""
        values = values[:, 0, :, 0]
        pixel = self._pixel()[..., None].expand_as(values)
        total = values.new_zeros(len(values), self.size[1] * self.size[2], values.shape[-1])
        return total.scatter_add(1, pixel, values).view(*self.size[:3], values.shape[-1])


def _at(place: Tensor, values: Tensor) -> Tensor:
    """Pick values [N, H, W, K, ...] at places [N, M] of each image, [N, 1, M, 1, ...]."""
    rows = values.reshape(*values.shape[:1], -1, *values.shape[4:])
    index = place.view(*place.shape, *[1] * (rows.ndim - 2)).expand(-1, -1, *rows.shape[2:])
    return rows.gather(1, index)[:, None, :, None]


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
        blend = kwargs.get("blend_params", self.blend_params)
        if not self.soft:
            return hard_rgb_blend(self.colors(meshes, fragments, cameras=cameras, **scene), fragments, blend)
        seen, near = _Seen.of(fragments), kwargs.get("znear", getattr(cameras, "znear", 1.0))
        colors = self.colors(meshes, seen.among(fragments), cameras=cameras, **scene)
        return seen.blended(colors, fragments, blend, near, kwargs.get("zfar", getattr(cameras, "zfar", 100.0)))

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
        return sigmoid_alpha_blend(torch.ones_like(fragments.bary_coords[..., :1, :]), fragments, blend)


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
