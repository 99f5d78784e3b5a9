"""The visible surface: point, normal and direction to the eye at every pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...base.one_line import OneLine
from ...camera import Camera
from ...camera.camera import rotation_and_position
from ...meshes.batch import mesh_parts
from ...meshes.normals import face_normals, vertex_normals
from ...raster.colors.edge_hashes import attribute_edge_hashes
from ...raster.faces import checked_faces, world_corners
from ...raster.fragments import Fragments
from .planes import planar, unit
from .shown import ShownPixels


@dataclass(frozen=True, eq=False, repr=False)
class VisibleSurface(OneLine):
    """The visible surface at each pixel of B images, for lights and reflection models.

    Where no face is visible, normals are 0 and the other values are undefined.

    Attributes:
        points: Points in world space, [B, H, W, 3] float32.
        normals: Unit normals of the visible side, [B, H, W, 3] float32: smooth ones, which may point away from the eye
            near a silhouette.
        views: Unit vectors towards the eye, [B, H, W, 3] or [B, 1, 1, 3] float32.
        sides: [B, H, W, 1] float32: 1 where the front of a face is visible, the side of (v1 − v0) × (v2 − v0), and −1
            where its back is, with the opposite normal.

    Raises:
        TypeError, ValueError: In `of`, an argument that does not fit.

    Example:
        >>> fragments = nr.fragments(mesh, camera, 64)
        >>> surface = nr.VisibleSurface.of(fragments, mesh, camera)
        >>> facing = (surface.normals * surface.views).sum(-1, keepdim=True)  # 1 in the middle of a sphere
        >>> image = fragments.composite(1 - facing, background=0.0)  # bright outlines
    """

    points: Tensor
    normals: Tensor
    views: Tensor
    sides: Tensor

    @classmethod
    def of(cls, fragments: Fragments, mesh: Any, camera: Camera) -> VisibleSurface:
        """Find the visible surface of a mesh, with smooth normals.

        Normals are those of the mesh (`UVMesh.normals`) or `vertex_normals`: shading is smooth across faces that share
        vertices, and has a crease where they do not (`merge_vertices` merges them). The back of a face has the opposite
        normal.

        Args:
            fragments: Fragments of this mesh and camera.
            mesh: As in `fragments`.
            camera: The camera of the fragments.

        Returns:
            The surface, differentiable in vertices, normals and camera.

        Raises:
            TypeError, ValueError: As `fragments`.

        Example:
            >>> fragments = nr.fragments(mesh, camera, 64)
            >>> nr.VisibleSurface.of(fragments, mesh, camera).normals.shape
            torch.Size([1, 128, 128, 3])
        """
        return surface_at(ShownPixels(fragments.face_index, packs=False), fragments, mesh, camera)

    def with_normals(self, normals: Tensor) -> VisibleSurface:
        """Return the surface with other normals.

        Args:
            normals: [B, H, W, 3] floating; they are normalised.

        Returns:
            The surface.

        Raises:
            TypeError, ValueError: A type or shape does not fit.

        Example:
            >>> surface = nr.VisibleSurface.of(nr.fragments(mesh, camera, 64), mesh, camera)
            >>> bumpy = surface.with_normals(surface.normals + 0.1 * torch.sin(40 * surface.points))
        """
        normals = validate.floating("normals", normals, tuple(self.points.shape)).float()
        return replace(self, normals=unit(planar(normals)))


def surface_at(
    shown: ShownPixels, fragments: Fragments, mesh: Any, camera: Camera, matt: bool = False
) -> VisibleSurface:
    """Find the visible surface of some pixels, as `VisibleSurface.of`; for ``matt`` ones, ``views`` is not computed."""
    vertices, faces, _ = mesh_parts(mesh)
    vertices, faces = validate.vertices(vertices).float(), checked_faces(faces)
    normals = _corner_normals(mesh, faces)
    if normals is None:
        smooth = vertex_normals(vertices, faces)
        points = vertices if vertices.dim() == 3 else vertices[None]
        both = torch.cat(torch.broadcast_tensors(points, smooth), -1)
        points, pointing = shown.pack(fragments.interpolate(both, fragments.triangles)).split(3, -1)
    else:
        points, pointing = (shown.pack(fragments.interpolate(values)) for values in (vertices, normals))
    eye = _eye(camera, points)
    views = unit(eye - points) if camera.perspective and not matt else eye
    sides = _sides(world_corners(vertices, faces, len(fragments.corners), True), camera)
    side = shown.pack(at_pixels(sides, fragments.face_index))
    return VisibleSurface(points, unit(pointing) * side, views, side)


def visible_normals(fragments: Fragments, mesh: Any, camera: Camera, smooth: bool) -> tuple[Tensor, Tensor | None]:
    """Compute only the unit normals of the visible sides, [B, H, W, 3]: smooth as in `VisibleSurface`, or of faces.

    Returns also those of the corners, [B, F, 3, 3], unless pixels normalise what they interpolate.
    """
    vertices, faces, _ = mesh_parts(mesh)
    vertices, faces = validate.vertices(vertices).float(), checked_faces(faces)
    corners = world_corners(vertices, faces, len(fragments.corners), in_range=True)
    sides = _sides(corners, camera)[:, :, None, None]
    if not smooth:
        of_corners = (-face_normals(corners)[:, :, None] * sides).expand(-1, -1, 3, -1)
        return fragments.interpolate(of_corners), of_corners
    normals = _corner_normals(mesh, faces)
    if normals is None:
        normals = world_corners(vertex_normals(vertices, faces), faces, len(sides), in_range=True)
    return unit(planar(fragments.interpolate(normals * sides))), None


def normal_edge_hashes(fragments: Fragments, mesh: Any, smooth: bool) -> Callable[[], Tensor] | None:
    """Return the function that hashes the normals of `visible_normals` along edges; None if they are continuous."""
    vertices, faces, _ = mesh_parts(mesh)
    if smooth:
        normals = _corner_normals(mesh, faces)
        return None if normals is None else lambda: attribute_edge_hashes(normals)

    def of_faces() -> Tensor:
        corners = world_corners(vertices.detach().float(), faces, len(fragments.corners), in_range=True)
        return attribute_edge_hashes(face_normals(corners)[:, :, None].expand(-1, -1, 3, -1))

    return of_faces


def _corner_normals(mesh: Any, faces: Tensor) -> Tensor | None:
    """Return a mesh's own normals as [1 or B, F, 3, 3], or None."""
    normals = getattr(mesh, "normals", None)
    if normals is None:
        return None
    return validate.floating("normals", normals if normals.dim() == 4 else normals[None], ("B", faces.shape[-2], 3, 3))


