"""Images of the visible surface: normals, positions, texture coordinates, faces and weights at every pixel."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

from torch import Tensor

from ..camera import Camera
from ..meshes.batch import mesh_parts
from ..meshes.uv_mesh import UVMesh
from ..raster.colors.edge_hashes import attribute_edge_hashes
from ..raster.faces import world_corners
from ..raster.fragments import Fragments, visible_fragments
from ..raster.outputs import SURFACE
from ..raster.warp.elementwise import joined
from ..shading.pixels.visible_surface import normal_edge_hashes, visible_normals


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
            centers = visible_fragments(visible.next_corners(), visible.triangles, visible.num_vertices, one_sample, 4)
        images["face_index"] = joined((centers.face_index,), 0)
        images["barycentric"] = joined((centers.weights.movedim(3, 1),), 1)
    inside = visible.for_shading
    if "normal" in names:
        normals, of_corners = visible_normals(inside, mesh, camera, smooth)
        hashes = normal_edge_hashes(visible, mesh, smooth)
        images["normal"] = visible.blend(normals, 0.0, hashes is not None, hashes, of_corners)
    if "position" in names:
        points = mesh_parts(mesh)[0].float()
        of_corners = world_corners(points, visible.triangles, len(visible.corners), in_range=True)
        images["position"] = visible.blend(inside.interpolate(points), 0.0, False, None, of_corners)
    if "uv" in names:
        uv = mesh.uv if mesh.uv.dim() == 4 else mesh.uv[None]
        images["uv"] = visible.blend(inside.interpolate(uv), 0.0, True, lambda: attribute_edge_hashes(mesh.uv), uv)
    return {name: images[name] for name in names}
