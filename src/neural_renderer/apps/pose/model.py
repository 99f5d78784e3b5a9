"""A known mesh rendered in a batch of poses, under unknown light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ...camera import Camera, rotations
from ...meshes.mesh import Mesh
from ...meshes.normals import vertex_normals
from ...meshes.uv_mesh import UVMesh
from ...raster.fragments import Fragments
from ...rendering.deferred import fragments
from ...shading.spherical_harmonics import harmonics
from ...textures.albedo import tinted_by_materials
from ...textures.color_space import tinted
from ...textures.sample_texture import sample_texture
from .target import Crop

_NEAR, _FAR = 0.02, 1e4  # clipping planes, in radii of the object
_CELLS = 96.0  # cells across the object in the first grid that merges vertices
_COARSER, _FEWEST = 0.75, 1 / 4  # factors of the cells of the next grid, and of those of the last
_AWAY = 0.3  # cosine with the direction of view, above which a normal is wrong and turned around
_MOST_ZOOM, _LEAST_DEPTH = 1.5, 1.1  # bounds of the logarithm of a change of focal length, and of depths
RIDGE = 1e-3
"""Ridge of the light's least squares, relative to the mean square of a column."""


@dataclass(frozen=True, eq=False)
class Poses:
    """B poses of an object of radius 1 around the origin, in the space of a camera: x right, y down, z forward.

    Attributes:
        rotation: [B, 3, 3].
        place: [B, 3]: x / z and y / z times the change of the focal length, and log of that change over z.
        zoom: [B, 1]: log of the change of the focal length.
    """

    rotation: Tensor
    place: Tensor
    zoom: Tensor

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, rows: Tensor | slice) -> Poses:
        return Poses(self.rotation[rows], self.place[rows], self.zoom[rows])

    def moved(self, step: Tensor) -> Poses:
        """Change the poses by [B, 6 or 7]: a turn in the camera's space in radians, a change of the place, and zoom."""
        rotation = rotations.from_axis_angle(step[:, :3])
        zoom = (self.zoom + step[:, 6:]).clamp(-_MOST_ZOOM, _MOST_ZOOM) if step.shape[1] == 7 else self.zoom
        place = self.place + step[:, 3:6]
        nearest = torch.minimum(place[:, 2:], zoom - math.log(_LEAST_DEPTH))
        return Poses(rotation @ self.rotation, torch.cat((place[:, :2], nearest), 1), zoom)

    def translation(self) -> Tensor:
        """Compute the place of the origin, [B, 3]."""
        depth = (-self.place[:, 2:]).exp()
        return torch.cat((self.place[:, :2] * depth, (self.zoom - self.place[:, 2:]).exp()), 1)

    def seen(self, crop: Crop, motion: Tensor) -> Camera:
        """Make the cameras of a crop in the world of the object; ``motion`` [3, 4] leads to the camera's space."""
        R = motion[:, :3] @ self.rotation
        t = self.translation() @ motion[:, :3].T + motion[:, 3]
        # K takes the place of a viewing angle of 45 degrees, with y up: this way one operator projects the corners.
        half = crop.size / 2
        flat = crop.K.new_tensor([[1 / half], [-1 / half], [1]]) * crop.K + crop.K.new_tensor(
            [[0, 0, -1], [0, 0, 1], [0, 0, 0]]
        )
        zoom = torch.cat((self.zoom.exp().expand(-1, 2), torch.ones_like(self.zoom)), 1)
        rows = flat * zoom[:, None] @ R
        origin = -(R.transpose(1, 2) @ t[:, :, None])[:, :, 0]
        return Camera(rows, origin, torch.zeros_like(origin), viewing_angle=45.0)

    @staticmethod
    def cat(parts: list[Poses]) -> Poses:
        """Concatenate batches."""
        return Poses(*(torch.cat([getattr(p, n) for p in parts]) for n in ("rotation", "place", "zoom")))


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh around the origin with radius 1.

    Attributes:
        center: [3], its centre in its own units.
        scale: Its radius in its own units.
        mesh: The mesh, moved and scaled.
        colors: [F, 3, 3] of the faces' corners; None for those of a UVMesh.
        normals: [F, 3, 3], smooth normals of the corners.
    """

    center: Tensor
    scale: float
    mesh: UVMesh | tuple[Tensor, Tensor]
    colors: Tensor | None
    normals: Tensor

    @classmethod
    def of(cls, mesh: Mesh | UVMesh | tuple[Tensor, Tensor]) -> Model:
        """Normalise a mesh."""
        vertices, faces = mesh[:2] if isinstance(mesh, tuple) else (mesh.vertices, mesh.faces)
        vertices = vertices.detach().float()
        if not len(faces):
            raise ValueError("mesh: expected faces, got none")
        used = vertices[faces.long().unique()]
        center = (used.amin(0) + used.amax(0)) / 2
        scale = float((used - center).norm(dim=1).max())
        if not scale > 0:
            raise ValueError("mesh: expected faces of a size above 0, got 0")
        vertices = (vertices - center) / scale
        normals = getattr(mesh, "normals", None)
        if normals is None:
            merged = Mesh(vertices, faces).merge_vertices(1e-5)
            normals = vertex_normals(merged.vertices, merged.faces)[0][merged.faces.long()]
        normals = normals.detach().float().contiguous()
        if isinstance(mesh, UVMesh):
            return cls(center, scale, mesh.replace(vertices=vertices), None, normals)
        colors = torch.ones(len(faces), 3, 3)
        if isinstance(mesh, Mesh):
            of_faces = mesh.colors_of_faces().detach()
            colors = of_faces if of_faces.dim() == 3 else of_faces.mean((1, 2, 3))[:, None].expand(-1, 3, -1)
        return cls(center, scale, (vertices, faces), colors.contiguous(), normals)

    @property
    def points(self) -> Tensor:
        """Vertices, [V, 3]."""
        return self.mesh.vertices if isinstance(self.mesh, UVMesh) else self.mesh[0]

    @property
    def faces(self) -> Tensor:
        """Corners of the faces, [F, 3]."""
        return self.mesh.faces if isinstance(self.mesh, UVMesh) else self.mesh[1]

    def coarse(self, least: int, most: int) -> Model:
        """Make a model for small pictures: about so many faces, with colours at their corners."""
        model = self
        if isinstance(model.mesh, UVMesh):
            model = model._baked(model.mesh, least)
        cells = _CELLS
        while len(model.faces) > most and cells > _FEWEST * _CELLS:
            _, cell = torch.unique((model.points * cells / 2).round().int(), dim=0, return_inverse=True)
            first = torch.zeros(int(cell.max()) + 1, dtype=torch.long).scatter_(0, cell, torch.arange(len(cell)))
            faces = first[cell][model.faces.long()]
            kept = (faces != faces.roll(1, 1)).all(1)
            colors = None if model.colors is None else model.colors[kept]
            model = replace(model, mesh=(model.points, faces[kept].int()), colors=colors, normals=model.normals[kept])
            cells *= _COARSER
        return model

    def _baked(self, mesh: UVMesh, least: int) -> Model:
        """Sample images at the corners of faces; few faces are subdivided first."""
        mesh = mesh.replace(normals=self.normals)
        while mesh.images and len(mesh.faces) < least:
            mesh = mesh.subdivide(1)
        colors = mesh.colors.clone()
        for index, (image, wrap) in enumerate(zip(mesh.images, mesh.wraps, strict=True)):
            rows = mesh.image_index == index
            colors[rows] = sample_texture(image, mesh.uv[rows][None], wrap=wrap)[0]
        face_index = torch.arange(len(colors), dtype=torch.int32)[None, :, None].expand(1, -1, 3)
        if mesh.tints is not None:
            colors = tinted(colors, mesh.tints[..., :3])
        colors = tinted_by_materials(colors[None], mesh.materials, mesh.material_index, face_index)[0]
        return replace(
            self,
            mesh=(mesh.vertices, mesh.faces),
            colors=colors,
            normals=mesh.normals if mesh.normals is not None else self.normals,
        )

    def fragments(self, poses: Poses, crop: Crop, motion: Tensor, anti_aliasing: bool = True) -> Fragments:
        """Rasterise the mesh in B poses."""
        shape = (self.points, self.faces)
        camera = poses.seen(crop, motion)
        return fragments(shape, camera, crop.size, near=_NEAR, far=_FAR, anti_aliasing=anti_aliasing)

    def surface(self, found: Fragments, poses: Poses, motion: Tensor) -> tuple[Tensor, Tensor]:
        """Find albedo [B, H, W, 3] and nine harmonics of the normal [B, H, W, 9] at the fragments' pixels."""
        if isinstance(self.mesh, UVMesh):
            albedo, normal = self.mesh.shade(found), found.interpolate(self.normals[None])
        else:
            albedo, normal = found.interpolate(torch.cat((self._own_colors, self.normals), -1)[None]).split(3, -1)
        return albedo, _harmonics(_turned(normal, poses, motion))

    def lit(self, found: Fragments, poses: Poses, motion: Tensor, light: Tensor) -> Tensor:
        """Draw the surface under light [B, 9, 3] that is computed at the corners of faces: [B, H, W, 3].

        There it does not change with the pose, so that derivatives cost no more than those of a colour.
        """
        normal = self.normals.flatten(0, 1).expand(len(poses), 1, -1, -1)
        lit = (_harmonics(_turned(normal, poses, motion))[:, 0] @ light).unflatten(1, (-1, 3))
        if isinstance(self.mesh, UVMesh):
            return self.mesh.shade(found) * found.interpolate(lit)
        return found.interpolate(self._own_colors * lit)

    @property
    def _own_colors(self) -> Tensor:
        return self.normals if self.colors is None else self.colors


