"""`KeptCharts`: fewer faces with the charts, materials and images of the original."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional

from ...meshes.pieces import merged_vertices
from ...meshes.uv_mesh import UVMesh
from ...shading.pixels.normal_maps import corner_tangents
from ...textures.material import Material, Texture
from ..common.geometry.edges import areas, connected_components
from ..common.geometry.nearest import NearestFaces
from .source import Source, mixed
from .surface.clean import CleanMesh
from .surface.decimate import FEW_BORDERS, collapse
from .surface.folds import without_folds
from .transfer import averaged_normals

_APART = 8.0  # distance of the boxes of two charts, [-1, 1]³, in the search: more than any point is from its own chart
_JUMP = 4.0  # distance in an image that a point may move, relative to that on the surface
_INWARD = 0.05  # share of the way from a corner to the middle of its face, where the face's side of a crease is
_CREASE = 0.9  # cosine of the angle between normals of a vertex beyond which they are not averaged
_BORDER_POINTS = 8  # samples of an edge between materials that vertices may move to
_CORNERS = ("uv", "uv1", "colors", "tints")  # attributes of corners that are interpolated


class KeptCharts:
    """The charts of a clean mesh: reduces its faces, and gives corners the attributes of the original.

    A chart is a connected part of the surface with continuous texture coordinates and one material. ``source`` has the
    faces of the clean surface; ``box`` is its centre and half of its longest side, ``size`` the longest side of the
    images, or None.
    """

    def __init__(self, source: Source, surface: CleanMesh, box: tuple[Tensor, float], size: int | None) -> None:
        self._source, self._mesh = source, source.mesh
        self._center, self._half = box
        self._welded, corners = split_at_seams(self._mesh, surface.faces)
        self._points = (surface.vertices.double()[self._welded] - self._center) / self._half
        self._corners = corners
        kinds = _kinds_of_faces(self._mesh)
        self._kind = torch.empty(len(self._points), dtype=torch.int64)
        self._kind[corners.reshape(-1)] = kinds.repeat_interleave(3)
        coordinates = _coordinates(self._mesh)
        self._coordinates = coordinates.new_empty(len(self._points), coordinates.shape[2])
        self._coordinates[corners.reshape(-1)] = coordinates.flatten(0, 1)
        self._chart = torch.zeros(len(self._points), dtype=torch.int64)
        self._chart[corners.reshape(-1)] = connected_components(corners).repeat_interleave(3)
        placed = self._points + self._offsets(self._chart)
        self._search = NearestFaces(placed.float(), corners)
        self._everywhere = NearestFaces(self._points.float(), corners)
        self._scale = self._image_scale()
        self._images = _resized(self._mesh, size)

    def reduced(self, count: int) -> UVMesh:
        """Make a mesh of about ``count`` faces.

        Edges collapse in the order of quadric errors, by the library opengl_decimate. Seams stay seams, and the borders
        of materials stay where they are, if they are short. The new corners have the attributes of the closest point in
        their chart.
        """
        if len(self._corners) <= count:
            points, faces, copies = self._points, self._corners, torch.arange(len(self._points))
        else:
            points, faces, copies = self._collapsed(count)
        rows, welded = merged_vertices(points, faces, 0.0)
        whole = (welded != welded.roll(1, 1)).all(1)
        faces, welded = faces[whole], welded[whole]
        copies, points = copies[faces], points[rows]
        if not self._has_short_borders(count):
            points = without_folds(points, self._on_borders(points, welded, copies), welded)
        return self._dressed((self._center + self._half * points).float(), welded, copies)

    def _on_borders(self, points: Tensor, faces: Tensor, copies: Tensor) -> Tensor:
        """Move vertices [V, 3] between materials, which slide as edges collapse, back to the original's borders.

        ``faces`` [F, 3] and ``copies`` [F, 3], the vertices of the original that the corners were, identify them:
        those between two materials go to the closest point of the border of these, those between more to their origin.
        """
        moved = points.clone()
        places, between = self._borders
        if not len(places):
            return moved
        pairs = torch.unique(torch.stack((faces.reshape(-1), self._kind[copies.reshape(-1)]), 1), dim=0)
        vertex, kind = pairs.unbind(1)
        sides = torch.bincount(vertex, minlength=len(points))
        begin = sides.cumsum(0) - sides
        origin = torch.empty_like(points)
        origin[faces.reshape(-1)] = self._points[copies.reshape(-1)]
        moved[sides > 2] = origin[sides > 2]
        two = torch.nonzero(sides == 2)[:, 0]
        wanted = torch.cat((points[two], _APART * kind[begin[two][:, None] + torch.arange(2)].double()), 1)
        known = cKDTree(torch.cat((places, _APART * between.double()), 1).numpy())
        distance, row = (torch.from_numpy(part) for part in known.query(wanted.numpy()))
        near = distance < _APART / 2  # a border of the same materials
        moved[two[near]] = places[row[near].long()]
        return moved

    @functools.cached_property
    def _border_edges(self) -> tuple[Tensor, Tensor]:
        """The edges between two materials or images, as vertices of one and of the other side: [E, 2] each."""
        sides = torch.cat([self._corners[:, [first, (first + 1) % 3]] for first in range(3)])
        low, high = self._welded[sides].aminmax(dim=1)
        key, order = torch.sort(low * (int(self._welded.max()) + 1) + high, stable=True)
        same = torch.nonzero(key[1:] == key[:-1])[:, 0]
        first, second = sides[order[same]], sides[order[same + 1]]
        apart = self._kind[first[:, 0]] != self._kind[second[:, 0]]
        return first[apart], second[apart]

    @functools.cached_property
    def _borders(self) -> tuple[Tensor, Tensor]:
        """Points [N, 3] of the edges between two materials or images, and the numbers [N, 2] of these."""
        first, second = self._border_edges
        kinds = torch.stack((self._kind[first[:, 0]], self._kind[second[:, 0]]), 1).sort(1).values
        shares = ((torch.arange(_BORDER_POINTS) + 0.5) / _BORDER_POINTS).double()[:, None]
        start, end = self._points[first].unbind(1)
        places = torch.lerp(start[:, None], end[:, None], shares).reshape(-1, 3)
        return places, kinds.repeat_interleave(_BORDER_POINTS, 0)

    def _has_short_borders(self, count: int) -> bool:
        """Return whether ``count`` faces suffice to keep the borders of materials exactly."""
        return len(self._border_edges[0]) < FEW_BORDERS * count

    def _collapsed(self, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """Reduce the faces: points [N, 3], faces [F, 3], and the vertex of the original that each point was."""
        charts = torch.cat((self._coordinates.double(), self._chart[:, None].double()), 1)  # a material's border, too
        attributes = {
            "TEXCOORD_0": charts.numpy(),
            "_COPY": np.arange(len(self._points), dtype=np.float64)[:, None],
        }
        # On flat parts the move of a border costs no quadric error.
        locked = torch.cat(self._border_edges).unique().tolist() if self._has_short_borders(count) else None
        carried, faces = collapse(self._points.numpy(), self._corners.numpy(), count, False, attributes, locked)
        copies = torch.from_numpy(carried["_COPY"].reshape(-1).astype(np.int64))
        return torch.from_numpy(carried["POSITION"].astype(np.float64)), torch.from_numpy(faces), copies

    def _dressed(self, vertices: Tensor, faces: Tensor, copies: Tensor) -> UVMesh:
        """Give faces [F, 3] the attributes of the original; ``copies`` [F, 3] are the vertices that corners were."""
        places = ((vertices.double() - self._center) / self._half)[faces]
        charts = self._charts_of_faces(places, self._chart[copies])
        own, copies = charts.repeat_interleave(3), copies.reshape(-1)
        face, weights = self._closest(places.view(-1, 3), own)
        carried = self._coordinates[copies]
        jumps = (self._chart[copies] == own) & self._jumps(face, weights, places.view(-1, 3), copies)
        attributes: dict[str, Any] = {}
        for name in _CORNERS:
            values = getattr(self._mesh, name)
            if values is not None:
                attributes[name] = mixed(values.detach(), face, weights).view(len(faces), 3, -1)
        kept = {"uv": carried[:, :2], "uv1": carried[:, 2:]}
        for name in {"uv", "uv1"} & set(attributes):
            values = attributes[name].view(len(carried), -1)
            attributes[name] = torch.where(jumps[:, None], kept[name], values).view(len(faces), 3, -1)
        pulled = torch.lerp(places, places.mean(1, keepdim=True).expand(-1, 3, -1), _INWARD)
        near, shares = self._closest(pulled.view(-1, 3), own)
        directions = mixed(self._source.normals, near, shares).view(len(faces), 3, 3)
        size = areas(vertices[faces])[:, None, None]
        attributes["normals"] = averaged_normals(size * functional.normalize(directions, dim=-1), faces, _CREASE)
        first = face.view(-1, 3)[:, 0]
        attributes |= {name: getattr(self._mesh, name)[first] for name in ("image_index", "material_index")}
        mesh = self._mesh.replace(vertices=vertices, faces=faces.int(), tangents=None, **attributes, **self._images)
        return self.framed(mesh, vertices)

    def framed(self, mesh: UVMesh, vertices: Tensor) -> UVMesh:
        """Move the vertices of a result, with tangents that fit, if the original has any or a map of normals."""
        mesh = mesh.replace(vertices=vertices)
        if self._mesh.tangents is None and not any(one.normal_texture for one in mesh.materials):
            return mesh
        return mesh.replace(tangents=corner_tangents(vertices, mesh.faces, mesh.uv, mesh.normals))

    def _charts_of_faces(self, places: Tensor, carried: Tensor) -> Tensor:
        """Choose the chart [F] of faces with corners [F, 3, 3] that were in charts [F, 3].

        It is that of two corners or that of the closest face, whichever is nearer to the corners and the middle: the
        seams of a narrow chart may have met.
        """
        middle = places.mean(1)
        points = torch.cat((places, middle[:, None]), 1)
        first = torch.where(carried[:, 1] == carried[:, 2], carried[:, 1], carried[:, 0])
        face, _ = self._everywhere.closest(middle.float())
        second = self._chart[self._corners[face, 0]]
        distances = [self._distances(points, charts) for charts in (first, second)]
        return torch.where(distances[1] < distances[0], second, first)

    def _distances(self, points: Tensor, charts: Tensor) -> Tensor:
        """Sum the squared distances of points [F, N, 3] from charts [F]."""
        flat = points.flatten(0, 1)
        face, weights = self._closest(flat, charts.repeat_interleave(points.shape[1]))
        found = torch.einsum("nk,nkc->nc", weights.double(), self._points[self._corners[face]])
        return (found - flat).square().sum(1).view(points.shape[:2]).sum(1)

    def _closest(self, points: Tensor, charts: Tensor) -> tuple[Tensor, Tensor]:
        """Find the closest points of charts [N]: faces and weights."""
        return self._search.closest((points + self._offsets(charts)).float())

    def _offsets(self, charts: Tensor) -> Tensor:
        """Place charts [N] on a lattice, so that one search serves all: their offsets [N, 3]."""
        side = max(1, round(len(self._chart.unique()) ** (1 / 3) + 0.5))
        cell = torch.stack((charts % side, charts // side % side, charts // side**2), 1)
        return _APART * (cell - (side - 1) / 2).double()

    def _image_scale(self) -> Tensor:
        """Compute the scale of each chart: length in the image over length on the surface."""
        count = int(self._chart.max()) + 1
        own = self._chart[self._corners[:, 0]]
        flat = areas(functional.pad(self._coordinates[self._corners][..., :2], (0, 1))).double()
        solid = areas(self._points[self._corners])
        sums = [torch.zeros(count, dtype=torch.float64).index_add(0, own, part) for part in (flat, solid)]
        return (sums[0] / sums[1].clamp(min=1e-30)).sqrt()

    def _jumps(self, face: Tensor, weights: Tensor, points: Tensor, copies: Tensor) -> Tensor:
        """Find the points [N] whose closest point lies across a seam of the same chart, far away in the image."""
        uv = torch.einsum("nk,nkc->nc", weights, self._coordinates[self._corners[face]])[:, :2]
        moved = (points - self._points[copies]).norm(dim=1)
        scale = self._scale[self._chart[copies]]
        return (uv - self._coordinates[copies][:, :2]).norm(dim=1) > _JUMP * scale * moved + 1e-6


def split_at_seams(mesh: UVMesh, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Give each vertex a copy for each of its texture coordinates and materials.

    ``faces`` [F, 3] are those of the mesh with merged vertices. Returns the vertex [N] of each copy, and the faces
    [F, 3] in copies.
    """
    group = faces.reshape(-1)
    pairs = _coordinates(mesh).flatten(0, 1).contiguous().view(torch.int64).unbind(1)  # u and v as one number
    for key in (_kinds_of_faces(mesh).repeat_interleave(3), *pairs):
        number = torch.unique(key, return_inverse=True)[1]
        group = torch.unique(group * (int(number.max()) + 1) + number, return_inverse=True)[1]
    copies = torch.empty(int(group.max()) + 1, dtype=torch.int64)
    copies[group] = faces.reshape(-1)
    return copies, group.view(-1, 3)


