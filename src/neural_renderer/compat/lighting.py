"""`lighting` of the first packages: textures multiplied by the light on their faces."""

from __future__ import annotations

from torch import Tensor

from .. import validate
from ..camera.parameters import Array, Scalar, batch_size
from ..shading.lights import Light

_WHITE = (1.0, 1.0, 1.0)
_UP = (0.0, 1.0, 0.0)


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
        textures: [B, F, T, T, T, 3], floating, T at least 1; they are not changed.
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
