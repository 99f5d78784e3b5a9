"""World transforms of joints from those relative to their parents."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

_MOST_LEVELS = 4096


class JointTree:
    """Joints by depth, so that each level is one product.

    Raises ValueError if ``parents`` form no forest, or chains are longer than 4,096 joints.
    """

    def __init__(self, parents: Sequence[int], device: torch.device) -> None:
        self._levels: list[tuple[Tensor, Tensor]] = []  # joints, and the positions of their parents in the level above
        children: dict[int, list[int]] = {}
        for number, parent in enumerate(parents):
            if parent >= len(parents):
                raise ValueError(f"parents[{number}]: expected less than {len(parents)}, got {parent}")
            children.setdefault(parent, []).append(number)
        known, above, joints = 0, [-1], children.get(-1, [])
        while joints:
            if len(self._levels) == _MOST_LEVELS:
                raise ValueError(f"parents: expected chains of at most {_MOST_LEVELS:,} joints, got a longer one")
            index = {joint: number for number, joint in enumerate(above)}
            up = [index[parents[joint]] for joint in joints]
            self._levels.append((torch.tensor(joints, device=device), torch.tensor(up, device=device)))
            known += len(joints)
            above, joints = joints, [child for joint in joints for child in children.get(joint, ())]
        if known < len(parents) or not parents:
            lost = len(parents) - known
            raise ValueError(f"parents: expected a tree of joints, got {lost} of {len(parents)} in cycles")
        self._order = torch.cat([joints for joints, _ in self._levels]).argsort()

    def frames(self, linear: Tensor, translations: Tensor) -> tuple[Tensor, Tensor]:
        """Multiply transforms, [..., J, 3, 3] and [..., J, 3], along the tree."""
        above: tuple[Tensor, Tensor] | None = None
        levels = []
        for joints, parents in self._levels:
            rotation, position = linear[..., joints, :, :], translations[..., joints, :]
            if above is not None:
                parent = above[0][..., parents, :, :]
                rotation, position = (
                    parent @ rotation,
                    (parent @ position[..., None])[..., 0] + above[1][..., parents, :],
                )
            above = rotation, position
            levels.append(above)
        shape = torch.broadcast_shapes(
            *(rotation.shape[:-3] for rotation, _ in levels), *(at.shape[:-2] for _, at in levels)
        )
        rotations = torch.cat([rotation.expand(*shape, *rotation.shape[-3:]) for rotation, _ in levels], -3)
        positions = torch.cat([position.expand(*shape, *position.shape[-2:]) for _, position in levels], -2)
        return rotations[..., self._order, :, :], positions[..., self._order, :]
