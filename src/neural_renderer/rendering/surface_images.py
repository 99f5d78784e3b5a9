"""Images of the visible surface: normals, positions, texture coordinates, faces and weights at every pixel."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..camera import Camera
from ..meshes.batch import mesh_parts
from ..meshes.uv_mesh import UVMesh
from ..raster.fragments import Fragments, visible_fragments
from ..raster.outputs import SURFACE
from ..shading.pixels.visible_surface import visible_normals


def surface_outputs(outputs: Collection[str], mesh: Any, has_camera: bool) -> list[str]:
    """Select the outputs that `surface_images` makes; raise ValueError for those that the scene does not have."""
    names = [name for name in outputs if name in SURFACE]
    if "uv" in names and not isinstance(mesh, UVMesh):
        raise ValueError(f'outputs: expected a UVMesh for "uv", got {type(mesh).__name__}')
    placed = [name for name in names if name in ("normal", "position")]
    if placed and not has_camera:
        raise ValueError(f'outputs: expected a camera for "{placed[0]}", got None: clip space is not the world')
    return names


def surface_images(
    names: Collection[str], visible: Fragments, mesh: Any, camera: Camera, smooth: bool
) -> dict[str, Tensor]:
    """Make images of the visible surface by name, which are some of `SURFACE`; `Images` explains each.

    Normals are ``smooth`` or face normals.
    """
    settings = visible.settings
    images: dict[str, Tensor] = {}
    if "face_index" in names or "barycentric" in names:
        centers = visible
        if settings.anti_aliasing:
            one_sample = replace(settings, anti_aliasing=False)
            centers = visible_fragments(visible.corners, visible.triangles, visible.num_vertices, one_sample, 4)
        images["face_index"] = centers.face_index.clone()
        images["barycentric"] = centers.weights.movedim(3, 1).contiguous()
    inside = visible.for_shading
    values: dict[str, Tensor] = {}
    if "normal" in names:
        values["normal"] = visible_normals(inside, mesh, camera, smooth)
    if "position" in names:
        values["position"] = inside.interpolate(mesh_parts(mesh)[0])
    if "uv" in names:
        values["uv"] = inside.interpolate(mesh.uv if mesh.uv.dim() == 4 else mesh.uv[None])
    if values:
        jumps = "uv" in values or ("normal" in values and not smooth)
        composed = visible.composite(torch.cat(list(values.values()), -1), seams=jumps)
        parts = composed.split([value.shape[-1] for value in values.values()], 1)
        # Copies: autograd forbids in-place changes of one of several views.
        images |= {name: part.clone() for name, part in zip(values, parts, strict=True)}
    return {name: images[name] for name in names}
