"""`CameraFit`, which `tasks.fit` had in version 2.1, kept for one release: `find_pose` takes its place."""

from __future__ import annotations

import warnings
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...camera import Camera
from ...meshes.mesh import Mesh
from ...optim.metrics import silhouette_iou
from ...rendering.forward import render
from ..common.adjustable import Adjustable
from .find import find_pose

_OLD_ANGLE = 30.0  # half of the vertical field of view in degrees
_SETTINGS = "starts", "steps", "photometric", "rate", "gradient", "seed"


class CameraFit(Adjustable):
    """Find the camera of an image of a known mesh in one step of `find_pose`, which new code calls itself.

    Args:
        shape: (vertices [V, 3], faces [F, 3]), or with textures [F, T, T, T, 3] to compare colours, too.
        mask: [H, W] in [0, 1], silhouette of the object.
        photo: [3, H, W] RGB, or None.
        viewing_angle: Half of the vertical field of view in degrees, in (0, 90).
        settings: starts, steps, photometric, rate, gradient, seed: they have no effect.

    Raises:
        TypeError, ValueError: An argument does not fit, or the mask is empty.

    Warns:
        DeprecationWarning: Always.
    """

    phase = "camera"

    def __init__(
        self,
        shape: tuple[Tensor, ...],
        mask: Tensor,
        photo: Tensor | None = None,
        *,
        viewing_angle: float = _OLD_ANGLE,
        **settings: Any,
    ) -> None:
        warnings.warn("CameraFit is neural_renderer.find_pose since version 2.2", DeprecationWarning, stacklevel=2)
        if unknown := settings.keys() - {*_SETTINGS}:
            raise TypeError(f"CameraFit: expected settings {', '.join(_SETTINGS)}, got {', '.join(unknown)}")
        validate.floating("mask", mask, ("H", "W"))
        if float(mask.max()) <= 0.5:
            raise ValueError("mask: expected an object, got an empty mask")
        vertices, faces, *textures = (part.detach() for part in shape)
        self._mesh, self._mask = Mesh(vertices, faces, textures[0] if textures else None), mask
        self._photo = photo if textures else None
        self._angle = validate.positive("viewing_angle", viewing_angle)
        self.step, self.steps, self._rate = 0, 1, validate.positive("rate", settings.get("rate", 1.0))

    @cached_property
    def _found(self) -> tuple[Tensor, Tensor, Tensor]:
        """Axes [S, 3, 3] and positions [S, 3] of the cameras, from best to worst, and their residuals [S]."""
        pose = find_pose(self._mesh, self._photo, self._mask, viewing_angle=self._angle)
        others = pose.others[:, :3]  # from the mesh to the first camera's space, y down
        axes = others[:, :, :3] * others.new_tensor([1.0, -1.0, 1.0])[:, None]
        positions = -(others[:, :, :3].mT @ others[:, :, 3:])[..., 0]
        residuals = torch.cat((pose.other_residuals.new_tensor([pose.residual]), pose.other_residuals))
        return torch.cat((pose.camera.axes, axes)), torch.cat((pose.camera.position, positions)), residuals

    def cameras(self) -> Camera:
        """Return the S cameras that were found, from best to worst."""
        axes, positions, _ = self._found
        return Camera(axes, positions, torch.zeros_like(positions), viewing_angle=self._angle)

    def best(self) -> Camera:
        """Return the camera that explains the image best."""
        return self.cameras()[0]

    def losses(self) -> Tensor:
        """Return the root mean square residual of each camera, [S]."""
        return self._found[2]

    def iou(self) -> Tensor:
        """Compute the silhouette IoU of each camera, [S] in [0, 1]."""
        height, width = self._mask.shape
        with torch.no_grad():
            alpha = render(self._mesh, self.cameras(), (height, width), outputs="alpha").alpha
            return torch.cat([silhouette_iou(each[None], self._mask[None]) for each in alpha])

    def advance(self) -> dict[str, float]:
        """Find the cameras; return "loss", that of the best."""
        self.step = 1
        return {"loss": float(self.losses()[0])}

    def state_dict(self) -> dict[str, Any]:
        return {"step": self.step, "found": self._found if self.step else None}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.step = state["step"]
        if state["found"] is not None:
            self.__dict__["_found"] = tuple(state["found"])
