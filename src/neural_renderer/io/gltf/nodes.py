"""Nodes of a glTF file: their tree, their transforms, and which of them a scene draws."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .accessors import Accessors
from .tree import GltfError, dicts, extension, item, numbers, wholes

_MOST_INSTANCES = 1 << 22
_TRANSFORM = {"matrix", "translation", "rotation", "scale"}


class Nodes:
    """The nodes of a file by their numbers. Raises GltfError if they are no forest."""

    def __init__(self, tree: dict[str, Any]) -> None:
        self._tree, self.entries = tree, dicts(tree, "nodes")
        self.children = [wholes(node, "children") for node in self.entries]
        self.parents = self._forest()
        self._worlds: dict[int, np.ndarray] = {}

    def world(self, number: int) -> np.ndarray:
        """Return the transform [4, 4] of a node to the world."""
        item(self._tree, "nodes", number)
        path = []
        while number >= 0 and number not in self._worlds:
            path.append(number)
            number = self.parents[number]
        matrix = self._worlds[number] if number >= 0 else np.eye(4)
        with np.errstate(over="ignore", invalid="ignore"):
            for below in reversed(path):
                moves = not _TRANSFORM.isdisjoint(self.entries[below])
                self._worlds[below] = matrix = matrix @ local_matrix(self.entries[below]) if moves else matrix
        return matrix

    def drawn(self) -> Iterator[int]:
        """Iterate over the visible nodes of the scene, parents first; of all roots if the file has no scene."""
        stack = list(reversed(self._roots()))
        seen: set[int] = set()
        while stack:
            number = stack.pop()
            if number in seen:  # some files name nodes of a scene besides the nodes above them
                continue
            seen.add(number)
            item(self._tree, "nodes", number)
            visibility = extension(self.entries[number], "KHR_node_visibility") or {}
            if visibility.get("visible") is not False:
                yield number
                stack.extend(reversed(self.children[number]))

    def _roots(self) -> list[int]:
        if not dicts(self._tree, "scenes"):
            return [number for number, parent in enumerate(self.parents) if parent < 0]
        scene = item(self._tree, "scenes", self._tree.get("scene", 0))
        return wholes(scene, "nodes")

    def _forest(self) -> list[int]:
        """Find the parent of each node, −1 for roots."""
        parents = [-1] * len(self.entries)
        for number, children in enumerate(self.children):
            for below in children:
                item(self._tree, "nodes", below)
                if parents[below] >= 0:
                    raise GltfError(f"node {below}: expected one parent, got nodes {parents[below]} and {number}")
                parents[below] = number
        state = [0] * len(parents)  # 1 while its ancestors are visited, 2 where they end at a root
        for start in range(len(parents)):
            path, place = [], start
            while place >= 0 and state[place] == 0:
                state[place] = 1
                path.append(place)
                place = parents[place]
            if place >= 0 and state[place] == 1:
                raise GltfError(f"node {place}: expected a tree of nodes, got one that is its own ancestor")
            for each in path:
                state[each] = 2
        return parents


def local_matrix(node: dict[str, Any]) -> np.ndarray:
    """Return the transform [4, 4] of a node to its parent."""
    if "matrix" in node:
        return np.reshape(numbers(node, "matrix", (0.0,) * 16, least=None), (4, 4)).T
    translation = numbers(node, "translation", (0.0, 0.0, 0.0), least=None)
    rotation = numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0), least=None)
    scale = numbers(node, "scale", (1.0, 1.0, 1.0), least=None)
    return matrices(np.array([translation]), np.array([rotation]), np.array([scale]))[0]


def matrices(translations: np.ndarray, rotations: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Compose translations [N, 3], quaternions (x, y, z, w) [N, 4] of any length and scales [N, 3]: [N, 4, 4]."""
    length = np.linalg.norm(rotations, axis=1, keepdims=True)
    x, y, z, w = np.where(length > 0, rotations / np.where(length > 0, length, 1), [0.0, 0.0, 0.0, 1.0]).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    result = np.zeros((len(translations), 4, 4))
    result[:, :3, :3] = np.moveaxis(np.array(rows), 2, 0) * scales[:, None]
    result[:, :3, 3], result[:, 3, 3] = translations, 1
    return result


def instances(node: dict[str, Any], arrays: Accessors) -> np.ndarray | None:
    """Return the transforms [N, 4, 4] of a node's instances, before its own; None if it is drawn once."""
    found = extension(node, "EXT_mesh_gpu_instancing")
    if found is None:
        return None
    attributes = found.get("attributes", {})
    kinds = {"TRANSLATION": (3, 0.0), "ROTATION": (4, (0.0, 0.0, 0.0, 1.0)), "SCALE": (3, 1.0)}
    named = {name: attributes[name] for name in kinds if isinstance(attributes, dict) and name in attributes}
    if not named:
        return None
    counts = {arrays.count(number) for number in named.values()}
    if len(counts) > 1 or max(counts) > _MOST_INSTANCES:
        raise GltfError(f"EXT_mesh_gpu_instancing: expected as many of each attribute, got {sorted(counts)}")
    (count,) = counts
    parts = [
        np.asarray(arrays.read(named[name], width), np.float64) if name in named else np.full((count, width), plain)
        for name, (width, plain) in kinds.items()
    ]
    return matrices(*parts)
