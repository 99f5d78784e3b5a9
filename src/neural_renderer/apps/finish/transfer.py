"""Transfer of the look of the original to the images of the small mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ...base.color_space import linear_to_srgb
from ...meshes.normals import face_normals
from ...meshes.uv_mesh import UVMesh
from ...shading.pixels.normal_maps import corner_tangents
from ...textures.gutters import pull_push
from ...textures.material import Material, Texture
from ..common.geometry.edges import area_vectors
from ..common.geometry.nearest import NearestFaces
from .layout import Layout
from .source import ALPHA, CHANNELS, COLOR, EMISSION, METALLIC, NORMAL, OCCLUSION, ROUGHNESS, Source, mixed

MARGIN = 3
"""Texels around charts that get colours of the original; those beyond are blended."""
_CHUNK = 1 << 18  # texels that are searched together
_REACH = 0.02  # length of the rays along the normal, relative to the longest side
_CREASE = 0.5  # cosine of the angle between faces beyond which their normals are not averaged
_KEPT = ("alpha_mode", "alpha_cutoff", "double_sided", "unlit")  # attributes that images do not hold
_EVEN = 1.5 / 255  # largest deviation of a value that is one number for all


class Surroundings:
    """The original surface to search, with vertices in [-1, 1]³ by an offset and a scale."""

    def __init__(self, source: Source, center: Tensor, half: float) -> None:
        self.source, self._center, self._half = source, center, half
        self._search = NearestFaces((source.vertices.double() - center) / half, source.faces)

    def points(self, points: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
        """Find the points of the original near points [N, 3] with normals [N, 3]: faces [N] and weights [N, 3]."""
        places = ((points - self._center) / self._half).float()
        return self._search.along(places, normals, 2 * _REACH)


def corner_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Compute normals of the faces' corners, [F, 3, 3]: area-weighted, but not across edges sharper than 60°."""
    return averaged_normals(area_vectors(vertices[faces])[:, None].expand(-1, 3, -1), faces, _CREASE)


def averaged_normals(directions: Tensor, faces: Tensor, crease: float) -> Tensor:
    """Average the directions [F, 3, 3] of corners, weighted by their lengths, over the corners of the same vertex.

    Those are left out whose direction differs from a corner's by an angle with a cosine below ``crease``.
    """
    scaled = directions.reshape(-1, 3).double()
    unit = functional.normalize(scaled, dim=-1)
    count = len(scaled)
    corner_vertex = faces.reshape(-1)
    order = torch.argsort(corner_vertex, stable=True)  # corners, grouped by vertex
    degree = torch.bincount(corner_vertex)
    begin = degree.cumsum(0) - degree
    uses = degree[corner_vertex]
    corner = torch.arange(count).repeat_interleave(uses)
    step = torch.arange(len(corner)) - (uses.cumsum(0) - uses)[corner]
    other = order[begin[corner_vertex[corner]] + step]
    close = ((unit[corner] * unit[other]).sum(1) > crease) | (corner == other)
    total = torch.zeros_like(scaled).index_add(0, corner[close], scaled[other[close]])
    total = torch.where(total.norm(dim=1, keepdim=True) > 1e-30, functional.normalize(total, dim=-1, eps=1e-30), unit)
    valid = total.norm(dim=1, keepdim=True) > 0.5
    up = total.new_tensor([0.0, 0.0, 1.0]).expand_as(total)
    return torch.where(valid, total, up).float().view(-1, 3, 3)


@torch.no_grad()
def transfer(
    mesh: UVMesh, layout: Layout, around: Surroundings, report: Callable[[int, int], None] | None = None
) -> Tensor:
    """Look up the original at each texel of a mesh with normals: looks [N, `CHANNELS`] of the layout's texels."""
    count = len(layout.texels)
    result = torch.empty(count, CHANNELS)
    corners, normals = mesh.vertices[mesh.faces.long()], mesh.normals
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        face, weights = layout.faces[part], layout.weights[part]
        points = mixed(corners, face, weights)
        pointing = mixed(corners if normals is None else normals, face, weights.clamp(0, 1))
        pointing = functional.normalize(pointing, dim=-1)
        result[part] = around.source.look(*around.points(points, pointing))
        if report is not None:
            report(min(start + _CHUNK, count), count)
    return result


@torch.no_grad()
def kinds_of_faces(mesh: UVMesh, around: Surroundings) -> Tensor:
    """Find the material of the original at the centre of each face, [F] int64."""
    corners = mesh.vertices[mesh.faces.long()]
    face, _ = around.points(corners.mean(1), -face_normals(corners))
    return around.source.kinds(face)


