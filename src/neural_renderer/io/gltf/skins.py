"""Skins of a glTF file: which joints move which vertices, and where they are at rest (section 3.7.3 of the spec)."""

from __future__ import annotations

from typing import Any

import numpy as np

from .accessors import Accessors
from .nodes import Nodes
from .primitives import Primitive, Primitives
from .tree import GltfError, item, wholes

_MOST_SETS = 16  # of four joints each; real meshes have one or two


class Skins:
    """The skins of a file. The transform of a node that has one does not matter."""

    def __init__(self, tree: dict[str, Any], arrays: Accessors, nodes: Nodes, primitives: Primitives) -> None:
        self._tree, self._arrays, self._nodes, self._primitives = tree, arrays, nodes, primitives

    def joints(self, number: Any) -> tuple[list[int], np.ndarray]:
        """Return the joints of a skin, and their inverse bind matrices [J, 4, 4]."""
        skin = item(self._tree, "skins", number)
        joints = wholes(skin, "joints")
        for joint in joints:
            item(self._tree, "nodes", joint)
        if "inverseBindMatrices" not in skin:
            return joints, np.tile(np.eye(4), (len(joints), 1, 1))
        read = self._arrays.read(skin["inverseBindMatrices"], 16).astype(np.float64)
        read = read.reshape(-1, 4, 4).transpose(0, 2, 1)
        if len(read) < len(joints) or not np.isfinite(read).all():
            raise GltfError(f"skin {number}: expected {len(joints)} finite inverse bind matrices, got {len(read)}")
        return joints, read[: len(joints)]

    def weights(self, number: Any, primitive: Primitive, joints: int) -> tuple[np.ndarray, np.ndarray]:
        """Read the indices of the joints [V, K] of each vertex, and their weights, with sum 1."""
        index, weights = (
            np.concatenate([self._attribute(primitive, name) for name in self._sets(primitive, prefix)], 1)
            for prefix in ("JOINTS_", "WEIGHTS_")
        )
        if index.shape != weights.shape or index.dtype.kind not in "iu":
            raise GltfError(f"skin {number}: expected whole numbers of joints, and a weight for each")
        if not np.isfinite(weights).all() or (weights < 0).any():
            raise GltfError(f"skin {number}: expected weights that are finite and not negative")
        index = np.where(weights > 0, index.astype(np.int64), 0)
        if index.size and index.max() >= joints:
            raise GltfError(f"skin {number}: expected joints below {joints}, got {index.max()}")
        weights = weights.astype(np.float64)
        total = weights.sum(1, keepdims=True)
        return index, np.where(total > 0, weights / np.where(total > 0, total, 1), np.arange(weights.shape[1]) == 0)

    def motions(self, number: Any, primitive: Primitive) -> np.ndarray:
        """Compute the transform of each vertex to the world at rest, [V, 4, 4]."""
        joints, inverse = self.joints(number)
        index, weights = self.weights(number, primitive, len(joints))
        frames = np.array([self._nodes.world(joint) for joint in joints]).reshape(-1, 4, 4)
        with np.errstate(over="ignore", invalid="ignore"):
            frames = (frames @ inverse).reshape(-1, 16)
            result = np.zeros((len(index), 16))
            for column, share in zip(index.T, weights.T, strict=True):
                result += share[:, None] * frames[column]
        return result.reshape(-1, 4, 4)

    def _attribute(self, primitive: Primitive, name: str) -> np.ndarray:
        values = self._primitives.attribute(primitive, name, 4)
        if values is None:
            raise GltfError(f"{primitive.what}: expected the attribute {name} of a mesh with a skin, got none")
        return values

    @staticmethod
    def _sets(primitive: Primitive, prefix: str) -> list[str]:
        attributes = primitive.entry["attributes"]
        found = [f"{prefix}{number}" for number in range(len(attributes)) if f"{prefix}{number}" in attributes]
        if len(found) > _MOST_SETS:
            raise GltfError(f"{primitive.what}: expected at most {4 * _MOST_SETS} joints of a vertex, got more")
        return found or [f"{prefix}0"]


def moved(points: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Move points [V, 3] by one matrix, or by one for each: [4, 4] or linear [3, 3], perhaps with a leading [V]."""
    linear = motion[..., :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        result = points @ linear.T if linear.ndim == 2 else (linear @ points[..., None])[..., 0]
        return result if motion.shape[-1] == 3 else result + motion[..., :3, 3]


def turned_over(motion: np.ndarray) -> bool:
    """Test whether a motion, or those of most vertices, mirror."""
    with np.errstate(over="ignore", invalid="ignore"):
        signs = np.sign(np.linalg.det(motion[..., :3, :3]))
    return bool(np.nan_to_num(signs).sum() < 0)