def _turned(normal: Tensor, poses: Poses, motion: Tensor) -> Tensor:
    """Turn normals [B, H, W, 3] of the object to the viewer, and normalise them.

    They stay in the space of the object: light that turns with it is as general as light that does not.
    """
    forward = (motion[:, :3] @ poses.rotation)[:, 2]
    toward = (normal * forward[:, None, None]).sum(-1, keepdim=True)
    return F.normalize(torch.where(toward > _AWAY, -normal, normal), dim=-1)


def _harmonics(normal: Tensor) -> Tensor:
    """Evaluate spherical harmonics of order 2, divided by the constant one, [..., 9]."""
    return torch.stack(harmonics(normal), -1) * math.sqrt(4 * math.pi)


def fitted_light(albedo: Tensor, harmonics: Tensor, weights: Tensor, photo: Tensor) -> Tensor:
    """Fit the light (spherical harmonics of order 2) to a photo by linear least squares: [B, 9, 3].

    Args:
        albedo: [B, N, 3].
        harmonics: [B, N, 9].
        weights: [B, N], share of each pixel that the surface covers.
        photo: [N, 3], times these shares.
    """
    first = albedo * weights[..., None]
    columns = first[..., None, :] * harmonics[..., None]  # [B, N, 9, 3]
    gram = torch.einsum("bnic,bnjc->bcij", columns, columns)
    right = torch.einsum("bnic,bnc->bci", columns, photo.expand_as(albedo))
    ridge = RIDGE * gram[..., 0, 0][..., None, None].clamp(min=1e-6) * torch.eye(9)
    return torch.linalg.solve(gram + ridge, right[..., None])[..., 0].transpose(1, 2)
