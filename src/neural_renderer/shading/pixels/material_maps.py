"""Material parameters at every pixel: factors times textures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from ...base import private
from ...meshes.uv_mesh import UVMesh
from ...raster.fragments import Fragments
from ...raster.warp.registration import is_plain
from ...textures.material import Material, Texture
from ..pbr import PBR
from ..phong import Phong
from .normal_maps import bumped, corner_tangents
from .shown import ShownPixels
from .visible_surface import VisibleSurface, at_pixels

_tangents_of_meshes: WeakKeyDictionary[UVMesh, tuple[Any, Tensor]] = WeakKeyDictionary()


class MaterialMaps:
    """Materials of a `UVMesh` at the shown pixels, [B, H, W].

    Faces without a material are shaded as in a mesh without materials.
    """

    def __init__(self, fragments: Fragments, mesh: UVMesh, shown: ShownPixels) -> None:
        self.fragments, self.mesh, self.pixels = fragments, mesh, shown
        self.materials = [*mesh.materials, _no_material()]
        self._uv: dict[int, Tensor] = {}
        if mesh.material_index is None:
            self.shown = None  # the same material everywhere
            self.materials = self.materials[:1]
        else:
            # Face −1 (background) and material −1 are the entry at the end.
            index = mesh.material_index.long().reshape(-1, mesh.num_faces)
            self.shown = (at_pixels(index + 1, fragments.face_index)[..., 0] - 1) % len(self.materials)

    def factor(self, name: str) -> Tensor:
        """Return a factor of the materials at every pixel, [B, H, W, C]; [1, 1, 1, C] for one material."""
        rows = [getattr(material, name).reshape(-1) for material in self.materials]
        return self._spread(torch.stack([row.to(self.fragments.corners.device) for row in rows]))

    def each(self, values: Sequence[float]) -> Tensor:
        """Return a number of each material at every pixel, [B, H, W, 1]; [1, 1, 1, 1] for one material."""
        return self._spread(torch.tensor(values, dtype=torch.float32, device=self.fragments.corners.device)[:, None])

    def textured(self, name: str, channels: slice = slice(None)) -> Tensor | None:
        """Sample channels of a texture at every pixel, [B, H, W, C]; None if no material has it.

        ``name`` is an attribute of `Material`; materials without the texture have the value 1.
        """
        textures = [getattr(material, name) for material in self.materials]
        if all(texture is None for texture in textures):
            return None
        bare = torch.tensor([[1.0 if texture is None else 0.0] for texture in textures])
        result = self._spread(bare.to(self.fragments.corners.device))
        for number, texture in enumerate(textures):
            if texture is not None:
                result = result + self._sample(number, texture)[..., channels]
        return result

    def scaled(self, factor: str, texture: str, channels: slice = slice(None)) -> Tensor:
        """Multiply a factor by its texture."""
        value, image = self.factor(factor), self.textured(texture, channels)
        return value if image is None else value * image

    def occlusion(self) -> Tensor | float:
        """Return the fraction of ambient light that arrives, [B, H, W, 1], or 1."""
        image = self.textured("occlusion_texture", slice(0, 1))
        return 1.0 if image is None else 1 + self.factor("occlusion_strength") * (image - 1)

    def bumped(self, surface: VisibleSurface) -> VisibleSurface:
        """Apply the normal maps of the materials to a surface."""
        for number, material in enumerate(self.materials):
            texture = material.normal_texture
            if texture is None:
                continue
            mapped = 2 * self._sample(number, texture) - 1
            scale = material.normal_scale.to(mapped.device)
            mapped = torch.cat((mapped[..., :2] * scale, mapped[..., 2:]), -1)
            changed = bumped(surface, self._tangents(texture.uv_set), mapped)
            if self.shown is not None:
                is_shown = self.pixels.pack((self.shown == number)[..., None])
                normals = torch.where(is_shown, changed.normals, surface.normals)
                changed = surface.with_normals(normals)
            surface = changed
        return surface

    def _tangents(self, uv_set: int) -> Tensor:
        """Interpolate the tangents of a normal map, [B, H, W, 4]."""
        mesh = self.mesh
        tangents = mesh.tangents
        if tangents is None or uv_set:
            tangents = _kept_tangents(mesh, uv_set)
        return self.pixels.pack(self.fragments.interpolate(tangents if tangents.dim() == 4 else tangents[None]))

    def _sample(self, number: int, texture: Texture) -> Tensor:
        """Sample a texture where its material is visible, [B, H, W, C]; 0 elsewhere."""
        mesh = self.mesh
        if texture.uv_set not in self._uv:
            uv = coordinates(mesh, texture.uv_set)
            self._uv[texture.uv_set] = self.fragments.interpolate(uv if uv.dim() == 4 else uv[None])
        face_index = self.fragments.face_index
        if self.shown is not None:
            face_index = torch.where(self.shown == number, face_index, -1)
        return self.pixels.pack(texture.sample(self._uv[texture.uv_set], face_index))

    def _spread(self, rows: Tensor) -> Tensor:
        """Look up rows [M, C] by the material of each pixel."""
        return rows[0].reshape(1, 1, 1, -1) if self.shown is None else self.pixels.pack(rows[self.shown])


def _no_material() -> Material:
    """Make the material that is equivalent to the models for meshes without materials."""
    matt, glossy = PBR(), Phong()
    return Material(
        metallic=matt.metallic,
        roughness=matt.roughness,
        specular=(glossy.specular,) * 3,
        shininess=glossy.shininess,
    )


def coordinates(mesh: UVMesh, uv_set: int) -> Tensor:
    """Return a set of texture coordinates, [F, 3, 2] or [B, F, 3, 2]; the first of a mesh without further ones."""
    return mesh.uv if not uv_set or mesh.uv1 is None else mesh.uv1[..., 2 * uv_set - 2 : 2 * uv_set]


def _kept_tangents(mesh: UVMesh, uv_set: int) -> Tensor:
    """Compute tangents of a mesh, [F, 3, 4] or [B, F, 3, 4]; cached until it changes unless they need gradients."""
    uv = coordinates(mesh, uv_set)
    parts = tuple(part for part in (mesh.vertices, mesh.faces, mesh.uv, mesh.uv1, mesh.normals) if part is not None)
    moves = any(part.requires_grad for part in parts) and torch.is_grad_enabled()
    version = None if moves or not is_plain(parts) else private.version_of(*parts)
    if version is None:
        return _computed_tangents(mesh, uv)
    key = uv_set, version, *map(id, parts)
    known = _tangents_of_meshes.get(mesh)
    if known is None or known[0] != key:
        with torch.inference_mode(False), torch.no_grad():
            known = _tangents_of_meshes[mesh] = (key, _computed_tangents(mesh, uv))
    return known[1]


def _computed_tangents(mesh: UVMesh, uv: Tensor) -> Tensor:
    if uv.dim() == 3:
        return corner_tangents(mesh.vertices, mesh.faces, uv, mesh.normals)
    faces = mesh.faces.clamp(min=0)  # padding is not drawn
    normals = [None] * len(uv) if mesh.normals is None else mesh.normals
    rows = zip(mesh.vertices, faces, uv, normals, strict=True)
    return torch.stack([corner_tangents(*row) for row in rows])
