"""Similarity of two worlds with the same cameras: scale, rotation and shift."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ....camera import Camera

_LEAST_SPREAD = 1e-6  # squared, of the cameras' positions; below, the scale stays


@dataclass(frozen=True, eq=False)
class Similarity:
    """Map of points X to scale · rotation · X + shift.

    Attributes:
        scale: Factor, > 0.
        rotation: [3, 3].
        shift: [3].
    """

    scale: float
    rotation: Tensor
    shift: Tensor

    @classmethod
    def between(cls, camera: Camera, other: Camera) -> Similarity:
        """Find the similarity that brings cameras as near as possible to other cameras.

        The rotation is the mean of those between the cameras (Moakher, "Means and averaging in the group of rotations",
        2002, section 3.1). Scale and shift bring the positions together by least squares (Umeyama, 1991).

        Args:
            camera: N cameras.
            other: N cameras.

        Returns:
            The similarity from the world of ``camera`` to that of ``other``.

        Example:
            >>> from neural_renderer.tasks.fit.cameras.similarity import Similarity
            >>> eyes = nr.get_points_from_angles(2.0, 20.0, torch.arange(6) * 60.0)
            >>> near, far = nr.Camera.look_at(eyes), nr.Camera.look_at(3 * eyes)
            >>> round(Similarity.between(near, far).scale, 4)
            3.0
        """
        mean = torch.einsum("bij,bik->jk", other.rotation.detach(), camera.rotation.detach())
        left, _, right = torch.linalg.svd(mean.double())
        turn = left @ torch.diag(left.new_tensor([1.0, 1.0, float(torch.linalg.det(left @ right))])) @ right
        eyes, goals = _eyes(camera).double(), _eyes(other).double()
        around, goals_around = (eyes - eyes.mean(0)) @ turn.t(), goals - goals.mean(0)
        spread = float(around.square().sum())
        scale = float((around * goals_around).sum()) / spread if spread > _LEAST_SPREAD * len(eyes) else 1.0
        shift = goals.mean(0) - scale * (turn @ eyes.mean(0))
        return cls(scale, turn.to(camera.rotation), shift.to(camera.rotation))

    def points(self, points: Tensor) -> Tensor:
        """Map points [V, 3]."""
        return self.scale * points @ self.rotation.t() + self.shift

    def cameras(self, camera: Camera) -> Camera:
        """Move cameras so that mapped points give the same images."""
        rotation = camera.rotation @ self.rotation.t()
        lens: dict[str, Any] = {} if camera.perspective else {"scale": camera.scale / self.scale}
        if camera.K is None:
            return replace(camera, rotation=rotation, origin=self.points(camera.origin), **lens)
        place = camera.translation - torch.einsum("bij,bj->bi", camera.rotation, camera.origin)
        place = self.scale * place - rotation @ self.shift
        return replace(camera, rotation=rotation, origin=torch.zeros_like(place), translation=place)


def _eyes(camera: Camera) -> Tensor:
    """Compute the positions [N, 3] of cameras, without a gradient."""
    return (camera.origin - torch.einsum("bij,bi->bj", camera.rotation, camera.translation)).detach()
