"""How a mesh is shown: its colours, one colour, its normals, or a colour for each face."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from ...io.atlas import build_atlas, coordinates
from ...meshes.normals import vertex_normals
from ...meshes.uv_mesh import UVMesh
from ...pictures.clay import CLAY
from .glb import Drawable
from .snapshot import Snapshot

Surface = Literal["colours", "clay", "normals", "faces"]
SURFACES: tuple[Surface, ...] = ("colours", "clay", "normals", "faces")
_ATLAS_BORDER = 3  # pixels of an atlas's tile besides those between texels
_MOST_ATLAS_PIXELS = 4096**2  # finer meshes have the colours of their faces' corners only
_EVEN = 1 / 512  # colours that differ by less are one colour


@dataclass(frozen=True)
class Look:
    """How meshes are shown.

    Attributes:
        surface: What the colours mean: "colours" of the mesh, "clay", "normals" in world space, or a colour per face.
        lit: Whether light falls on "colours" and "clay".
        smooth: Whether the light is interpolated over faces that share vertices.
    """

    surface: Surface = "colours"
    lit: bool = True
    smooth: bool = True


def drawables(snapshot: Snapshot, look: Look, values: Tensor | None = None) -> list[Drawable]:
    """Convert a mesh to arrays for a graphics card.

    Args:
        snapshot: A mesh with at least one face, all of whose vertices are finite.
        look: How to show it.
        values: [V, 3] in [0, 1], colours of vertices to show in place of the surface; or None.

    Returns:
        The parts of the mesh; several if it has several images.
    """
    faces = snapshot.faces.long()
    if values is not None:
        return [_of_vertices(snapshot, values, Look(lit=False))]
    if look.surface == "normals":
        if look.smooth:
            return [_of_vertices(snapshot, (vertex_normals(snapshot.vertices, faces)[0] + 1) / 2, Look(lit=False))]
        normals = _normals(snapshot.vertices[faces])
        return [_of_corners(snapshot, ((normals + 1) / 2)[:, None].expand(-1, 3, -1), lit=False)]
    if look.surface == "faces":
        colors = face_colors(torch.arange(len(faces)))
        return [_of_corners(snapshot, colors[:, None].expand(-1, 3, -1), lit=look.lit)]
    if look.surface == "clay":
        return [_plain(snapshot, CLAY, look)]
    if snapshot.uv_mesh is not None:
        return _of_images(snapshot, snapshot.uv_mesh, look)
    return [_of_cubes(snapshot, look)]


def face_colors(index: Tensor) -> Tensor:
    """Choose colours [F, 3] for numbers of faces [F]; consecutive numbers get different hues."""
    hue = torch.frac(index.double() * 0.6180339887)[:, None] * 6 + torch.tensor([0.0, 4.0, 2.0])  # golden ratio
    return (((hue % 6 - 3).abs() - 1).clamp(0, 1) * 0.55 + 0.35).float()


def _of_cubes(snapshot: Snapshot, look: Look) -> Drawable:
    """Show texture cubes: as one colour, as colours of corners, or as an atlas."""
    cubes, faces = snapshot.textures, snapshot.faces.long()
    if cubes is None:
        return _plain(snapshot, CLAY, look)
    flat = cubes.reshape(-1, 3)
    low, high = torch.aminmax(flat, dim=0)
    if bool((high - low <= _EVEN).all()):
        red, green, blue = ((low + high) / 2).nan_to_num().clamp(0, 1).tolist()
        return _plain(snapshot, (red, green, blue), look)
    last = cubes.shape[1] - 1
    corners = torch.stack((cubes[:, last, 0, 0], cubes[:, 0, last, 0], cubes[:, 0, 0, last]), 1)
    tile = last + _ATLAS_BORDER
    if last < 2 or len(faces) * tile**2 > _MOST_ATLAS_PIXELS:
        shared = torch.zeros_like(snapshot.vertices)
        shared[faces.reshape(-1)] = corners.reshape(-1, 3)
        if look.smooth and bool(((shared[faces] - corners).abs() <= _EVEN).all()):
            return _of_vertices(snapshot, shared, look)
        return _of_corners(snapshot, corners, look.lit)
    picture, pixels = build_atlas(cubes.nan_to_num().numpy(), tile, by_color=False)
    uv = coordinates(pixels.reshape(-1, 2), picture) * [1, -1] + [0, 1]
    return Drawable(*_unrolled(snapshot), uv=uv.astype(np.float32), image=_jpeg(picture), wrap="clamp", lit=look.lit)


def _of_images(snapshot: Snapshot, mesh: UVMesh, look: Look) -> list[Drawable]:
    """Show the images of a mesh, and the corner colours of faces without one."""
    found = []
    for number, (image, wrap) in enumerate(zip(mesh.images, mesh.wraps, strict=True)):
        own = torch.nonzero(mesh.image_index == number).flatten()
        if not len(own):
            continue
        # A vertex of a graphics card has one texture coordinate, so a vertex with several is duplicated.
        uv = (mesh.uv[own].reshape(-1, 2).nan_to_num() * torch.tensor([1.0, -1.0]) + torch.tensor([0.0, 1.0])).numpy()
        corners = snapshot.faces[own].reshape(-1).numpy()
        index = normals = None
        if look.smooth:
            keys = np.rec.fromarrays((corners, uv[:, 0], uv[:, 1]))
            _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
            normals = _smooth(snapshot)
            corners, uv, index = corners[first], uv[first], inverse.reshape(-1, 3).astype(np.uint32)
        pixels = (image.nan_to_num().clamp(0, 1) * 255 + 0.5).byte().numpy()
        picture = _jpeg(pixels)
        vertices = snapshot.vertices.numpy()
        found.append(Drawable(vertices, corners, normals, index, uv=uv, image=picture, wrap=wrap, lit=look.lit))
    rest = mesh.image_index < 0
    if bool(rest.any()):
        part = Snapshot(snapshot.vertices, snapshot.faces[rest])
        found.append(_of_corners(part, mesh.colors[rest], look.lit))
    return found


def _plain(snapshot: Snapshot, color: tuple[float, float, float], look: Look) -> Drawable:
    """Show one colour."""
    if look.smooth or look.lit:  # the browser lights single colours smoothly or not, as it is told
        return Drawable(snapshot.vertices.numpy(), index=_index(snapshot), color=color, lit=look.lit)
    return Drawable(*_unrolled(snapshot), color=color, lit=look.lit)


def _of_vertices(snapshot: Snapshot, colors: Tensor, look: Look) -> Drawable:
    """Show colours of vertices [V, 3]."""
    if not look.smooth:
        return _of_corners(snapshot, colors[snapshot.faces.long()], look.lit)
    normals = _smooth(snapshot) if look.lit else None
    return Drawable(snapshot.vertices.numpy(), None, normals, _index(snapshot), colors=_bytes(colors), lit=look.lit)


def _of_corners(snapshot: Snapshot, colors: Tensor, lit: bool) -> Drawable:
    """Show colours of the faces' corners [F, 3, 3]."""
    return Drawable(*_unrolled(snapshot), colors=_bytes(colors.reshape(-1, 3)), lit=lit)


def _unrolled(snapshot: Snapshot) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices, and the vertex at each corner of the faces, [3 F]: faces share no positions."""
    return snapshot.vertices.numpy(), snapshot.faces.numpy().reshape(-1)


def _smooth(snapshot: Snapshot) -> np.ndarray:
    """Compute the normals of vertices, [V, 3]."""
    return vertex_normals(snapshot.vertices, snapshot.faces.long())[0].numpy()


def _index(snapshot: Snapshot) -> np.ndarray:
    """Return the faces, [F, 3] uint32."""
    return snapshot.faces.numpy().astype(np.uint32)


def _normals(corners: Tensor) -> Tensor:
    """Compute unit normals [F, 3] of faces with corners [F, 3, 3]."""
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return torch.nn.functional.normalize(normals, dim=1)


def _bytes(colors: Tensor) -> np.ndarray:
    """Convert colours in [0, 1] to bytes."""
    return (colors.nan_to_num().clamp(0, 1) * 255 + 0.5).byte().numpy()


def _jpeg(pixels: np.ndarray) -> bytes:
    """Encode an image, with colours at full resolution."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=92, subsampling=0)
    return file.getvalue()
