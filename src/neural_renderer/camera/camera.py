"""A batch of cameras as one value."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from .. import validate
from .lens import (
    calibration,
    check_intrinsics,
    check_rotation,
    image_size,
    in_parallel,
    in_perspective,
    pixels_to_screen,
    viewing_angle,
)
from .parameters import Array, Scalar, batch_of, batch_size, common_device, float_type, outside, parameter, scalar
from .view import look_at_frame, look_frame, rotate, transform


@dataclass(frozen=True, eq=False)
class Camera:
    """A batch of B cameras: ``camera(vertices)`` takes world vertices to the screen.

    Build it with `Camera.look_at`, `Camera.look`, `Camera.projection` or `Camera.weak_perspective`. The world is
    right-handed and the picture is not mirrored: x of the screen points to the right of the viewer (viewing direction ×
    up), and a face whose corners run counter-clockwise seen from outside runs counter-clockwise on the screen.
    ``mirrored=True`` gives the view of the old functions `look_at` and `look`, which is the mirror image.

    Numbers and arrays are taken in torch's default dtype, unless a tensor beside them has another. A camera is
    immutable. Its tensors are moved to the vertices' device and dtype at each call, so `to` only saves
    that copy. Gradients flow to whatever tensors it was built from.

    Attributes:
        rotation: [B, 3, 3], the camera's axes as rows; with the two below, a world point X has the camera coordinates
            rotation · (X − origin) + translation.
        origin: [B, 3], the eye (zero for `projection`).
        translation: [B, 3], the ``t`` of `projection` (zero for the others).
        viewing_angle: half the **vertical** field of view in degrees, a number or [B]; None without such a lens.
        scale: screen units per world unit, a number or [B]; used where there is neither a viewing angle nor K.
        K: [B, 3, 3], the intrinsic matrix of `projection`; None otherwise.
        dist_coeffs: [B, 5], its distortion, or None.
        orig_size: (height, width) of the image that K describes.
        mirrored: whether the picture is the mirror image of what a viewer sees.
    """

    rotation: Tensor
    origin: Tensor
    translation: Tensor
    viewing_angle: Scalar | None = None
    scale: Scalar = 1.0
    K: Tensor | None = None
    dist_coeffs: Tensor | None = None
    orig_size: tuple[float, float] | None = None
    mirrored: bool = False

    def __post_init__(self) -> None:
        validate.floating("rotation", self.rotation, ("B", 3, 3))
        validate.finite("rotation", self.rotation)
        for name, size in (("origin", (3,)), ("translation", (3,)), ("K", (3, 3)), ("dist_coeffs", (5,))):
            value = getattr(self, name)
            if value is not None or name in ("origin", "translation"):
                validate.floating(name, value, (len(self.rotation), *size))
                validate.same_device(rotation=self.rotation, **{name: value})
                validate.finite(name, value)
        if self.K is not None:
            image_size(self.orig_size)

    @classmethod
    def look_at(
        cls,
        eye: Array,
        at: Array = (0.0, 0.0, 0.0),
        up: Array = (0.0, 1.0, 0.0),
        viewing_angle: Scalar = 30.0,
        *,
        orthographic: bool = False,
        scale: Scalar = 1.0,
        mirrored: bool = False,
    ) -> Camera:
        """Cameras at ``eye`` that look at the points ``at``.

        Args:
            eye, at, up: [3] or [B, 3] each, in world units: lists, tuples, arrays or tensors (see the function
                `look_at`).
            viewing_angle: half the vertical field of view in degrees, in (0, 90): a number, or a tensor [] or [B].
            orthographic: no perspective; ``scale`` is used in place of ``viewing_angle``.
            scale: screen units per world unit, where the image is 2 high: a number, or a tensor [] or [B].
            mirrored: the mirror image, as the old functions show it.

        Raises:
            TypeError, ValueError: as the function `look_at` and `perspective`.
        """
        dtype = float_type(eye, at, up, viewing_angle, scale)
        frame = look_at_frame(eye, at, up, dtype, mirrored)
        return cls._with_lens(*frame, viewing_angle, orthographic, scale, mirrored)

    @classmethod
    def look(
        cls,
        eye: Array,
        direction: Array,
        up: Array = (0.0, 1.0, 0.0),
        viewing_angle: Scalar = 30.0,
        *,
        orthographic: bool = False,
        scale: Scalar = 1.0,
        mirrored: bool = False,
    ) -> Camera:
        """Cameras at ``eye`` that look along ``direction``, [3] or [B, 3]; everything else as `Camera.look_at`."""
        dtype = float_type(eye, direction, up, viewing_angle, scale)
        frame = look_frame(eye, direction, up, dtype, mirrored)
        return cls._with_lens(*frame, viewing_angle, orthographic, scale, mirrored)

    @classmethod
    def projection(
        cls,
        K: Array,
        R: Array,
        t: Array,
        dist_coeffs: Array | None = None,
        orig_size: float | Sequence[float] | None = None,
    ) -> Camera:
        """Calibrated cameras in the conventions of OpenCV: see the function `projection`.

        Args:
            K: [3, 3] or [B, 3, 3], intrinsic matrix in pixels, with the third row (0, 0, 1).
            R: [3, 3] or [B, 3, 3], world-to-camera rotation.
            t: [3], [B, 3] or [B, 1, 3], world-to-camera translation.
            dist_coeffs: [5] or [B, 5], (k1, k2, p1, p2, k3); None is no distortion.
            orig_size: Side or (height, width) in pixels of the image that K describes; it has no default. A render of
                any size shows this whole image, stretched if its aspect is another.

        Raises:
            TypeError, ValueError: A type or shape does not fit, or ``orig_size`` is missing or not positive; while
                values are checked, also numbers that are not finite, another third row of K, and R that is no rotation.
        """
        if orig_size is None:
            raise ValueError("orig_size: expected the side or (height, width) of the image that K describes, got None")
        given = (K, R, t, dist_coeffs)
        K, R, t, dist_coeffs = calibration(*given, float_type(*given), common_device(*given))
        check_intrinsics(K)
        check_rotation(R)
        batch = batch_size(K=batch_of(K, 2), R=batch_of(R, 2), t=batch_of(t, 1), dist_coeffs=batch_of(dist_coeffs, 1))
        t = t.expand(batch, 3)
        return cls(
            rotation=R.expand(batch, 3, 3),
            origin=torch.zeros_like(t),
            translation=t,
            K=K.expand(batch, 3, 3),
            dist_coeffs=None if dist_coeffs is None else dist_coeffs.expand(batch, 5),
            orig_size=image_size(orig_size),
        )

    @classmethod
    def weak_perspective(cls, scale: Scalar, R: Array, shift: Array = (0.0, 0.0), *, distance: float = 10.0) -> Camera:
        """Scaled orthographic cameras, as networks that see one image predict them.

        A world point X appears at scale · (R X)_xy + shift of an image over [−1, 1]², its depth is (R X)_z + distance.
        As in `Camera.projection` and OpenCV, R turns the world into axes to the right, **down** and forward.

        Args:
            scale: a number above 0, or a tensor [] or [B].
            R: [3, 3] or [B, 3, 3], rotation.
            shift: [2] or [B, 2], to the right and down.
            distance: what puts the mesh between ``near`` and ``far``; the picture does not depend on it.

        Raises:
            TypeError, ValueError: wrong types or shapes, batches that do not fit.
        """
        dtype = float_type(scale, R, shift)
        device = common_device(scale, R, shift)
        scale = scalar("scale", scale, dtype, device)
        if outside(scale, 0.0, math.inf):
            raise ValueError(f"scale: expected a number above 0, got {scale}")
        R, shift = parameter("R", R, (3, 3), dtype, device), parameter("shift", shift, (2,), dtype, device)
        check_rotation(R)
        distance = validate.number("distance", distance, dtype)
        batch = batch_size(R=batch_of(R, 2), scale=batch_of(scale, 0), shift=batch_of(shift, 1))
        R, shift = R.expand(batch, 3, 3), shift.expand(batch, 2)
        across = scale[:, None] if isinstance(scale, Tensor) and scale.ndim else scale
        place = torch.cat((shift / across, shift.new_full((batch, 1), distance)), 1)
        origin = -rotate(R.transpose(1, 2), place[:, None])[:, 0]
        up = R * R.new_tensor([1.0, -1.0, 1.0])[:, None]
        return cls(rotation=up, origin=origin, translation=torch.zeros_like(origin), scale=scale)

    @property
    def perspective(self) -> bool:
        """Whether far things look smaller: False for an orthographic camera."""
        return self.viewing_angle is not None or self.K is not None

    def __len__(self) -> int:
        return self.rotation.shape[0]

    def __call__(self, vertices: Tensor, aspect: float = 1.0) -> Tensor:
        """World vertices [V, 3] or [B, V, 3] on the screen, [B, V, 3].

        One mesh is shown to all cameras and one camera shows all meshes. x (right) and y (up) are in [-1, 1] over the
        image; z is the depth along the viewing direction in world units, negative behind the camera.

        Args:
            vertices: floating; the result is float64 for float64, and float32 for all others.
            aspect: width / height of the image, by which x is divided so that pixels are square. Not used by
                `Camera.projection`, whose ``orig_size`` says it.

        Raises:
            TypeError, ValueError: wrong types or shapes, batches that do not fit, an aspect that is not positive;
                vertices that are not finite if values are checked.
        """
        vertices = validate.wide(validate.vertices(vertices))
        aspect = validate.positive("aspect", aspect)
        points = transform(vertices, self.rotation, self.origin)
        if self.K is not None and self.orig_size is not None:
            points = points + self.translation.to(points)[..., None, :]
            dist_coeffs = None if self.dist_coeffs is None else self.dist_coeffs.to(points)
            return pixels_to_screen(points, self.K.to(points), dist_coeffs, self.orig_size)
        if self.viewing_angle is not None:
            screen = in_perspective(points, self.viewing_angle)
        else:
            screen = in_parallel(points, self.scale)
        if aspect == 1:
            return screen
        x, y, z = screen.unbind(-1)
        return torch.stack((x / aspect, y, z), dim=-1)

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Camera:
        """The same cameras with their tensors on another device or of another floating dtype (TypeError otherwise)."""
        if not (dtype is None or (isinstance(dtype, torch.dtype) and dtype.is_floating_point)):
            raise TypeError(f"dtype: expected a floating dtype, got {dtype!r}")
        tensors = {f.name: v for f in fields(self) if isinstance(v := getattr(self, f.name), Tensor)}
        moved: dict[str, Any] = {name: v.to(device=device, dtype=dtype) for name, v in tensors.items()}
        return replace(self, **moved)

    @classmethod
    def _with_lens(
        cls, rotation: Tensor, eye: Tensor, angle: Any, is_orthographic: bool, scale: Any, mirrored: bool
    ) -> Camera:
        lens: dict[str, Any]
        if is_orthographic:
            lens = {"scale": scalar("scale", scale, eye.dtype)}
        else:
            lens = {"viewing_angle": viewing_angle("viewing_angle", angle, eye.dtype)}
        sizes = {name: batch_of(value, 0) for name, value in lens.items()}
        batch = batch_size(camera=batch_of(rotation, 2), eye=batch_of(eye, 1), **sizes)
        origin = eye.expand(batch, 3)
        return cls(rotation.expand(batch, 3, 3), origin, torch.zeros_like(origin), mirrored=mirrored, **lens)
