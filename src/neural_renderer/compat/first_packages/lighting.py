"""`lighting` of the first packages."""

from __future__ import annotations

from torch import Tensor

from ...base import validate
from ...camera.parameters import Array, Scalar, batch_size
from ...shading.lights import Light

_WHITE = (1.0, 1.0, 1.0)
_UP = (0.0, 1.0, 0.0)


def lighting(
    faces: Tensor,
    textures: Tensor,
    intensity_ambient: Scalar = 0.5,
    intensity_directional: Scalar = 0.5,
    color_ambient: Array = _WHITE,
    color_directional: Array = _WHITE,
    direction: Array = _UP,
) -> Tensor:
    """Multiply textures by the light on their faces.

    A face is lit by intensity_ambient · color_ambient + intensity_directional · color_directional · max(n · direction,
    0), with its unit normal n along (v0 − v1) × (v2 − v1). In the mirrored images of `look_at` and `look`, the corners
    on the lit side run counter-clockwise.

    Args:
        faces: [B, F, 3 corners, 3] floating, corners of faces in world space.
        textures: [B, F, T, T, T, 3] floating, T ≥ 1.
        intensity_ambient, intensity_directional: Number, or tensor [] or [B].
        color_ambient, color_directional: RGB, [3] or [B, 3]: list, tuple, array or tensor.
        direction: Vector towards the light, [3] or [B, 3]. It is not normalised: its length scales the light.

    Returns:
        New textures [B, F, T, T, T, 3]. Differentiable in all arguments.

    Raises:
        TypeError, ValueError: A type or shape does not fit; while values are checked, also a number that is not finite.

    Example:
        >>> vertices, faces, textures = mesh.get_batch(1)
        >>> lit = nr.lighting(nr.vertices_to_faces(vertices, faces), textures, direction=(0.0, 0.0, -1.0))
    """
    validate.floating("faces", faces, ("B", "F", 3, 3))
    validate.cubes("textures", textures, "B", faces.shape[1])
    validate.same_device(faces=faces, textures=textures)
    batch_size(faces=faces.shape[0], textures=textures.shape[0])
    validate.finite("faces", faces)
    validate.finite("textures", textures)
    light = Light(intensity_ambient, intensity_directional, color_ambient, color_directional, direction)
    return textures * light._shade(light._facing(faces))[:, :, None, None, None, :]
