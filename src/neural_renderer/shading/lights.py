"""Ambient and directional light on flat faces (section "Lighting" of the Neural 3D Mesh Renderer paper)."""

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
    """One ambient and one directional light for a scene, or one for each scene of a batch.

    The light on a face is ambient · ambient_color + directional · directional_color · max(n · direction, 0), where n
    is the unit normal on the side that is looked at. Gradients flow to whatever is a tensor.

    Attributes:
        ambient, directional: the intensities: numbers, or tensors [] or [B].
        ambient_color, directional_color: RGB, [3] or [B, 3]: list, tuple, array or tensor.
        direction: **towards** the light, in world space, likewise. It is used as it is: its length counts.
    """

    ambient: Scalar = 0.5
    directional: Scalar = 0.5
    ambient_color: Array = _WHITE
    directional_color: Array = _WHITE
    direction: Array = _UP

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        """The light on both sides of each face.

        Args:
            corners: the faces' corners in world space, [B, F, 3 corners, 3 coordinates], floating.
            mirrored: whether the faces are seen through a mirroring camera (`Camera.mirrored`).

        Returns:
            [B, 2, F, 3 colours]. Index 0 is the side that is seen where the corners run counter-clockwise on the
            screen: with a camera that does not mirror, the side of (v1 − v0) × (v2 − v0); with one that does, the
            other. Index 1 is its back.

        Raises:
            TypeError, ValueError: wrong types or shapes; parameters that are not finite if values are checked.
        """
        facing = self._facing(corners)
        if not mirrored:
            facing = -facing
        return self._shade(torch.stack((facing, -facing), dim=1))

    def _facing(self, corners: Tensor) -> Tensor:
        """n · direction of each face [B, F], with n as `face_normals` turns it."""
        validate.floating("corners", corners, ("B", "F", 3, 3))
        if isinstance(self.directional, (int, float)) and self.directional == 0:
            return corners.new_zeros(corners.shape[:2])
        direction = parameter("direction", self.direction, (3,), corners.dtype, corners.device)
        batch_size(corners=corners.shape[0], direction=batch_of(direction, 1))
        return (face_normals(corners) * direction[..., None, :]).sum(-1)

    def _shade(self, facing: Tensor) -> Tensor:
        """The light [B, ..., 3] for n · direction [B, ...]."""

        def glow(intensity: str, color: str) -> Tensor:
            strength = scalar(intensity, getattr(self, intensity), facing.dtype, facing.device)
            rgb = parameter(color, getattr(self, color), (3,), facing.dtype, facing.device)
            rgb = rgb * (strength[:, None] if isinstance(strength, Tensor) and strength.ndim else strength)
            batch_size(corners=facing.shape[0], **{color: batch_of(rgb, 1)})
            return rgb.reshape(-1, *(1,) * (facing.ndim - 1), 3)

        ambient, directional = glow("ambient", "ambient_color"), glow("directional", "directional_color")
        return ambient + directional * torch.relu(facing)[..., None]
