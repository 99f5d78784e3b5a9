"""Primitives of a glTF file: their triangles, and attributes of their vertices with morph targets at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..files import fits_float32, short
from .accessors import Accessors
from .decoders import draco_mesh
from .tree import GltfError, child, dicts, extension, item, numbers, whole

NUMBER = "_NR_VERTEX"
"""Attribute of files of this package: the number of the vertex that was duplicated because it has several values."""
DISPLAY = "_NR_DISPLAY_COLORS"
"""Extra of primitives of this package: colours of vertices are interpolated as display values, not as linear light."""
_POINTS, _LINES = (0,), (1, 2, 3)
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(frozen=True, eq=False)
class Primitive:
    """Triangles of a mesh."""

    what: str  # its place, for messages
    entry: dict[str, Any]
    mesh: dict[str, Any]
    faces: np.ndarray  # [F, 3] int64
    count: int  # number of vertices
    packed: dict[str, np.ndarray]  # attributes that Draco had compressed, as stored, by their names

    @property
    def shared(self) -> tuple[Any, ...]:
        """What primitives with the same vertices have in common."""
        attributes = self.entry["attributes"]
        moved = [one.get("POSITION") for one in dicts(self.entry, "targets")]
        bound = sorted(
            (name, number) for name, number in attributes.items() if name.startswith(("JOINTS_", "WEIGHTS_"))
        )
        draco = id(self) if self.packed else 0
        return attributes["POSITION"], attributes.get(NUMBER), draco, str(moved), str(bound)


class Primitives:
    """The primitives of a file, which are read once each."""

    def __init__(self, tree: dict[str, Any], arrays: Accessors) -> None:
        self._tree, self._arrays = tree, arrays
        self._known: dict[int, list[Primitive]] = {}
        self.points = self.lines = self.unplaced = 0  # numbers of primitives that are left out

    def of_mesh(self, number: Any) -> Iterator[Primitive]:
        """Read the triangles of a mesh on demand; count its lines and points."""
        mesh, found = item(self._tree, "meshes", number), list[Primitive]()
        if number in self._known:
            yield from self._known[number]
            return
        for place, entry in enumerate(dicts(mesh, "primitives")):
            primitive = self._read(f"mesh {number}, primitive {place}", entry, mesh)
            if primitive is not None:
                found.append(primitive)
                yield primitive
        self._known[number] = found

    def left_out(self) -> str | None:
        """Say what was left out; None if nothing was."""
        counts = {"points": self.points, "lines": self.lines, "no positions": self.unplaced}
        said = [f"{count} primitive{'s' * (count > 1)} of {name}" for name, count in counts.items() if count]
        return f"{' and '.join(said)} {'is' if sum(counts.values()) == 1 else 'are'} left out" if said else None

    def attribute(self, primitive: Primitive, name: str, *widths: int) -> np.ndarray | None:
        """Read an attribute [V, N] of vertices; None if the primitive has none of this name."""
        number = primitive.entry["attributes"].get(name)
        if number is None:
            return None
        if name in primitive.packed:
            values = primitive.packed[name]
            if widths and values.shape[1] not in widths:
                raise GltfError(f"{primitive.what}: expected {widths[0]} numbers of {name}, got {values.shape[1]}")
            return self._arrays.floats(number, values)
        return _as_long(f"{primitive.what}, {name}", self._arrays.read(number, *widths), primitive.count)

    def targets(self, primitive: Primitive, name: str, *widths: int) -> list[np.ndarray | None]:
        """Read the displacements [V, N] of an attribute, one for each morph target, None for targets without."""
        found: list[np.ndarray | None] = []
        for target in dicts(primitive.entry, "targets"):
            number = target.get(name)
            values = None if number is None else self._arrays.read(number, *widths)
            found.append(
                None if values is None else _as_long(f"{primitive.what}, morph target", values, primitive.count)
            )
        return found

    def at_rest(self, primitive: Primitive, name: str, weights: tuple[float, ...], *widths: int) -> np.ndarray | None:
        """Read an attribute, moved by the morph targets with their weights at rest."""
        values = self.attribute(primitive, name, *widths)
        if values is None or not any(weights):
            return values
        for weight, moved in zip(weights, self.targets(primitive, name), strict=False):
            if weight and moved is not None:
                if moved.shape[1] > values.shape[1]:
                    raise GltfError(f"{primitive.what}: expected {values.shape[1]} numbers of {name} in morph targets")
                values = values.astype(np.float64)
                with np.errstate(over="ignore", invalid="ignore"):
                    values[:, : moved.shape[1]] += weight * moved
        return values

    def _read(self, what: str, entry: dict[str, Any], mesh: dict[str, Any]) -> Primitive | None:
        mode = whole(entry, "mode", _TRIANGLES)
        attributes = child(entry, "attributes")
        if mode > _FAN:
            raise GltfError(f"{what}: expected a mode from 0 to 6, got {mode}")
        self.points += mode in _POINTS
        self.lines += mode in _LINES
        if mode < _TRIANGLES:
            return None
        if "POSITION" not in attributes:
            self.unplaced += 1
            return None
        packed = self._unpacked(what, entry, attributes)
        if packed is not None:
            faces, unpacked = packed
            count = len(unpacked["POSITION"])
        else:
            count = len(self._arrays.stored(attributes["POSITION"], 3))
            faces, unpacked = _triangles(what, self._corners(what, entry, count), mode), {}
        if faces.size and faces.max() >= count:
            raise GltfError(f"{what}: expected face indices in [0, {count}), got {faces.max()}")
        return Primitive(what, entry, mesh, faces, count, unpacked)

    def _corners(self, what: str, entry: dict[str, Any], count: int) -> np.ndarray:
        """Return the vertices that are drawn, [N] int64, one after the other."""
        if "indices" not in entry:
            return np.arange(count)
        if self._arrays.dtype(entry["indices"]).kind != "u":
            raise GltfError(f"{what}: expected whole numbers ≥ 0 as indices, got others")
        return self._arrays.read(entry["indices"], 1)[:, 0].astype(np.int64)

    def _unpacked(
        self, what: str, entry: dict[str, Any], attributes: dict[str, Any]
    ) -> tuple[np.ndarray, dict[str, np.ndarray]] | None:
        """Decode Draco; None without it, or if its library is missing and the file has the arrays unpacked, too."""
        packed = extension(entry, "KHR_draco_mesh_compression")
        if packed is None:
            return None
        try:
            faces, found = draco_mesh(what, bytes(self._arrays.view(packed.get("bufferView"))))
        except ModuleNotFoundError:
            numbers_used = [*attributes.values(), *([entry["indices"]] if "indices" in entry else [])]
            if not all(self._arrays.has_data(number) for number in numbers_used):
                raise
            return None
        arrays = {}
        for name, place in child(packed, "attributes").items():
            if not isinstance(place, int) or place not in found or name not in attributes:
                raise GltfError(f"{what}: expected the attribute {short(name)} in its Draco data, got none")
            arrays[name] = found[place].astype(self._arrays.dtype(attributes[name]))
        if "POSITION" not in arrays:
            raise GltfError(f"{what}: expected positions in its Draco data, got none")
        return faces, arrays


def default_weights(node: dict[str, Any], mesh: dict[str, Any], count: int) -> tuple[float, ...]:
    """Return the weights of a node's morph targets at rest: its own, else those of its mesh, else 0."""
    owner = node if "weights" in node else mesh
    return tuple(numbers(owner, "weights", (0.0,) * count, least=None)) if count else ()


def checked_positions(what: str, points: np.ndarray) -> np.ndarray:
    """Return positions [V, 3] as float64 if float32 can hold them."""
    points = points.astype(np.float64)
    good = fits_float32(points)
    if not good.all():
        raise GltfError(f"{what}: expected finite vertices that float32 can hold, got {int((~good).sum())} bad numbers")
    return points


def _triangles(what: str, corners: np.ndarray, mode: int) -> np.ndarray:
    """List the triangles of vertices that are drawn in a mode (section 3.7.2.1): [F, 3]."""
    if mode == _TRIANGLES:
        if len(corners) % 3:
            raise GltfError(f"{what}: expected three corners for each triangle, got {len(corners)} in all")
        return corners.reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == _FAN:
        return np.stack((corners[1:-1], corners[2:], np.full(len(corners) - 2, corners[0])), 1)
    faces = np.stack((corners[:-2], corners[1:-1], corners[2:]), 1)
    faces[1::2] = faces[1::2, [0, 2, 1]]
    return faces


def _as_long(what: str, values: np.ndarray, count: int) -> np.ndarray:
    if len(values) != count:
        raise GltfError(f"{what}: expected {count} elements, one for each vertex, got {len(values)}")
    return values
