"""Ambient and directional light on flat faces (section "Lighting" of the Neural 3D Mesh Renderer paper)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from . import validate
from .camera.arguments import Array, Scalar, batch_of, batch_size, parameter, scalar

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


def face_normals(corners: Tensor) -> Tensor:
    """Unit normals of faces: corners [..., 3, 3] → [..., 3], along (v0 − v1) × (v2 − v1), as in the published code.

    This is the side from which the corners run **clockwise** in a right-handed world. A face without area has a
    normal shorter than 1, down to zero; values and gradients are finite.
    """
    v0, v1, v2 = corners.unbind(-2)
    a, b = v0 - v1, v2 - v1
    normal = torch.linalg.cross(a, b, dim=-1)
    # The published floor of 1e-5 is an area: alone it would darken the small faces of a fine mesh. Measured against
    # the face's own size it only catches slivers, and for faces larger than a unit it is the published one.
    size = torch.maximum((a * a).sum(-1, keepdim=True), (b * b).sum(-1, keepdim=True)).detach()
    floor = 1e-5 * size.clamp(1e-12, 1)
    return normal / torch.maximum(torch.linalg.vector_norm(normal, dim=-1, keepdim=True), floor)


def face_light(
    corners: Tensor,
    intensity_ambient: Scalar = 0.5,
    intensity_directional: Scalar = 0.5,
    color_ambient: Array = _WHITE,
    color_directional: Array = _WHITE,
    direction: Array = _UP,
) -> Tensor:
    """The light on each face as the published renderer computes it, [B, F, 3 colours].

    It lights the side of (v0 − v1) × (v2 − v1): the one seen through the mirroring cameras of `look_at` and `look`
    where the corners run counter-clockwise on the screen. Arguments as `lighting`; differentiable in all of them.
    """
    light = Light(intensity_ambient, intensity_directional, color_ambient, color_directional, direction)
    return light._shade(light._facing(corners))


def lighting(
    faces: Tensor,
    textures: Tensor,
    intensity_ambient: Scalar = 0.5,
    intensity_directional: Scalar = 0.5,
    color_ambient: Array = _WHITE,
    color_directional: Array = _WHITE,
    direction: Array = _UP,
) -> Tensor:
    """Textures under light: each face's texture times its `face_light`.

    Args:
        faces: the faces' corners in world space, [B, F, 3 corners, 3 coordinates], floating.
        textures: [B, F, T, T, T, 3], floating, T at least 2; they are not changed.
        intensity_ambient, intensity_directional: numbers, or tensors [] or [B].
        color_ambient, color_directional: RGB, [3] or [B, 3]: list, tuple, array or tensor.
        direction: towards the light, likewise; it is used as it is, so its length counts.

    Returns:
        New textures [B, F, T, T, T, 3]. Differentiable in all arguments.

    Raises:
        TypeError, ValueError: wrong types or shapes; numbers that are not finite if values are checked.
    """
    validate.floating("faces", faces, ("B", "F", 3, 3))
    validate.cubes("textures", textures, "B", faces.shape[1])
    validate.same_device(faces=faces, textures=textures)
    batch_size(faces=faces.shape[0], textures=textures.shape[0])
    validate.finite("faces", faces)
    validate.finite("textures", textures)
    light = face_light(faces, intensity_ambient, intensity_directional, color_ambient, color_directional, direction)
    return textures * light[:, :, None, None, None, :]