def has_charts(mesh: Any) -> bool:
    """Return whether a face of a mesh covers an area of its image."""
    return isinstance(mesh, UVMesh) and bool(areas(functional.pad(mesh.uv.detach(), (0, 1))).any())


def _kinds_of_faces(mesh: UVMesh) -> Tensor:
    """Number the pairs of a material and an image that faces [F] have."""
    materials = mesh.image_index if mesh.material_index is None else mesh.material_index
    return torch.unique(materials * (len(mesh.images) + 1) + mesh.image_index, return_inverse=True)[1]


def _coordinates(mesh: UVMesh) -> Tensor:
    """Return all texture coordinates of the corners, [F, 3, 2 K]."""
    parts = [mesh.uv] if mesh.uv1 is None else [mesh.uv, mesh.uv1]
    return torch.cat([part.detach().float() + 0.0 for part in parts], -1)  # + 0 converts −0 to 0


def _resized(mesh: UVMesh, size: int | None) -> dict[str, Any]:
    """Shrink images and textures of materials whose longest side exceeds ``size``; each image once."""
    done: dict[int, Tensor] = {}

    def small(image: Tensor) -> Tensor:
        height, width = image.shape[:2]
        if size is None or max(height, width) <= size:
            return image
        if id(image) not in done:
            shape = [max(1, round(side * size / max(height, width))) for side in (height, width)]
            pixels = image.detach().float().movedim(2, 0)[None]
            found = functional.interpolate(pixels, shape, mode="bilinear", antialias=True)
            done[id(image)] = found[0].movedim(0, 2).contiguous()
        return done[id(image)]

    def lighter(texture: Texture) -> Texture:
        return replace(texture, image=small(texture.image))

    def of_material(one: Material) -> Material:
        textures: dict[str, Any] = {name: lighter(texture) for name, texture in one.textures().items()}
        return replace(one, **textures)

    return {"images": tuple(map(small, mesh.images)), "materials": tuple(map(of_material, mesh.materials))}
