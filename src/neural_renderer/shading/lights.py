"""Ambient and directional light with flat shading (section "Lighting" of the paper)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .. import validate
from ..camera.parameters import Array, Scalar, batch_of, batch_size, parameter, scalar
from ..meshes.normals import face_normals

_WHITE = (1.0, 1.0, 1.0)
_UP = (0.0, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class Light:
    """Ambient and directional light, for one scene or for each scene of a batch.

    A face is lit by ambient · ambient_color + directional · directional_color · max(n · direction, 0), where n is the
    unit normal of its visible side. Parameters given as tensors get gradients.

    Attributes:
        ambient: Ambient intensity: number, or tensor [] or [B].
        directional: Directional intensity: number, or tensor [] or [B].
        ambient_color: RGB [3] or [B, 3]: list, tuple, array or tensor.
        directional_color: RGB [3] or [B, 3].
        direction: [3] or [B, 3], world vector **towards** the light. It is not normalised: its length scales the light.

    Example:
        >>> light = nr.Light(ambient=0.3, directional=0.7, direction=(1.0, 1.0, 0.0))
        >>> images = nr.render(mesh, camera, light=light)
    """

    ambient: Scalar = 0.5
    directional: Scalar = 0.5
    ambient_color: Array = _WHITE
    directional_color: Array = _WHITE
    direction: Array = _UP

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        """Compute the light on both sides of each face.

        Args:
            corners: [B, F, 3 corners, 3] floating, corners of faces in world space.
            mirrored: Whether the camera mirrors (`Camera.mirrored`).

        Returns:
            [B, 2, F, 3]: RGB factors. Index 0 is the side visible when corners run counter-clockwise on the screen:
            the side of (v1 − v0) × (v2 − v0), or the opposite one for a mirroring camera. Index 1 is its back.

        Raises:
            TypeError, ValueError: A type or shape does not fit; while values are checked, also a parameter that is not
                finite.
        """
        facing = self._facing(corners)
        if not mirrored:
            facing = -facing
        return self._shade(torch.stack((facing, -facing), dim=1))

    def _facing(self, corners: Tensor) -> Tensor:
        """Compute n · direction of each face, [B, F], with the orientation of `face_normals`."""
        validate.finite("corners", validate.floating("corners", corners, ("B", "F", 3, 3)))
        if isinstance(self.directional, (int, float)) and self.directional == 0:
            return corners.new_zeros(corners.shape[:2])
        direction = parameter("direction", self.direction, (3,), corners.dtype, corners.device, shared=True)
        batch_size(corners=corners.shape[0], direction=batch_of(direction, 1))
        return (face_normals(corners) * direction[..., None, :]).sum(-1)

    def _shade(self, facing: Tensor) -> Tensor:
        """Compute light [B, ..., 3] from n · direction [B, ...]."""

        def glow(intensity: str, color: str) -> Tensor:
            strength = scalar(intensity, getattr(self, intensity), facing.dtype, facing.device)
            rgb = parameter(color, getattr(self, color), (3,), facing.dtype, facing.device, shared=True)
            rgb = rgb * (strength[:, None] if isinstance(strength, Tensor) and strength.ndim else strength)
            batch_size(corners=facing.shape[0], **{color: batch_of(rgb, 1)})
            return rgb.reshape(-1, *(1,) * (facing.ndim - 1), 3)

        ambient, directional = glow("ambient", "ambient_color"), glow("directional", "directional_color")
        return ambient + directional * torch.relu(facing)[..., None]
