"""Projection of vertices for the rasteriser; cameras without distortion take one fused operator."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from ..base import private, validate
from ..base.arrivals import capturing
from ..base.constants import on_device
from ..raster.faces import checked_faces, corner_indices, corners_of
from ..raster.ops.project_corners import project_corners, rotate
from ..raster.warp.kept import kept_with
from ..raster.warp.layout import images_of
from ..raster.warp.registration import is_eager
from .camera import Camera, rotation_and_position
from .distortion import lens_model
from .lens import viewing_angle
from .parameters import batch_of, batch_size, scalar


def scene_camera(vertices: Any, camera: Any) -> tuple[Any, Camera]:
    """Check the camera of a scene; return its vertices and the camera.

    Without a camera, vertices are (x, y, z, w) in clip space, [V, 4] or [B, V, 4]. They become points (x, y, w) of a
    camera that projects them to the same pixels; ValueError if w shows no perspective projection.
    """
    if isinstance(camera, Camera):
        return vertices, camera
    if camera is not None:
        raise TypeError(f"camera: expected a Camera, or None for vertices in clip space, got {type(camera).__name__}")
    with validate.called(vertices="vertices without a camera"):
        validate.floating("vertices", vertices, ("V", 4) if getattr(vertices, "ndim", 3) == 2 else ("B", "V", 4))
    x, y, z, w = vertices.unbind(-1)
    if validate.values_are_checked(vertices) and bool((w == 1).all()) and bool((z != z.flatten()[:1]).any()):
        raise ValueError(
            "vertices: expected clip coordinates of a perspective projection, got w = 1 for all; "
            "for a view without perspective use world vertices and Camera.from_matrix(..., orthographic=True)"
        )
    return torch.stack((x, y, w), -1), _clip_camera()


@lru_cache(maxsize=1)
def _clip_camera() -> Camera:
    """Make the camera that projects a point (x, y, w) to (x / w, y / w), with the depth w."""
    with torch.inference_mode(False):
        return Camera.from_clip(torch.eye(4, device="cpu")[[0, 1, 3, 2]])


def causes(vertices: Tensor, camera: Camera) -> tuple[Tensor, ...]:
    """Return the tensors that screen positions depend on, vertices first."""
    lens = (camera.rotation, camera.origin, camera.translation, camera.viewing_angle, camera.scale, camera.K)
    return vertices, *(part for part in lens if isinstance(part, Tensor))


def screen_corners(camera: Camera, vertices: Tensor, faces: Any, aspect: float) -> tuple[Tensor, Tensor]:
    """Project the corners of faces: [B, F, 3, 3] float32, and the faces as from `checked_faces`.

    Values and errors are those of ``camera(vertices, aspect)``, `checked_faces` and `corners_of`, in this order. Only
    first derivatives are defined. ValueError: A position overflows float32.
    """
    simple = _pinhole(camera, vertices)
    if camera.K is not None and camera.orig_size is not None:
        aspect = 1.0  # K includes it
    if simple is None:
        screen = validate.in_float32("vertices on the screen", _by_camera(camera, vertices, aspect))
        faces = checked_faces(faces)
        return corners_of(screen, faces), faces
    points, rotation, origin, width = simple
    faces = checked_faces(faces)
    indices = corner_indices(points, faces, images_of(*simple))
    return project_corners(points, indices, rotation, origin, width, aspect, camera.perspective), faces


def _pinhole(camera: Camera, vertices: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor] | None:
    """Return the points, rotation, origin and width for the operator `project_corners`; None for other cameras."""
    if type(camera) is not Camera or camera.dist_coeffs is not None:
        return None
    parts = causes(vertices, camera)
    if not is_eager(parts) or getattr(vertices, "dtype", None) != torch.float32:
        return None
    validate.vertices(vertices)
    rotation, origin, width = kept_with(camera, "view", parts[1:], vertices.device, lambda: _view(camera, vertices))
    views, meshes = rotation.shape[0], batch_of(vertices, 2)
    if meshes != 1:
        batch_size(vertices=meshes, camera=views)
    if width.shape[0] != 1:
        name = "angle" if camera.viewing_angle is not None else "scale"
        batch_size(vertices=max(views, meshes), **{name: width.shape[0]})
    return vertices if vertices.dim() == 3 else vertices[None], rotation, origin, width


def _view(camera: Camera, like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the rotation, origin and width of a pinhole on the device of vertices."""
    if camera.K is None or camera.orig_size is None:
        rotation, origin = rotation_and_position(camera, like)
    else:
        rotation, origin = _with_lens(camera, camera.K, camera.orig_size, like)
    return rotation, origin, _width(camera, like.device)


def _with_lens(camera: Camera, intrinsics: Tensor, size: tuple[float, float], like: Tensor) -> tuple[Tensor, Tensor]:
    """Return the axes and the position of a pinhole of width 1 that is equivalent to a camera with K [1 or B, 3, 3].

    The axes, [1 or B, 3, 3], include the scale and the shift of K: they are neither perpendicular nor of length 1.
    """
    parts = intrinsics, camera.rotation, camera.origin, camera.translation
    lens, rotation, origin, translation = (on_device(part, like).double() for part in parts)
    height, width = size
    last = torch.eye(3, dtype=lens.dtype, device=like.device)[2].expand_as(lens[..., 2, :])
    across = torch.stack((2 * lens[..., 0, :] / width - last, last - 2 * lens[..., 1, :] / height, last), -2)
    x, y, z = rotation.unbind(-2)
    # The exact inverse, because a rotation that was rounded is not orthogonal.
    cross = torch.linalg.cross
    inverse = torch.stack((cross(y, z), cross(z, x), cross(x, y)), -1) / (x * cross(y, z)).sum(-1)[..., None, None]
    position = origin - rotate(inverse, translation[..., None, :])[..., 0, :]
    return rotate(rotation.mT, across).float(), position.float()


def _by_camera(camera: Camera, vertices: Tensor, aspect: float) -> Tensor:
    """Project vertices as ``camera`` does, but mirror points behind a fisheye."""
    screen = camera(vertices, aspect=aspect)
    model = lens_model(camera.dist_coeffs)
    if model is None or not model.shows_behind:
        return screen
    position, depth = screen[..., :2], screen[..., 2:]
    # A pinhole mirrors them, too, and the rasteriser relies on it where it clips faces at the camera's plane.
    return torch.cat((torch.where(depth < 0, -position, position), depth), -1)


def _width(camera: Camera, device: torch.device) -> Tensor:
    """Return the tangent of half the field of view, or the scale of an orthographic camera, [1 or B] float32."""
    is_angle = camera.viewing_angle is not None
    width: Any
    if camera.K is not None and camera.orig_size is not None:
        is_angle, width = False, 1.0  # K includes it
    elif is_angle:
        width = viewing_angle("angle", camera.viewing_angle, torch.float32, device)
    else:
        width = scalar("scale", camera.scale, torch.float32, device)
    if not isinstance(width, Tensor):
        # A tensor that is made inside a transformation of torch.func, or in a CUDA graph, must not outlive it.
        kept = not (private.transforms_active() or capturing(device))
        return (_constant if kept else _constant.__wrapped__)(width, is_angle, device)
    return (torch.tan(torch.deg2rad(width)) if is_angle else width).reshape(-1)


@lru_cache(maxsize=64)
def _constant(width: float, is_angle: bool, device: torch.device) -> Tensor:
    with torch.inference_mode(False):
        value = torch.full((1,), width, dtype=torch.float32, device=device)  # no copy: a CUDA graph can capture it
        return torch.tan(torch.deg2rad(value)) if is_angle else value
