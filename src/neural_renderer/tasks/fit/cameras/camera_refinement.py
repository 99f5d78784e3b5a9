"""`CameraRefinement`: the cameras of a fit as parameters of the descent, held near where they began."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import torch
from torch import Tensor

from ....camera import Camera
from ..descent import VectorAdam
from ..fit_views import Views
from .pose_offsets import FREEDOMS, change_cameras
from .similarity import Similarity

_DECAY = 0.95  # β₂ of the descent
_FOCAL_RATE = 0.3  # of the focal length, relative to that of poses: all views change it
_TYPICAL = 0.02  # radians, or relative to the depth: a change of this size costs `_PRIOR`
_PRIOR = 1e-3


class CameraRefinement:
    """Poses and the focal length of N cameras as parameters of a descent, held near where they began.

    A mesh and its cameras give the same images if they are moved, turned and scaled together. `settle` fixes that: on
    average, the cameras stay where they began. The focal length has one factor for all cameras. That of parallel
    cameras stays, because the size of the object does the same.

    Args:
        camera: N cameras, in a world where the object lies in about [-1, 1]³.
        focal: Whether the focal length may change.

    Attributes:
        begun: The cameras at the beginning.
        parameters: Changes of the poses [N, 6] and of the focal length [1, 1], see `change_cameras`. `step` replaces
            them.

    Example:
        >>> from neural_renderer.tasks.fit import Views
        >>> from neural_renderer.tasks.fit.cameras.camera_refinement import CameraRefinement
        >>> views = Views.of(mesh, camera, 32)
        >>> refinement = CameraRefinement(camera)
        >>> alpha = refinement.place(views, [0]).draw((mesh.vertices, mesh.faces)).alpha
        >>> loss = alpha.mean() + refinement.prior()
        >>> refinement.step(torch.autograd.grad(loss, refinement.parameters), [0], rate=0.01)
        >>> (refinement.camera.rotation != camera.rotation).any()
        tensor(True)
    """

    parameters: tuple[Tensor, Tensor]

    def __init__(self, camera: Camera, focal: bool = True) -> None:
        self.begun, self._has_focal = camera, focal and camera.perspective
        self._restart(camera)

    @property
    def camera(self) -> Camera:
        """The current cameras, without gradients."""
        with torch.no_grad():
            return change_cameras(self._base, *self.parameters)

    def place(self, views: Views, rows: Sequence[int]) -> Views:
        """Give views the current cameras, through which gradients flow to `parameters`.

        Args:
            views: Views of some of the cameras.
            rows: The number of the camera of each view.
        """
        poses, focal = self.parameters
        some = list(rows)
        return replace(views, camera=change_cameras(self._base[some], poses[some], focal))

    def prior(self) -> Tensor:
        """Compute the loss [] that holds the cameras near where they began."""
        poses, focal = self.parameters
        return _PRIOR * ((poses / _TYPICAL).square().sum(1).mean() + (focal / _TYPICAL).square().sum())

    def step(self, gradients: Sequence[Tensor], rows: Sequence[int], rate: float) -> None:
        """Take one step of descent.

        Args:
            gradients: Gradients of the loss by `parameters`.
            rows: The cameras that the step moves.
            rate: Length of the step, in radians and relative to the depth.
        """
        poses, focal = (part.detach().clone() for part in self.parameters)
        for row in rows:
            place = slice(row, row + 1)
            poses[place] = self._descents[row].step(poses[place], gradients[0][place], rate)
        if self._has_focal:
            focal = self._descents[-1].step(focal, gradients[1], _FOCAL_RATE * rate)
        self.parameters = poses.requires_grad_(), focal.requires_grad_()

    def settle(self, vertices: Tensor) -> Tensor:
        """Move, turn and scale the cameras and a mesh together, so that the cameras are nearest to where they began.

        Args:
            vertices: [V, 3].

        Returns:
            The moved vertices [V, 3]; images stay the same.
        """
        back = Similarity.between(self.camera, self.begun)
        self._restart(back.cameras(self.camera))
        return back.points(vertices)

    def _restart(self, camera: Camera) -> None:
        """Begin to change these cameras."""
        self._base = camera
        poses = camera.rotation.new_zeros(len(camera), FREEDOMS)
        self.parameters = poses.requires_grad_(), camera.rotation.new_zeros(1, 1).requires_grad_()
        self._descents = [VectorAdam(_DECAY) for _ in range(len(camera) + 1)]  # the last one is of the focal length

    def state_dict(self) -> dict[str, Any]:
        """Return everything that changes from step to step."""
        base = {part.name: getattr(self._base, part.name) for part in fields(self._base)}
        descents = [descent.state_dict() for descent in self._descents]
        return {"base": base, "parameters": [part.detach() for part in self.parameters], "descents": descents}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume from a `state_dict`."""
        self._restart(Camera(**state["base"]))
        poses, focal = state["parameters"]
        self.parameters = poses.requires_grad_(), focal.requires_grad_()
        for descent, means in zip(self._descents, state["descents"], strict=True):
            descent.load_state_dict(means)