@torch.no_grad()
def textured(mesh: UVMesh, layout: Layout, looks: Tensor, source: UVMesh, kinds: Tensor) -> UVMesh:
    """Make images and materials of looks [N, `CHANNELS`]; ``kinds`` are the original's materials of the faces."""

    def image(values: Tensor) -> Tensor:
        return filled(layout, values).clamp(0, 1)

    shared: dict[str, Any] = {}
    if not _is_even(looks[:, ALPHA]) or float(looks[:, ALPHA].mean()) < 1 - _EVEN:
        shared["opacity_texture"] = Texture(image(looks[:, ALPHA]), "clamp")
    reflects = torch.cat((looks[:, OCCLUSION], looks[:, ROUGHNESS], looks[:, METALLIC]), 1)
    if all(map(_is_even, reflects[:, 1:].split(1, 1))):
        shared["roughness"], shared["metallic"] = reflects[:, 1:].mean(0).tolist()
    else:
        shared |= {"roughness": 1.0, "metallic": 1.0, "metallic_roughness_texture": Texture(image(reflects), "clamp")}
    if not _is_even(reflects[:, :1]) or float(reflects[:, 0].mean()) < 1 - _EVEN:
        texture = shared.get("metallic_roughness_texture")
        shared["occlusion_texture"] = texture or Texture(image(reflects[:, :1].expand(-1, 3)), "clamp")
    brightest = float(looks[:, EMISSION].max())
    if brightest > _EVEN:
        scale = max(1.0, brightest)
        glow = linear_to_srgb((looks[:, EMISSION] / scale).clamp(min=0))
        shared |= {"emissive": (scale,) * 3, "emissive_texture": Texture(image(glow), "clamp")}
    mapped = tangent_normals(mesh, layout, looks[:, NORMAL])
    shared["normal_texture"] = Texture(image(0.5 + 0.5 * mapped), "clamp")

    materials, index = _materials(source, kinds, shared)
    return mesh.replace(images=(image(looks[:, COLOR]),), materials=materials, material_index=index)


def _materials(source: UVMesh, kinds: Tensor, shared: dict[str, Any]) -> tuple[tuple[Material, ...], Tensor]:
    """Make a material for each combination of alpha mode, sides and lighting in the original."""
    made: dict[Any, int] = {}
    materials: list[Material] = []
    index = torch.zeros_like(kinds, dtype=torch.int64)
    for number in kinds.unique().tolist():
        old = source.materials[number]
        key = tuple(getattr(old, name) for name in _KEPT)
        if key not in made:
            made[key] = len(materials)
            kept = {name: getattr(old, name) for name in _KEPT}
            materials.append(Material(old.name, **(shared | kept)))
        index[kinds == number] = made[key]
    return tuple(materials), index


def filled(layout: Layout, values: Tensor) -> Tensor:
    """Make an image [size, size, C] of values [N, C]; texels without a face are filled from their surroundings."""
    shown = layout.shown[None, None]
    parts = layout.image(values).movedim(2, 0)[:, None, None]  # one channel at a time, to save memory
    return torch.stack([pull_push(part, shown)[0, 0] for part in parts], -1)


def tangent_normals(mesh: UVMesh, layout: Layout, normals: Tensor) -> Tensor:
    """Express unit normals [N, 3] of texels in the tangent space of the mesh, [N, 3] with z ≥ 0."""
    tangents = mesh.tangents
    if tangents is None or mesh.normals is None:
        raise ValueError("mesh: expected normals and tangents, got none")
    result = torch.empty_like(normals)
    for start in range(0, len(normals), _CHUNK):
        part = slice(start, start + _CHUNK)
        face, weights = layout.faces[part], layout.weights[part].clamp(0, 1)
        n = functional.normalize(mixed(mesh.normals, face, weights), dim=-1)
        t = mixed(tangents, face, weights)
        along, sign = functional.normalize(t[:, :3], dim=-1), torch.where(t[:, 3:] < 0, -1.0, 1.0)
        frame = torch.stack((along, sign * torch.linalg.cross(n, along, dim=-1), n), 2)  # columns
        frame = frame + 1e-6 * torch.eye(3)
        local = torch.linalg.solve(frame, normals[part, :, None])[..., 0]
        local[:, 2] = local[:, 2].clamp(min=0.05)
        result[part] = functional.normalize(local, dim=-1)
    return result


def with_frames(vertices: Tensor, faces: Tensor, uv: Tensor) -> UVMesh:
    """Make a white mesh with normals and tangents of its corners."""
    normals = corner_normals(vertices, faces)
    tangents = corner_tangents(vertices, faces, uv, normals)
    white = torch.ones(2, 2, 3)
    return UVMesh(vertices, faces.int(), uv, white, wrap="clamp", normals=normals, tangents=tangents)


def _is_even(values: Tensor) -> bool:
    return bool(values.amax() - values.amin() < _EVEN) if values.numel() else True
