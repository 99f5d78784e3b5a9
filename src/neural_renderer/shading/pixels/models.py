"""Shading models of `render`: the colour of each pixel from surface, material and lights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from ...base import validate
from ...base.color_space import linear_to_srgb, srgb_to_linear
from ...camera import Camera
from ...meshes.uv_mesh import UVMesh
from ...raster.colors.edge_hashes import attribute_edge_hashes, image_edge_hashes
from ...raster.fragments import Fragments
from ..pbr import PBR, shade_pbr
from ..phong import Phong, shade_diffuse, shade_phong
from .material_maps import MaterialMaps
from .shown import ShownPixels
from .visible_surface import VisibleSurface, surface_at

MODELS = ("smooth", "phong", "pbr")


@runtime_checkable
class Shading(Protocol):
    """A shading model: `Phong`, `PBR`, or any object with this method."""

    def shade(self, surface: VisibleSurface, albedo: Tensor, lights: Sequence[Any]) -> Tensor:
        """Compute the colours of pixels, [B, H, W, 3]; see `Phong.shade`."""


def checked_shading(shading: Any) -> Shading | str | None:
    """Return a shading model or its name, None for flat shading; raise TypeError or ValueError for other values."""
    if isinstance(shading, str):
        if shading not in ("flat", *MODELS):
            names = ", ".join(("flat", *MODELS))
            raise ValueError(f"shading: expected {names}, or an object with a method shade, got {shading!r}")
        return None if shading == "flat" else shading
    if not isinstance(shading, Shading) or isinstance(shading, type):
        raise TypeError(f"shading: expected a name, Phong, PBR, …, got {type(shading).__name__}")
    return shading


def shade_pixels(
    model: Shading | str, fragments: Fragments, mesh: Any, albedo: Tensor, camera: Camera, lights: Sequence[Any]
) -> Tensor:
    """Shade the pixels of a mesh; the albedo [B, H, W, 3] and the float32 result are display values.

    The model is one of `MODELS`, which uses the materials of the mesh, or an object of the protocol `Shading`. Lights
    are `pixel_lights`; without any, the albedo is returned. TypeError, ValueError: An argument does not fit.
    """
    # Matt surfaces need too few operations for packing to pay off; models of users may hold images of the full size.
    packs = model in ("phong", "pbr") if isinstance(model, str) else type(model) in (Phong, PBR)
    shown = ShownPixels(fragments.face_index, packs)
    surface, albedo = surface_at(shown, fragments, mesh, camera, matt=model == "smooth"), shown.pack(albedo)
    maps = MaterialMaps(fragments, mesh, shown) if isinstance(mesh, UVMesh) and mesh.materials else None
    if maps is not None:
        surface = maps.bumped(surface)
    if isinstance(model, str):
        colors = _by_name(model, surface, maps, albedo, lights)
    else:
        colors = model.shade(surface, albedo, lights)
    if isinstance(colors, Tensor) and colors.shape[1:] == albedo.shape[1:] and len(colors) != len(albedo):
        raise ValueError(f"light: expected parameters for {len(albedo)} images or for all, got {len(colors)}")
    colors = validate.floating("shading", colors, tuple(albedo.shape)).float()
    if maps is not None and any(material.unlit for material in maps.materials):
        colors = torch.where(maps.each([material.unlit for material in maps.materials]) > 0, albedo, colors)
    return shown.spread(colors)


def _by_name(
    model: str, surface: VisibleSurface, maps: MaterialMaps | None, albedo: Tensor, lights: Sequence[Any]
) -> Tensor:
    if model == "smooth" or (not lights and model == "phong"):
        return shade_diffuse(surface, albedo, lights)
    if maps is None:
        return (Phong() if model == "phong" else PBR()).shade(surface, albedo, lights)
    if model == "phong":
        specular = maps.scaled("specular", "specular_texture")
        return shade_phong(surface, albedo, lights, specular, maps.factor("shininess"))
    return _pbr(surface, maps, albedo, lights)


def _pbr(surface: VisibleSurface, maps: MaterialMaps, albedo: Tensor, lights: Sequence[Any]) -> Tensor:
    """Shade by materials; takes and returns display values."""
    base = srgb_to_linear(albedo)
    emissive_image = maps.textured("emissive_texture")
    emissive = maps.factor("emissive")
    if emissive_image is not None:
        emissive = emissive * srgb_to_linear(emissive_image)
    if not lights:
        return linear_to_srgb(base + emissive)
    metallic = maps.scaled("metallic", "metallic_roughness_texture", slice(2, 3))
    roughness = maps.scaled("roughness", "metallic_roughness_texture", slice(1, 2))
    return linear_to_srgb(shade_pbr(surface, base, metallic, roughness, lights, maps.occlusion(), emissive))


def surface_edge_hashes(mesh: UVMesh) -> Tensor:
    """Hash all values that determine per-pixel shading along each edge; as `image_edge_hashes`."""
    hashes = image_edge_hashes(mesh.uv, mesh.image_index, None, mesh.colors)
    for values in (mesh.normals, mesh.uv1, mesh.tints):
        if values is not None:
            hashes = hashes + attribute_edge_hashes(values)
    return _with_materials(hashes, mesh)


def flat_edge_hashes(mesh: UVMesh, light: Tensor | None) -> Tensor:
    """Hash all values that determine flat shading along each edge; as `image_edge_hashes`."""
    hashes = image_edge_hashes(mesh.uv, mesh.image_index, light, mesh.colors)
    if mesh.tints is not None:
        hashes = hashes + attribute_edge_hashes(mesh.tints)
        hashes = torch.where(hashes == 0, 1, hashes)  # 0 matches nothing
    return _with_materials(hashes, mesh) if any(material.is_tinted for material in mesh.materials) else hashes


def _with_materials(hashes: Tensor, mesh: UVMesh) -> Tensor:
    """Add the materials of faces to the hashes of their edges."""
    if mesh.material_index is not None:
        hashes = hashes + attribute_edge_hashes(mesh.material_index[..., None, None].repeat_interleave(3, -2))
    return torch.where(hashes == 0, 1, hashes)  # 0 matches nothing
