"""Nodes, skins, morph targets and animations of glTF files, as arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..files import short
from .accessors import Accessors
from .reader import PRIMITIVE, dicts, item, numbers

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
    weights: np.ndarray  # [V, K], how much they move it; the sum is 1
    targets: np.ndarray  # [M, V, 3] displacements
    target_weights: np.ndarray  # [M]
    animations: list[tuple[str, list[Track]]] = field(default_factory=list)

    def keep(self, index: Any) -> None:
        """Keep some of the vertices, in this order."""
        self.indices, self.weights, self.targets = self.indices[index], self.weights[index], self.targets[:, index]


class RigReader:
    """Reader of one file; arguments as `Accessors`. Its joints are all nodes of the file, by their numbers.

    Raises ValueError if the nodes are no forest, or an array does not fit its buffer.
    """

    def __init__(self, tree: dict[str, Any], data: bytes, is_binary: bool, resolve: Callable[[str], bytes]) -> None:
        self._tree, self._arrays = tree, Accessors(tree, data, is_binary, resolve)
        self._arrays.check()
        self._nodes = dicts(tree, "nodes")
        self._parents = self._forest()
        self._bones: dict[tuple[int, bytes], int] = {}  # by joint and inverse bind matrix

    def read(self, parts: Iterable[tuple[int, Any, str]]) -> RigFile:
        """Read the rig for parts: the number of vertices of each, its attributes, and the name of its node."""
        skinned = [self._part(*part) for part in parts]
        owned: dict[int, range] = {}  # numbers of the weights of each node with morph targets
        defaults: list[float] = []
        for node, _, _, targets in skinned:
            if len(targets) and node not in owned:
                owned[node] = range(len(defaults), len(defaults) + len(targets))
                defaults += self._default_weights(node, len(targets))
        most = max(index.shape[1] for _, index, _, _ in skinned)
        vertices = sum(len(index) for _, index, _, _ in skinned)
        if len(defaults) * vertices * 3 > _MOST:
            raise ValueError(f"expected morph targets of at most {_MOST} numbers, got {len(defaults)} targets")
        moved = np.zeros((len(defaults), vertices, 3))
        begin = 0
        for node, index, _, targets in skinned:
            for number, target in enumerate(targets, owned.get(node, range(0)).start):
                if number >= len(defaults):
                    raise ValueError("expected as many morph targets for all primitives of a mesh")
                moved[number, begin : begin + len(index)] = target
            begin += len(index)
        joints = self._nodes[: self._last_joint() + 1]
        if len(joints) > _MOST_JOINTS:
            raise ValueError(f"expected at most {_MOST_JOINTS:,} nodes of a rig, got {len(joints):,}")
        frames = [self._frame(number, node) for number, node in enumerate(joints)]
        places, turns, scales = (np.array([frame[part] for frame in frames], dtype=np.float64) for part in range(3))
        return RigFile(
            [str(node.get("name", f"node {number}")) for number, node in enumerate(joints)],
            self._parents[: len(joints)],
            places,
            turns,
            scales,
            bones=np.array([joint for joint, _ in self._bones], dtype=np.int64),
            inverse_bind=np.array([np.frombuffer(matrix).reshape(4, 4) for _, matrix in self._bones]),
            indices=np.concatenate([_wide(index, most) for _, index, _, _ in skinned]),
            weights=np.concatenate([_wide(weight, most) for _, _, weight, _ in skinned]),
            targets=moved,
            target_weights=np.array(defaults),
            animations=[
                self._animation(*one, owned, len(joints)) for one in enumerate(dicts(self._tree, "animations"))
            ],
        )

    def _last_joint(self) -> int:
        """Find the last node that moves a vertex or another node: those after it carry meshes with skins."""
        used = {joint for joint, _ in self._bones}
        idle = ("skin" in node and not node.get("children") for node in self._nodes)
        return max((number for number, none in enumerate(idle) if not none or number in used), default=-1)

    def _forest(self) -> list[int]:
        """Find the parent of each node, −1 for roots."""
        parents = [-1] * len(self._nodes)
        for number, node in enumerate(self._nodes):
            for child in node.get("children", ()):
                item(self._tree, "nodes", child)
                if parents[child] >= 0:
                    raise ValueError(f"node {child}: expected one parent, got nodes {parents[child]} and {number}")
                parents[child] = number
        state = [0] * len(parents)  # 1 while its ancestors are visited, 2 where they end at a root
        for start in range(len(parents)):
            path, place = [], start
            while place >= 0 and state[place] == 0:
                state[place] = 1
                path.append(place)
                place = parents[place]
            if place >= 0 and state[place] == 1:
                raise ValueError(f"node {place}: expected a tree of nodes, got one that is its own ancestor")
            for each in path:
                state[each] = 2
        return parents

    def _part(self, count: int, attributes: Any, name: str) -> tuple[int, np.ndarray, np.ndarray, list[np.ndarray]]:
        """Read a part: its node, bones [V, K] and weights [V, K] of vertices, and targets [V, 3]."""
        node = int(name.partition("_")[0])
        own = item(self._tree, "nodes", node)
        number = next(int(key.removeprefix(PRIMITIVE)) for key in attributes if key.startswith(PRIMITIVE))
        primitive = item(self._tree, "meshes", own["mesh"])["primitives"][number]
        targets = []
        for target in primitive.get("targets", ()):
            moved = self._arrays.read(target["POSITION"], 3) if "POSITION" in target else np.zeros((count, 3))
            targets.append(_as_long("morph target", moved, count))
        if "skin" not in own:
            bone = np.full((count, 1), self._bone(node, np.eye(4)))
            return node, bone, np.ones((count, 1)), targets
        skin = item(self._tree, "skins", own["skin"])
        joints = skin["joints"]
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        if "inverseBindMatrices" in skin:
            read = self._arrays.read(skin["inverseBindMatrices"], 16).reshape(-1, 4, 4).transpose(0, 2, 1)
            if len(read) < len(joints) or not np.isfinite(read).all():
                raise ValueError(
                    f"skin {own['skin']}: expected {len(joints)} finite inverse bind matrices, got {len(read)}"
                )
            inverse = read
        bones = np.array([self._bone(*pair) for pair in zip(joints, inverse, strict=False)])
        index, weights = (
            np.concatenate(
                [_as_long(key, self._arrays.read(primitive["attributes"][key], 4), count) for key in keys], 1
            )
            for keys in (self._sets(primitive, "JOINTS_"), self._sets(primitive, "WEIGHTS_"))
        )
        if index.shape != weights.shape or index.dtype.kind not in "iu":
            raise ValueError(f"skin {own['skin']}: expected whole numbers of joints, and a weight for each")
        if index.size and index.max() >= len(joints):
            raise ValueError(f"skin {own['skin']}: expected joints below {len(joints)}, got {index.max()}")
        total = weights.sum(1, keepdims=True)
        if not np.isfinite(weights).all() or (weights < 0).any():
            raise ValueError(f"skin {own['skin']}: expected weights that are finite and not negative")
        weights = np.where(total > 0, weights / np.where(total > 0, total, 1), np.arange(weights.shape[1]) == 0)
        return node, bones[index.astype(np.int64)], weights, targets

    @staticmethod
    def _sets(primitive: Any, prefix: str) -> list[str]:
        found = sorted(key for key in primitive["attributes"] if key.startswith(prefix))
        if not found:
            raise ValueError(f"expected the attribute {prefix}0 of a mesh with a skin, got none")
        return found

    def _bone(self, joint: Any, inverse: np.ndarray) -> int:
        item(self._tree, "nodes", joint)
        return self._bones.setdefault((joint, inverse.astype(np.float64).tobytes()), len(self._bones))

    def _default_weights(self, node: int, count: int) -> list[float]:
        own = self._nodes[node]
        owner = own if "weights" in own else item(self._tree, "meshes", own["mesh"])
        return list(numbers(owner, "weights", (0.0,) * count, least=None))

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
            raise ValueError(f"node {number}: expected a matrix of translation, rotation and scale, got one with shear")
        from trimesh.transformations import quaternion_from_matrix  # imported here because it is slow

        return matrix[:3, 3], np.roll(quaternion_from_matrix(rotation), -1), scale

    def _animation(
        self, number: int, animation: dict[str, Any], owned: dict[int, range], joints: int
    ) -> tuple[str, list[Track]]:
        """Read the tracks of the joints, and of the weights that nodes own."""
        tracks: dict[tuple[int, str], Track] = {}
        samplers, known = animation["samplers"], {}
        for channel in dicts(animation, "channels"):
            target, place = channel["target"], channel["sampler"]
            path, node = target.get("path"), target.get("node")
            if path not in PATHS or node is None or (path == "weights" and node not in owned):
                continue  # of an extension, or of nothing
            item(self._tree, "nodes", node)
            if path != "weights" and node >= joints:
                continue
            what = f"animation {number}, sampler {place}"
            if (node, path) in tracks:
                raise ValueError(f"animation {number}: expected one channel for {path} of node {node}, got several")
            width = PATHS[path] if path != "weights" else len(owned[node])
            joint = owned[node].start if path == "weights" else node
            key = *(samplers[place].get(name) for name in ("input", "output", "interpolation")), width
            if key not in known:  # many channels may share a long array
                known[key] = self._keys(what, samplers[place], path, width)
            tracks[node, path] = Track(joint, path, *known[key])
        return str(animation.get("name", f"animation {number}")), list(tracks.values())

    def _keys(self, what: str, sampler: dict[str, Any], path: str, width: int) -> tuple[np.ndarray, np.ndarray, str]:
        """Read the times, values and interpolation of a `Track`."""
        kind = sampler.get("interpolation", "LINEAR")
        times, values = self._arrays.read(sampler["input"], 1)[:, 0], self._arrays.read(sampler["output"])
        if kind not in INTERPOLATIONS:
            raise ValueError(f"{what}: expected {', '.join(INTERPOLATIONS)}, got {short(kind)}")
        if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0).any():
            raise ValueError(f"{what}: expected ascending times, at least one")
        knots = 3 if kind == "CUBICSPLINE" else 1
        wanted = len(times) * knots * width
        if values.size != wanted or not np.isfinite(values).all():
            raise ValueError(f"{what}: expected {wanted} finite numbers of {path}, got {values.size} numbers")
        if (largest := np.abs(values).max(initial=0)) > _LARGEST:
            raise ValueError(f"{what}: expected numbers of {path} up to {_LARGEST:g}, got {largest:g}")
        shape = (len(times), 3, width) if knots == 3 else (len(times), width)
        return times.astype(np.float64), values.reshape(shape).astype(np.float64), kind


def _wide(values: np.ndarray, width: int) -> np.ndarray:
    return np.pad(values, ((0, 0), (0, width - values.shape[1])))


def _as_long(what: str, values: np.ndarray, count: int) -> np.ndarray:
    if len(values) != count:
        raise ValueError(f"{what}: expected {count} elements, one for each vertex, got {len(values)}")
    return values


def _unit(quaternion: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(quaternion)
    return quaternion / length if length else np.array([0.0, 0.0, 0.0, 1.0])
