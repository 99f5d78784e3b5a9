"""glTF files as arrays: the vertices and faces of a scene, their colours and materials, and the rig that moves them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..files import fits_float32
from ..surface_colors import SurfaceColors, linear_to_srgb
from .accessors import Accessors, Resolve
from .container import parsed
from .extensions import checked_extensions
from .nodes import Nodes, instances
from .primitives import DISPLAY, NUMBER, Primitive, Primitives, checked_positions, default_weights
from .rig_reader import RigFile, RigReader
from .skins import Skins, moved, turned_over
from .surfaces.materials import GltfMaterial, Slot
from .surfaces.pictures import Pictures
from .tree import GltfError, dicts

_LEAST_LIMIT = 1 << 24  # vertices and faces that any file may have
_PER_BYTE = 16  # and for each byte of its buffers: instances, and nodes that share a mesh, multiply them
_BLACK = 0.75  # share of black vertices that causes a warning; COLOR_0 of some avatars is no colour
_EACH = 64  # vertices and faces that take as much time as one more primitive
_SKINNED = 5  # vertices without a skin that take as much memory as one with it


@dataclass(eq=False)
class Block:
    """Vertices of a scene: those of a primitive at a node, or at one of its instances."""

    node: int
    instance: np.ndarray | None  # [4, 4], before the transform of the node
    primitive: Primitive
    weights: tuple[float, ...]  # of morph targets at rest
    motion: np.ndarray  # [4, 4] or [V, 4, 4], to the world at rest
    start: int  # number of its first vertex


class GltfReader:
    """Reader of a file with this ``content``; ``resolve`` reads the files that its JSON names.

    Raises GltfError for files that are damaged or need what is not read.
    """

    def __init__(self, content: bytes, resolve: Resolve) -> None:
        self._tree, binary = parsed(content)
        self.warnings = [sentence for sentence in (checked_extensions(self._tree),) if sentence]
        self._arrays = Accessors(self._tree, binary, resolve)
        self._nodes = Nodes(self._tree)
        self._primitives = Primitives(self._tree, self._arrays)
        self._skins = Skins(self._tree, self._arrays, self._nodes, self._primitives)
        self._pictures = Pictures(self._tree, self._arrays, resolve)
        self._materials: dict[Any, GltfMaterial] = {}

    def read(self, materials: bool, rigged: bool) -> tuple[np.ndarray, np.ndarray, SurfaceColors, RigFile | None]:
        """Read vertices [V, 3] float64, faces [F, 3] int64, colours with materials or without, and the rig.

        With a rig, vertices and normals are those of the meshes, before nodes and joints move them.
        """
        drawn = list(self._drawn())
        blocks = list(dict.fromkeys(block for block, _ in drawn))
        if not sum(len(primitive.faces) for _, primitive in drawn):
            known = sum(block.primitive.count for block in blocks)
            left = self._primitives.left_out()
            raise GltfError(f"expected faces, got {known} vertices but no faces{f'; {left}' if left else ''}")
        points = np.concatenate([self._positions(block, rigged) for block in blocks])
        for _, primitive in drawn:
            self._material(primitive.entry.get("material"))
        for material in self._materials.values():
            material.make()
        faces, surfaces = [], []
        for block, primitive in drawn:
            flips = turned_over(block.motion)
            order = [0, 2, 1] if flips else [0, 1, 2]  # mirroring turns faces inside out
            corners = primitive.faces[:, order]
            faces.append(corners + block.start)
            motion = np.eye(4) if rigged else block.motion
            surfaces.append(self._surface(primitive, block, corners, motion, materials, flips and not rigged))
        corners, surface = np.concatenate(faces), SurfaceColors.joined(surfaces)
        rig = None
        if rigged:
            rig = RigReader(self._tree, self._arrays, self._nodes, self._primitives, self._skins).read(blocks)
        numbers = [self._primitives.attribute(block.primitive, NUMBER) for block in blocks]
        kept, corners = _join_numbered(points, corners, numbers)
        if rig is not None:
            rig.keep(kept)
        self.warnings += [said for said in (self._primitives.left_out(),) if said]
        self.warnings += self._pictures.warnings
        return points[kept], corners, surface, rig

    def _drawn(self) -> Iterator[tuple[Block, Primitive]]:
        """Iterate over the primitives that the scene draws, with the vertices that they share."""
        known: dict[Any, Block] = {}
        vertices, taken, limit = 0, 0, _LEAST_LIMIT
        for node, mesh in self._meshes():
            entry = self._nodes.entries[node] if node >= 0 else {}
            copies = instances(entry, self._arrays)
            for place in range(1 if copies is None else len(copies)):
                for primitive in self._primitives.of_mesh(mesh):
                    key = (node, place, primitive.shared)
                    own_vertices = 0 if key in known else primitive.count
                    taken += _EACH + len(primitive.faces) + own_vertices * (_SKINNED if "skin" in entry else 1)
                    if taken > limit:
                        limit = max(limit, _PER_BYTE * self._arrays.size())
                    if taken > limit:
                        raise GltfError(f"expected at most {limit} vertices and faces in a scene, got more")
                    if key not in known:
                        frames = None if copies is None else copies[place]
                        known[key] = self._block(node, entry, frames, primitive, vertices)
                        vertices += own_vertices
                    yield known[key], primitive

    def _meshes(self) -> Iterator[tuple[int, int]]:
        """Iterate over the nodes that have a mesh, and its number; without nodes over all meshes, at node −1."""
        if not self._nodes.entries:
            yield from ((-1, number) for number in range(len(dicts(self._tree, "meshes"))))
        for node in self._nodes.drawn():
            if "mesh" in self._nodes.entries[node]:
                yield node, self._nodes.entries[node]["mesh"]

    def _block(
        self, node: int, entry: dict[str, Any], instance: np.ndarray | None, primitive: Primitive, start: int
    ) -> Block:
        weights = default_weights(entry, primitive.mesh, len(dicts(primitive.entry, "targets")))
        if "skin" in entry:
            motion = self._skins.motions(entry["skin"], primitive)
        else:
            motion = self._nodes.world(node) if node >= 0 else np.eye(4)
            motion = motion if instance is None else motion @ instance
        return Block(node, instance, primitive, weights, motion, start)

    def _positions(self, block: Block, rigged: bool) -> np.ndarray:
        primitive = block.primitive
        weights = () if rigged else block.weights
        points = self._primitives.at_rest(primitive, "POSITION", weights, 3)
        points = checked_positions(primitive.what, np.zeros((0, 3)) if points is None else points)
        return points if rigged else checked_positions(primitive.what, moved(points, block.motion))

    def _material(self, number: Any) -> GltfMaterial:
        key = number if isinstance(number, int) else None
        if key not in self._materials:
            self._materials[key] = GltfMaterial(self._tree, number, self._pictures)
        return self._materials[key]

    def _surface(
        self, primitive: Primitive, block: Block, corners: np.ndarray, motion: np.ndarray, materials: bool, flips: bool
    ) -> SurfaceColors:
        """Collect the colours of a primitive, and with ``materials`` its material, normals and tangents."""
        surface = SurfaceColors.plain(len(corners), 1.0)
        material = self._material(primitive.entry.get("material"))
        base = material.base or Slot()
        uv = self._coordinates(primitive, block, base.uv_set)
        if uv is not None:
            uv = base.transformed(uv)
            surface.uv[:] = np.where(fits_float32(uv), uv, 0)[corners]
        if material.image is not None and uv is not None:
            across, down = base.wrap
            wrap = across if across == down else base.wrap
            surface.paint(slice(None), material.image, surface.uv, wrap)
        else:
            surface.colors[:] = material.color
        if material.image is not None and uv is None:
            self._say(f"{primitive.what} has a texture and no texture coordinates, so the texture is left out")
        surface.tints = self._tints(primitive, block, corners)
        extras = primitive.entry.get("extras")
        if isinstance(extras, dict) and extras.get(DISPLAY) is True and surface.tints is not None:
            surface.colors = linear_to_srgb(surface.tints[..., :3].astype(np.float64) * material.factor[:3])
            surface.colors, surface.tints = surface.colors.astype(np.float32), None
        if materials:
            surface.materials = [material.arguments]
            surface.material = np.zeros(len(corners), np.int64)
            if material.further:
                sets = [self._coordinates(primitive, block, number) for number in material.further]
                known = [np.zeros((len(corners), 3, 2)) if other is None else other[corners] for other in sets]
                surface.uv1 = np.concatenate(known, 2)
            self._add_directions(surface, primitive, block, corners, motion, flips)
        elif material.arguments["unlit"]:
            self._say(
                "it has unlit materials, which texture cubes do not keep: UVMesh does, and light=None draws all so"
            )
        return surface

    def _coordinates(self, primitive: Primitive, block: Block, number: int) -> np.ndarray | None:
        """Read a set of texture coordinates [V, 2] with v up, those beyond float32 as 0."""
        uv = self._primitives.at_rest(primitive, f"TEXCOORD_{number}", block.weights, 2)
        if uv is None:
            return None
        uv = uv.astype(np.float64)
        uv = np.where(fits_float32(uv), uv, 0)
        return np.stack((uv[:, 0], 1 - uv[:, 1]), -1)

    def _tints(self, primitive: Primitive, block: Block, corners: np.ndarray) -> np.ndarray | None:
        """Read the colours of vertices, linear RGBA in [0, 1], [F, 3, 4] float32; None if they change nothing."""
        colors = self._primitives.at_rest(primitive, "COLOR_0", block.weights, 3, 4)
        if colors is None:
            return None
        if colors.dtype.kind in "iu":
            raise GltfError(f"{primitive.what}: expected floats or normalised numbers as COLOR_0, got others")
        colors = np.nan_to_num(colors.astype(np.float64)).clip(0, 1)
        if colors.shape[1] == 3:
            colors = np.concatenate((colors, np.ones_like(colors[:, :1])), 1)
        if (colors == 1).all():
            return None
        black = len(colors) - np.count_nonzero(colors[:, :3].any(1))
        if black > _BLACK * len(colors):
            where = "everywhere" if black == len(colors) else f"at {black} of {len(colors)} vertices"
            self._say(f"COLOR_0 of {primitive.what} is black {where}, so that what it multiplies is black")
        return colors.astype(np.float32)[corners]

    def _add_directions(
        self,
        surface: SurfaceColors,
        primitive: Primitive,
        block: Block,
        corners: np.ndarray,
        motion: np.ndarray,
        flips: bool,
    ) -> None:
        """Set normals and tangents, transformed with the vertices. Those without a direction become 0."""
        weights = block.weights if motion is block.motion else ()
        normals = self._primitives.at_rest(primitive, "NORMAL", weights, 3)
        tangents = self._primitives.at_rest(primitive, "TANGENT", weights, 4)
        linear = motion[..., :3, :3]
        if normals is not None:
            turned = moved(_finite(normals), cofactors(linear))
            surface.normals = _unit(-turned if flips else turned).astype(np.float32)[corners]
        if tangents is not None:
            tangents = _finite(tangents)
            sign = np.where(tangents[:, 3:] < 0, -1.0, 1.0) * (-1 if flips else 1)
            directions = np.concatenate((_unit(moved(tangents[:, :3], linear)), sign), -1)
            surface.tangents = directions.astype(np.float32)[corners]

    def _say(self, sentence: str) -> None:
        if sentence not in self.warnings:
            self.warnings.append(sentence)


def cofactors(linear: np.ndarray) -> np.ndarray:
    """Return the matrices that turn normals [..., 3, 3]: the cross products of the rows, det · inverse transpose."""
    a, b, c = (linear[..., row, :] for row in range(3))
    return np.stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)), -2)


def _join_numbered(points: np.ndarray, corners: np.ndarray, numbers: list[Any]) -> tuple[Any, np.ndarray]:
    """Merge vertices that `glb_bytes` has duplicated: which are kept, and the faces.

    ``numbers`` are those of the vertices of each block.
    """
    if any(part is None or part.size != len(part) for part in numbers):
        return slice(None), corners
    joined = np.concatenate([part.reshape(-1) for part in numbers])
    _, first, inverse = np.unique(joined, return_index=True, return_inverse=True)
    same = np.array_equal(points[first][inverse], points)  # or another program has changed the file
    return (first, inverse[corners]) if same else (slice(None), corners)


def _finite(values: np.ndarray) -> np.ndarray:
    values = values.astype(np.float64)
    return np.where(fits_float32(values), values, 0)


def _unit(directions: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(directions, axis=-1, keepdims=True)
        unit = directions / np.where(length > 0, length, 1)
    return np.where(np.isfinite(unit), unit, 0)
