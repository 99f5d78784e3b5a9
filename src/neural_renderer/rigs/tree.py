"""Frames of joints in the world, from those in the frames of their parents."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

_MOST_LEVELS = 4096


class JointTree:
    """Joints by their depth, so that each level is one product.

    Raises ValueError if ``parents`` are no forest, or chains are longer than 4,096 joints.
    """

    def __init__(self, parents: Sequence[int], device: torch.device) -> None:
        self._levels: list[tuple[Tensor, Tensor]] = []  # joints, and the places of their parents in the level above
        children: dict[int, list[int]] = {}
        for number, parent in enumerate(parents):
            if parent >= len(parents):
                raise ValueError(f"parents[{number}]: expected less than {len(parents)}, got {parent}")
            children.setdefault(parent, []).append(number)
        known, above, joints = 0, [-1], children.get(-1, [])
        while joints:
            if len(self._levels) == _MOST_LEVELS:
                raise ValueError(f"parents: expected chains of at most {_MOST_LEVELS:,} joints, got a longer one")
            place = {joint: number for number, joint in enumerate(above)}
            up = [place[parents[joint]] for joint in joints]
            self._levels.append((torch.tensor(joints, device=device), torch.tensor(up, device=device)))
            known += len(joints)
            above, joints = joints, [child for joint in joints for child in children.get(joint, ())]
        if known < len(parents) or not parents:
            lost = len(parents) - known
            raise ValueError(f"parents: expected a tree of joints, got {lost} of {len(parents)} in circles")
        self._order = torch.cat([joints for joints, _ in self._levels]).argsort()

    def frames(self, linear: Tensor, translations: Tensor) -> tuple[Tensor, Tensor]:
        """Multiply frames, [..., J, 3, 3] and [..., J, 3], along the tree."""
        above: tuple[Tensor, Tensor] | None = None
        levels = []
        for joints, parents in self._levels:
            own, place = linear[..., joints, :, :], translations[..., joints, :]
            if above is not None:
                turn = above[0][..., parents, :, :]
                own, place = turn @ own, (turn @ place[..., None])[..., 0] + above[1][..., parents, :]
            above = own, place
            levels.append(above)
        shape = torch.broadcast_shapes(*(own.shape[:-3] for own, _ in levels), *(at.shape[:-2] for _, at in levels))
        turns = torch.cat([own.expand(*shape, *own.shape[-3:]) for own, _ in levels], -3)
        places = torch.cat([place.expand(*shape, *place.shape[-2:]) for _, place in levels], -2)
        return turns[..., self._order, :, :], places[..., self._order, :]
