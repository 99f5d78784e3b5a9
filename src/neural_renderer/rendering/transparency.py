"""Opacity of materials, and images of several layers of faces."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import torch
from torch import Tensor

from ..camera import Camera
from ..meshes.uv_mesh import UVMesh
from ..raster.colors.light_pixels import light_pixels
from ..raster.fragments import Fragments, Layers
from ..raster.outputs import Images
from ..shading.pixels.material_maps import MaterialMaps
from ..shading.pixels.models import Shading, flat_edge_hashes, shade_pixels, surface_edge_hashes
from ..shading.pixels.shown import ShownPixels
from ..shading.pixels.visible_surface import at_pixels
from ..textures.albedo import corner_values


def surface_opacity(fragments: Fragments, mesh: UVMesh, *, mirrored: bool = False) -> Tensor:
    """Compute the opacity of the surface at every pixel from the materials of a mesh, for `Layers.composite`.

    1 for ``alpha_mode="OPAQUE"``; 1 or 0 for ``"MASK"``, which has no gradient; alpha for ``"BLEND"``. Backs of
    faces that are not ``double_sided`` have opacity 0.

    Args:
        fragments: Fragments of this mesh, such as one of its `Layers`.
        mesh: Mesh with materials; a mesh without materials is opaque.
        mirrored: Whether the camera's image is mirrored (`Camera.mirrored`).

    Returns:
        [B, H, W, 1] float32, differentiable in the opacities, their textures and the alpha of ``tints``.

    Raises:
        TypeError, ValueError: ``mesh`` is not a `UVMesh`, or the fragments belong to another mesh.

    Example:
        >>> vertices, faces = nr.icosphere(2)
        >>> glass = (nr.Material("glass", opacity=0.25, alpha_mode="BLEND"),)
        >>> ball = nr.UVMesh(vertices, faces, vertices[:, :2], torch.ones(1, 1, 3), materials=glass)
        >>> layers = nr.fragments(ball, camera, 64, layers=2)
        >>> opacity = [surface_opacity(layer, ball) for layer in layers]
        >>> layers.composite([ball.shade(layer) for layer in layers], opacity).shape
        torch.Size([1, 3, 64, 64])
    """
    if not isinstance(mesh, UVMesh):
        raise TypeError(f"mesh: expected a UVMesh, got {type(mesh).__name__}")
    if mesh.num_faces != fragments.corners.shape[1]:
        raise ValueError(f"fragments: expected those of {mesh.num_faces} faces, got {fragments.corners.shape[1]}")
    ones = torch.ones(*fragments.face_index.shape, 1, device=fragments.corners.device)
    if not mesh.materials:
        return ones
    maps = MaterialMaps(fragments, mesh, ShownPixels(fragments.face_index, packs=False))
    result = ones
    modes = {material.alpha_mode for material in maps.materials}
    if modes != {"OPAQUE"}:
        alpha = maps.scaled("opacity", "opacity_texture")
        if mesh.tints is not None:
            alpha = alpha * corner_values(fragments, mesh.tints[..., 3:])
        cut = maps.each([material.alpha_cutoff for material in maps.materials])
        blends, masks = (maps.each([one.alpha_mode == name for one in maps.materials]) for name in ("BLEND", "MASK"))
        result = torch.where(blends > 0, alpha, torch.where(masks > 0, (alpha >= cut).float(), 1.0)).expand_as(ones)
    if not all(material.double_sided for material in maps.materials):
        both = maps.each([material.double_sided for material in maps.materials])
        result = torch.where((both > 0) | _shows_front(fragments, mirrored), result, 0.0)
    return result


def layered_images(
    layers: Layers,
    mesh: UVMesh,
    camera: Camera,
    lights: Sequence[Any],
    model: Shading | str | None,
    factors: Tensor | None,
    background: Any,
    outputs: Collection[str],
) -> Images:
    """Shade and blend layers; arguments as in `render`, and the light on faces for flat shading (``model`` None)."""
    opacity, colors = [], []
    for layer in layers:
        inside = layer.for_shading
        opacity.append(surface_opacity(inside, mesh, mirrored=camera.mirrored))
        if "rgb" not in outputs:
            continue
        color = mesh.shade(inside)
        if model is not None:
            color = shade_pixels(model, inside, mesh, color, camera, lights)
        elif factors is not None:
            scene = inside.corners.detach(), inside.face_index, inside.settings.perspective
            color = light_pixels(color, color.new_zeros(1, 3, 1, 1), factors, *scene).movedim(1, 3)
        colors.append(color)
    results: dict[str, Any] = {}
    if "rgb" in outputs:
        hashes: Callable[[], Tensor] = lambda: (  # noqa: E731
            flat_edge_hashes(mesh, factors) if model is None else surface_edge_hashes(mesh)
        )
        results["rgb"] = layers.blend(colors, opacity, background, True, hashes)
    if "alpha" in outputs:
        results["alpha"] = layers.composite([torch.ones_like(alpha) for alpha in opacity], opacity)[:, 0]
    if "depth" in outputs:
        results["depth"] = layers[0].images(("depth",)).depth
    return Images(**results)


def _shows_front(fragments: Fragments, mirrored: bool) -> Tensor:
    """Return whether each pixel shows the front of its face, [B, H, W, 1] bool."""
    corners = fragments.corners.detach()
    p, q, r = corners[..., :2].unbind(2)
    area = (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
    if fragments.settings.perspective:  # projection mirrors corners behind the camera
        area = area * corners[..., 2].sign().prod(-1)
    front = (area < 0) if mirrored else (area > 0)
    return at_pixels((~front).float(), fragments.face_index) == 0