def at_pixels(values: Tensor, face_index: Tensor) -> Tensor:
    """Look up values [B, F] of the visible faces [B, H, W]: [B, H, W, 1], 0 where no face is visible."""
    batch, count = values.shape
    padded = torch.cat((values, values.new_zeros(batch, 1)), 1)
    index = face_index.flatten(1).long() % (count + 1)
    return padded.expand(len(index), -1).gather(1, index).view(*face_index.shape, 1)


def _eye(camera: Camera, like: Tensor) -> Tensor:
    """Return the position of the eye, or for orthographic cameras the unit vector towards it, [B, 1, 1, 3]."""
    rotation, position = rotation_and_position(camera, like)
    return (position if camera.perspective else -rotation[:, 2])[:, None, None]


def _sides(corners: Tensor, camera: Camera) -> Tensor:
    """Return +1 where a face's front, the side of (v1 − v0) × (v2 − v0), is visible, else −1; [B, F], no gradient."""
    v0, v1, v2 = corners.detach().unbind(2)
    normals = torch.linalg.cross(v1 - v0, v2 - v0, dim=-1)
    eye = _eye(camera, corners).detach()[:, 0]
    towards = eye - v0 if camera.perspective else eye
    return torch.where((normals * towards).sum(-1) < 0, -1.0, 1.0)
