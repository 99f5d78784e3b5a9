"""Nodes, skins, morph targets and animations of glTF files, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..files import short
from .accessors import Accessors
from .nodes import Nodes
from .primitives import Primitives
from .skins import Skins
from .tree import GltfError, child, dicts, item, numbers

PATHS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 1}
INTERPOLATIONS = ("STEP", "LINEAR", "CUBICSPLINE")
_MOST = 1 << 28  # numbers in all morph targets
_MOST_JOINTS = 1 << 17
_LARGEST = 1e18  # size of an animated number, so that products along the tree are finite


@dataclass
class Track:
    """Change of one property of a joint over time; rotations are quaternions (x, y, z, w)."""

    joint: int  # number of the joint; for weights of morph targets the number of the first weight
    path: str  # "translation", "rotation", "scale" or "weights"
    times: np.ndarray  # [T] float64, in seconds, ascending
    values: np.ndarray  # [T, N] float64, or with "CUBICSPLINE" [T, 3, N]: tangent to a time, value, tangent from it
    interpolation: str = "LINEAR"  # "STEP", "LINEAR" or "CUBICSPLINE"


@dataclass
class RigFile:
    """A rig of J joints, B bones and M morph targets for V vertices. Joints are in the frames of their parents."""

    names: list[str]
    parents: list[int]  # number of each joint's parent, or −1
    translations: np.ndarray  # [J, 3]
    rotations: np.ndarray  # [J, 4] quaternions (x, y, z, w)
    scales: np.ndarray  # [J, 3]
    bones: np.ndarray  # [B], the joint of each bone
    inverse_bind: np.ndarray  # [B, 4, 4], from the space of the mesh to that of the joint
    indices: np.ndarray  # [V, K], bones that move each vertex
    weights: np.ndarray  # [V, K], their weights; the sum is 1
    targets: np.ndarray  # [M, V, 3] displacements
    target_weights: np.ndarray  # [M]
    animations: list[tuple[str, list[Track]]] = field(default_factory=list)

    def keep(self, index: Any) -> None:
        """Keep some of the vertices, in this order."""
        self.indices, self.weights, self.targets = self.indices[index], self.weights[index], self.targets[:, index]


class RigReader:
    """Reader of the rig of one file. Its joints are all nodes of the file, by their numbers."""

    def __init__(
        self, tree: dict[str, Any], arrays: Accessors, nodes: Nodes, primitives: Primitives, skins: Skins
    ) -> None:
        self._tree, self._arrays, self._nodes = tree, arrays, nodes
        self._primitives, self._skins = primitives, skins
        self._bones: dict[tuple[int, bytes], int] = {}  # by joint and inverse bind matrix

    def read(self, blocks: Sequence[Any]) -> RigFile:
        """Read the rig for blocks of vertices."""
        if any(block.node < 0 for block in blocks):
            raise GltfError("expected nodes, got none")
        targets = [self._primitives.targets(block.primitive, "POSITION", 3) for block in blocks]
        bound = [self._bound(block) for block in blocks]
        owned: dict[int, range] = {}  # numbers of the weights of each node with morph targets
        defaults: list[float] = []
        for block, moved in zip(blocks, targets, strict=True):
            if moved and block.node not in owned:
                owned[block.node] = range(len(defaults), len(defaults) + len(moved))
                defaults += block.weights
        vertices = sum(block.primitive.count for block in blocks)
        if len(defaults) * vertices * 3 > _MOST:
            raise GltfError(f"expected morph targets of at most {_MOST} numbers, got {len(defaults)} targets")
        displaced = np.zeros((len(defaults), vertices, 3))
        for block, moved in zip(blocks, targets, strict=True):
            numbers = owned.get(block.node, range(0))
            if len(moved) not in (0, len(numbers)):
                raise GltfError("expected as many morph targets for all primitives of a mesh")
            for number, target in zip(numbers, moved, strict=False):
                if target is not None:
                    displaced[number, block.start : block.start + len(target)] = target
        joints = self._nodes.entries[: self._last_joint() + 1]
        if len(joints) > _MOST_JOINTS:
            raise GltfError(f"expected at most {_MOST_JOINTS:,} nodes of a rig, got {len(joints):,}")
        frames = [self._frame(number, node) for number, node in enumerate(joints)]
        places, turns, scales = (np.array([frame[part] for frame in frames], dtype=np.float64) for part in range(3))
        most = max(index.shape[1] for index, _ in bound)
        return RigFile(
            [str(node.get("name", f"node {number}")) for number, node in enumerate(joints)],
            self._nodes.parents[: len(joints)],
            places,
            turns,
            scales,
            bones=np.array([joint for joint, _ in self._bones], dtype=np.int64),
            inverse_bind=np.array([np.frombuffer(matrix).reshape(4, 4) for _, matrix in self._bones]),
            indices=np.concatenate([_wide(index, most) for index, _ in bound]),
            weights=np.concatenate([_wide(weight, most) for _, weight in bound]),
            targets=displaced,
            target_weights=np.array(defaults),
            animations=[
                self._animation(*one, owned, len(joints)) for one in enumerate(dicts(self._tree, "animations"))
            ],
        )

    def _last_joint(self) -> int:
        """Find the last node that moves a vertex or another node: those after it carry meshes with skins."""
        used = {joint for joint, _ in self._bones}
        idle = ("skin" in node and not node.get("children") for node in self._nodes.entries)
        return max((number for number, none in enumerate(idle) if not none or number in used), default=-1)

    def _bound(self, block: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the bones [V, K] of a block and their weights [V, K]."""
        node = self._nodes.entries[block.node]
        if "skin" not in node:
            bone = self._bone(block.node, np.eye(4) if block.instance is None else block.instance)
            return np.full((block.primitive.count, 1), bone), np.ones((block.primitive.count, 1))
        joints, inverse = self._skins.joints(node["skin"])
        index, weights = self._skins.weights(node["skin"], block.primitive, len(joints))
        bones = np.array([self._bone(*pair) for pair in zip(joints, inverse, strict=True)], dtype=np.int64)
        return bones[index], weights

    def _bone(self, joint: int, inverse: np.ndarray) -> int:
        return self._bones.setdefault((joint, np.ascontiguousarray(inverse).tobytes()), len(self._bones))

    def _frame(self, number: int, node: dict[str, Any]) -> tuple[Any, Any, Any]:
        """Read the translation, rotation and scale of a node."""
        if "matrix" not in node:
            return (
                numbers(node, "translation", (0.0, 0.0, 0.0), least=None),
                _unit(np.array(numbers(node, "rotation", (0.0, 0.0, 0.0, 1.0), least=None))),
                numbers(node, "scale", (1.0, 1.0, 1.0), least=None),
            )
        matrix = np.reshape(numbers(node, "matrix", (0.0,) * 16, least=None), (4, 4)).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        scale[0] *= -1 if np.linalg.det(matrix[:3, :3]) < 0 else 1
        rotation = matrix[:3, :3] / np.where(scale == 0, 1, scale)
        if not np.allclose(rotation.T @ rotation, np.diag(scale != 0), atol=1e-3):
            raise GltfError(f"node {number}: expected a matrix of translation, rotation and scale, got one with shear")
        return matrix[:3, 3], _quaternion(rotation), scale

    def _animation(
        self, number: int, animation: dict[str, Any], owned: dict[int, range], joints: int
    ) -> tuple[str, list[Track]]:
        """Read the tracks of the joints, and of the weights that nodes own."""
        tracks: dict[tuple[int, str], Track] = {}
        known: dict[Any, Any] = {}
        for channel in dicts(animation, "channels"):
            target, place = child(channel, "target"), channel.get("sampler")
            path, node = target.get("path"), target.get("node")
            if not isinstance(path, str) or path not in PATHS or node is None:
                continue  # of an extension, or of nothing
            item(self._tree, "nodes", node)
            if path == "weights" and node not in owned:
                continue
            if path != "weights" and node >= joints:
                continue
            what = f"animation {number}, sampler {place}"
            if (node, path) in tracks:
                raise GltfError(f"animation {number}: expected one channel for {path} of node {node}, got several")
            width = PATHS[path] if path != "weights" else len(owned[node])
            sampler = item(animation, "samplers", place)
            joint = owned[node].start if path == "weights" else node
            key = *(str(sampler.get(name)) for name in ("input", "output", "interpolation")), width
            if key not in known:  # many channels may share a long array
                known[key] = self._keys(what, sampler, path, width)
            tracks[node, path] = Track(joint, path, *known[key])
        return str(animation.get("name", f"animation {number}")), list(tracks.values())

    def _keys(self, what: str, sampler: dict[str, Any], path: str, width: int) -> tuple[np.ndarray, np.ndarray, str]:
        """Read the times, values and interpolation of a `Track`."""
        kind = sampler.get("interpolation", "LINEAR")
        times, values = self._arrays.read(sampler.get("input"), 1)[:, 0], self._arrays.read(sampler.get("output"))
        if kind not in INTERPOLATIONS:
            raise GltfError(f"{what}: expected {', '.join(INTERPOLATIONS)}, got {short(kind)}")
        if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0).any():
            raise GltfError(f"{what}: expected ascending times, at least one")
        knots = 3 if kind == "CUBICSPLINE" else 1
        wanted = len(times) * knots * width
        if values.size != wanted or not np.isfinite(values).all():
            raise GltfError(f"{what}: expected {wanted} finite numbers of {path}, got {values.size} numbers")
        if (largest := np.abs(values).max(initial=0)) > _LARGEST:
            raise GltfError(f"{what}: expected numbers of {path} up to {_LARGEST:g}, got {largest:g}")
        shape = (len(times), 3, width) if knots == 3 else (len(times), width)
        return times.astype(np.float64), values.reshape(shape).astype(np.float64), kind


def _wide(values: np.ndarray, width: int) -> np.ndarray:
    return np.pad(values, ((0, 0), (0, width - values.shape[1])))


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """Convert a rotation [3, 3], whose columns may be 0, to a quaternion (x, y, z, w)."""
    left, _, right = np.linalg.svd(rotation)
    left[:, 2] *= np.sign(np.linalg.det(left @ right))
    from scipy.spatial.transform import Rotation  # imported here because it is slow

    return Rotation.from_matrix(left @ right).as_quat()


def _unit(quaternion: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(quaternion)
    return quaternion / length if length else np.array([0.0, 0.0, 0.0, 1.0])
