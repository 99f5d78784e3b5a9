"""Outputs of `render` as files keep them, and the distance and planes of cameras that suit a mesh."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ....camera import Camera
from ....meshes.batch import mesh_parts
from ....meshes.normals import vertex_normals
from ....raster.outputs import Images
from ....raster.settings import image_size
from ....rendering.forward import render, render_rows

GREY = 0.82
"""Colour of meshes without colours."""
_MARGIN = 1.05  # factor on the least distance at which the whole mesh is in the picture
_CREASE, _CREASES = math.cos(math.radians(30)), 0.15  # cosine at a crease; fraction of corners that may have one
_PLANES = 0.05  # distance of the near and far planes from the mesh, in its extent in depth


def radius_of(vertices: Tensor) -> float:
    """Return the radius of vertices [V, 3] around the origin, above 0."""
    return max(vertices.detach().norm(dim=1).max().item(), 1e-6)


def distance_to_see(radius: float, viewing_angle: float, aspect: float = 1.0) -> float:
    """Return a camera's distance from the centre of a ball that its picture, aspect = width / height, then contains."""
    return _MARGIN * radius / (math.sin(math.radians(viewing_angle)) * max(min(1.0, aspect), 1e-6))


def scale_to_see(radius: float, aspect: float = 1.0) -> float:
    """Return the scale of a camera without perspective whose picture contains a ball around its centre."""
    return min(1.0, aspect) / (_MARGIN * radius)


def looks_smooth(mesh: Any) -> bool:
    """Return whether a mesh has normals, or few creases; furniture has many."""
    if getattr(mesh, "normals", None) is not None:
        return True
    vertices, faces, _ = mesh_parts(mesh)
    corners = vertices.detach()[faces.long()]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    smooth = vertex_normals(vertices.detach(), faces)[0][faces.long()]
    cosines = (functional.normalize(normals, dim=1)[:, None] * smooth).sum(2)
    return bool((cosines < _CREASE).float().mean() < _CREASES)


def depth_range(mesh: Any, camera: Camera) -> tuple[float, float]:
    """Return near and far planes around the part of a mesh in front of a camera; ValueError if it is behind it."""
    depth = camera(mesh.vertices.detach())[0, :, 2]
    low, high = depth.min().item(), depth.max().item()
    if high <= 0:
        raise ValueError("camera: expected a camera that sees the mesh, got all of it behind it")
    margin = _PLANES * max(high - low, 1e-3 * high)
    return max(low - margin, 1e-3 * high), high + margin


@torch.no_grad()
def draw_outputs(
    mesh: Any, camera: Camera, size: int | tuple[int, int], names: Collection[str], **scene: Any
) -> dict[str, np.ndarray]:
    """Draw outputs of `render`, and "rgba", from one camera: [H, W] or [H, W, C] by name. ``scene`` are its arguments.

    "rgb", "alpha" and "rgba" are anti-aliased. The others are those at the pixels' centres, with smooth normals: 0
    where no face is visible, -1 for "face_index". The colours of "rgba" are not multiplied by alpha, whatever the
    background.
    """
    images: dict[str, Tensor] = {}
    height, rows = image_size("size", size)[0], slice(None)
    if "rgba" in names:
        drawn, rows = _shown(mesh, camera, size, outputs=("rgb", "alpha"), **{**scene, "background": 0.0})
        alpha = drawn.alpha[0]
        images["rgba"] = torch.cat((drawn.rgb[0] / alpha.clamp(min=1e-6), alpha[None]))
        images["alpha"] = alpha
    smooth = [name for name in names if name in ("rgb", "alpha") and name not in images]
    plain = [name for name in names if name not in ("rgb", "alpha", "rgba")]
    if smooth:
        drawn = render(mesh, camera, size, outputs=smooth, **scene)
        images |= {name: getattr(drawn, name)[0] for name in smooth}
    if plain:
        geometry: dict[str, Any] = {name: scene[name] for name in ("near", "far", "tile") if name in scene}
        options = {**geometry, "anti_aliasing": False, "shading": "smooth", "light": None}
        drawn, rows = _shown(mesh, camera, size, outputs=(*plain, "alpha"), **options)
        images |= {name: getattr(drawn, name)[0] for name in plain}
        if "depth" in images:
            images["depth"] = images["depth"] * drawn.alpha[0]  # 0 in place of the far plane
    arrays = {}
    for name in names:
        image = images[name].cpu()
        if image.shape[-2] < height:
            pads = (0, 0, rows.start, height - rows.stop)
            image = functional.pad(image, pads, value=-1 if name == "face_index" else 0)
        arrays[name] = (image.movedim(0, 2) if image.dim() == 3 else image).numpy()
    return arrays


def _shown(mesh: Any, camera: Camera, size: int | tuple[int, int], **options: Any) -> tuple[Images, slice]:
    """Render the rows of the image that show the mesh, and return their range; all rows if in tiles or with layers."""
    if options.get("tile") is None and options.get("layers") is None:
        return render_rows(mesh, camera, size, **options)
    return render(mesh, camera, size, **options), slice(None)


def averaged(image: Tensor, factor: int) -> Tensor:
    """Average blocks of ``factor``² pixels of an image [H, W, C]; the last ones may be smaller."""
    if factor == 1:
        return image
    height, width, channels = image.shape
    if height % factor == width % factor == 0:
        rows = image.reshape(height // factor, factor, -1).mean(1)  # in the order of the memory
        return rows.view(height // factor, width // factor, factor, channels).mean(2)
    return functional.avg_pool2d(image.movedim(2, 0)[None], factor, ceil_mode=True)[0].movedim(0, 2).contiguous()
