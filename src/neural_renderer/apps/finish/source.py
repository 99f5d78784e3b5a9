"""`Source`: the look of the original mesh at any point of its surface."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional

from ...base.color_space import srgb_to_linear
from ...io.atlas import build_atlas
from ...io.atlas import coordinates as atlas_coordinates
from ...meshes.mesh import Mesh
from ...meshes.normals import face_normals, vertex_normals
from ...meshes.uv_mesh import UVMesh
from ...shading.pixels.material_maps import coordinates
from ...shading.pixels.normal_maps import corner_tangents
from ...textures.color_space import tinted
from ...textures.material import Material, Texture
from ...textures.sample_texture import Wrap, sampled
from ..common.geometry.edges import areas
from ..common.pictures.outputs import averaged, looks_smooth

COLOR, ALPHA, OCCLUSION, ROUGHNESS, METALLIC = slice(0, 3), slice(3, 4), slice(4, 5), slice(5, 6), slice(6, 7)
EMISSION, NORMAL = slice(7, 10), slice(10, 13)
CHANNELS = 13
"""Channels of a look: the base colour (display values), alpha, occlusion, roughness, metallic, emission (linear), and
the unit normal of shading in world space."""
_POINTS_PER_PASS = 1 << 18  # points that are sampled together: a limit of the memory


class Source:
    """The look of a mesh at points of its surface: `CHANNELS` numbers each.

    ``detail`` is the distance of two samples in world units; images with smaller texels are averaged first.
    """

    def __init__(self, mesh: Mesh | UVMesh, detail: float = 0.0) -> None:
        self.mesh = with_materials(mesh if isinstance(mesh, UVMesh) else _uv_mesh(mesh))
        self.vertices, self.faces = self.mesh.vertices.detach().float(), self.mesh.faces.long()
        self.normals = self._shading_normals()
        self.drawn = self.mesh.replace(normals=self.normals)
        self._tangents: dict[int, Tensor] = {}
        self._images = [self._averaged(image, number, detail) for number, image in enumerate(self.mesh.images)]

    def _shading_normals(self) -> Tensor:
        """Return the normals of the mesh; else smooth ones, or those of the faces where it has many creases."""
        corners = self.vertices[self.faces]
        flat = -face_normals(corners)[:, None].expand(-1, 3, -1)
        smooth = vertex_normals(self.vertices, self.faces)[0][self.faces] if looks_smooth(self.mesh) else flat
        given = self.mesh.normals
        if given is not None:
            smooth = torch.where(given.square().sum(-1, keepdim=True) > 0.25, given.detach().float(), smooth)
        return functional.normalize(smooth, dim=-1).contiguous()

    @torch.no_grad()
    def look(self, face: Tensor, weights: Tensor) -> Tensor:
        """Compute the look [N, CHANNELS] at points of faces [N], with barycentric weights [N, 3]."""
        result = torch.empty(len(face), CHANNELS)
        for start in range(0, len(face), _POINTS_PER_PASS):
            part = slice(start, start + _POINTS_PER_PASS)
            self._fill(result[part], face[part], weights[part])
        return result

    def _fill(self, result: Tensor, face: Tensor, weights: Tensor) -> None:
        mesh = self.mesh
        result[:, COLOR] = self._albedo(face, weights)
        result[:, NORMAL] = functional.normalize(mixed(self.normals, face, weights), dim=-1)
        result[:, ALPHA] = 1 if mesh.tints is None else mixed(mesh.tints[..., 3:], face, weights)
        result[:, OCCLUSION], result[:, ROUGHNESS], result[:, METALLIC], result[:, EMISSION] = 1, 1, 0, 0
        for rows, material in self._materials(face):
            if material.is_tinted:
                result[rows, COLOR] = tinted(result[rows, COLOR], material.base_color)
            places = (face[rows], weights[rows])
            result[rows, ALPHA] *= material.opacity * self._sampled(material.opacity_texture, *places, 1)
            reflects = self._sampled(material.metallic_roughness_texture, *places, 3)
            result[rows, ROUGHNESS] = material.roughness * reflects[:, 1:2]
            result[rows, METALLIC] = material.metallic * reflects[:, 2:3]
            occlusion = self._sampled(material.occlusion_texture, *places, 1)
            result[rows, OCCLUSION] = 1 + material.occlusion_strength * (occlusion - 1)
            glow = self._sampled(material.emissive_texture, *places, 3)
            if bool(material.emissive.any()):
                result[rows, EMISSION] = material.emissive * srgb_to_linear(glow)
            if material.normal_texture is not None:
                result[rows, NORMAL] = self._bumped(result[rows, NORMAL], material, *places)

    def _albedo(self, face: Tensor, weights: Tensor) -> Tensor:
        """Compute the base colour without the factor of materials, display values [N, 3]."""
        mesh = self.mesh
        color = mixed(mesh.colors.detach(), face, weights)
        image = mesh.image_index[face]
        places = mixed(mesh.uv.detach(), face, weights)
        for number, (pixels, wrap) in enumerate(zip(self._images, mesh.wraps, strict=True)):
            rows = torch.nonzero(image == number)[:, 0]
            color[rows] = _bilinear(pixels, places[rows], wrap)
        if mesh.tints is not None:
            color = tinted(color, mixed(mesh.tints[..., :3].detach(), face, weights))
        return color

    def kinds(self, face: Tensor) -> Tensor:
        """Return the numbers of the materials of faces [N]."""
        index: Tensor = self.mesh.material_index  # type: ignore[assignment]  # each face has a material
        return index[face]

    def _materials(self, face: Tensor) -> Iterator[tuple[Tensor, Material]]:
        """Iterate over the materials of points, with the numbers of their points."""
        kinds = self.kinds(face)
        for number, material in enumerate(self.mesh.materials):
            rows = torch.nonzero(kinds == number)[:, 0]
            if len(rows):
                yield rows, material

    def _sampled(self, texture: Texture | None, face: Tensor, weights: Tensor, channels: int) -> Tensor:
        """Sample a texture of a material, [N, channels]; 1 without one."""
        if texture is None:
            return torch.ones(len(face), channels)
        places = texture.transformed(mixed(coordinates(self.mesh, texture.uv_set).detach(), face, weights))
        return _bilinear(texture.image.detach().float(), places, texture.wrap)[:, :channels]

    def _bumped(self, normals: Tensor, material: Material, face: Tensor, weights: Tensor) -> Tensor:
        """Apply the normal map of a material to unit normals [N, 3]."""
        texture = material.normal_texture
        tangents = mixed(self._corner_tangents(texture.uv_set if texture else 0), face, weights)
        mapped = 2 * self._sampled(texture, face, weights, 3) - 1
        along = functional.normalize(tangents[:, :3], dim=-1)
        across = tangents[:, 3:].sign() * torch.linalg.cross(normals, along, dim=-1)
        x, y, z = mapped.split(1, -1)
        return functional.normalize(material.normal_scale * (x * along + y * across) + z * normals, dim=-1)

    def _corner_tangents(self, uv_set: int) -> Tensor:
        if uv_set not in self._tangents:
            kept = None if uv_set else self.mesh.tangents
            if kept is None:
                kept = corner_tangents(self.vertices, self.faces, coordinates(self.mesh, uv_set).detach(), self.normals)
            self._tangents[uv_set] = kept
        return self._tangents[uv_set]

    def _averaged(self, image: Tensor, number: int, detail: float) -> Tensor:
        """Average the texels of an image that are much smaller than ``detail``, by a power of two."""
        image = image.detach().float()
        shown = self.mesh.image_index == number
        if detail <= 0 or not bool(shown.any()):
            return image
        size = image.new_tensor(image.shape[1::-1])
        texels = areas(functional.pad(self.mesh.uv[shown].detach() * size, (0, 1))).double().sum()
        area = areas(self.vertices[self.faces[shown]]).double().sum()
        ratio = detail * math.sqrt(float(texels / area.clamp(min=1e-30)))  # texels of the image for one sample
        most = int(math.log2(min(image.shape[:2])))
        factor = 2 ** min(max(0, round(math.log2(max(ratio, 1e-9)))), most)
        return averaged(image, factor)


def with_materials(mesh: UVMesh) -> UVMesh:
    """Give faces without a material a matt one, that of the light mesh; pictures of both then have the same lustre."""
    index = mesh.material_index
    if index is None:
        index = torch.full((len(mesh.faces),), -1, device=mesh.faces.device)
    if not bool((index < 0).any()):
        return mesh
    index = torch.where(index < 0, len(mesh.materials), index)
    return mesh.replace(materials=(*mesh.materials, Material()), material_index=index)


def seen_from_both_sides(mesh: UVMesh, chosen: Tensor) -> UVMesh:
    """Give chosen faces [F] bool with materials of one side the same with both."""
    if mesh.material_index is None:
        return mesh
    materials, index = list(mesh.materials), mesh.material_index.clone()
    for number in mesh.material_index[chosen].unique().tolist():
        if number >= 0 and not materials[number].double_sided:
            index[chosen & (mesh.material_index == number)] = len(materials)
            materials.append(replace(materials[number], double_sided=True))
    return mesh.replace(materials=tuple(materials), material_index=index)


def mixed(corners: Tensor, face: Tensor, weights: Tensor) -> Tensor:
    """Interpolate values of the faces' corners, [F, 3, C], at N points of faces [N], with weights [N, 3]."""
    return torch.einsum("nk,nkc->nc", weights, corners[face].float())


def _bilinear(image: Tensor, places: Tensor, wrap: Wrap) -> Tensor:
    """Sample an image at N places."""
    if not len(places):
        return image.new_zeros(0, image.shape[2])
    return sampled(image[None], places[None, None].contiguous(), None, wrap)[0, 0]


def _uv_mesh(mesh: Mesh) -> UVMesh:
    """Convert a mesh with texture cubes, or colours of vertices or faces."""
    count = len(mesh.faces)
    colors = mesh.colors_of_faces().detach().float()
    if colors.dim() > 3 and colors.shape[1] > 1:
        picture, pixels = build_atlas(colors.numpy())
        uv = torch.from_numpy(atlas_coordinates(pixels, picture)).float()
        return UVMesh(mesh.vertices.detach(), mesh.faces, uv, torch.from_numpy(picture).float() / 255, wrap="clamp")
    colors = colors.reshape(count, -1, 3).expand(-1, 3, -1).contiguous()
    index = torch.full((count,), -1)
    return UVMesh(mesh.vertices.detach(), mesh.faces, torch.zeros(count, 3, 2), index, (), colors, ())
