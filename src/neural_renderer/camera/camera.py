"""A batch of cameras as one value."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from .. import validate
from .calibrated import CalibratedCamera
from .lens import check_rotation
from .parameters import Array, Scalar, batch_of, batch_size, common_device, float_type, outside, parameter, scalar
from .several import chosen, concatenated
from .view import look_at_frame, look_frame, rotate


@dataclass(frozen=True, eq=False, repr=False)
class Camera(CalibratedCamera):
    """A batch of B cameras: ``camera(vertices)`` projects world vertices onto the screen.

    Build it with `Camera.look_at`, `Camera.look`, `Camera.projection`, `Camera.fisheye`, `Camera.from_matrix`,
    `Camera.from_clip` or `Camera.weak_perspective`. ``camera[i]`` and ``camera[2:5]`` are some cameras of the batch,
    ``for one in camera`` visits them one by one, and `Camera.cat` puts batches together.

    The world is right-handed and the picture is not mirrored: x of the screen points to the right of the viewer
    (viewing direction × up). Faces that are counter-clockwise seen from outside are counter-clockwise on the screen.
    ``mirrored=True`` gives the mirror image, as the old functions `look_at` and `look` do.

    Numbers and arrays become tensors of torch's default dtype, or of the dtype of a tensor given with them. A camera is
    immutable. Each call copies its tensors to the vertices' device and dtype; `to` saves these copies. Gradients flow
    to the tensors that the camera was built from.

    Attributes:
        rotation: [B, 3, 3], the camera's axes as rows. Camera coordinates of a world point X are
            rotation · (X − origin) + translation.
        origin: [B, 3], the eye (zero for `projection`).
        translation: [B, 3], the ``t`` of `projection` (zero for the others).
        viewing_angle: Half the **vertical** field of view in degrees, a number or [B]; None for other lenses.
        scale: Screen units per world unit, a number or [B]; used if ``viewing_angle`` and ``K`` are None.
        K: [B, 3, 3], the intrinsic matrix of `projection` in pixels; None otherwise.
        dist_coeffs: [B, 5], the distortion of `projection`; [B, 4], that of `fisheye`; or None.
        orig_size: (height, width) in pixels of the image that K describes.
        mirrored: Whether the picture is a mirror image.

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or ``orig_size`` is missing for K; while values are
            checked, also a number that is not finite.

    Example:
        >>> camera = nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)
        >>> x, y, depth = camera(torch.zeros(1, 3))[0, 0]  # the origin, at the image's centre
        >>> depth
        tensor(2.6926)
    """

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
        """Make cameras at ``eye`` that look at the points ``at``.

        Args:
            eye: Position, [3] or [B, 3] in world units: list, tuple, array or tensor.
            at: Point at the image's centre, likewise.
            up: Direction that is up in the picture, likewise, of any length.
            viewing_angle: Half the vertical field of view in degrees, in (0, 90): a number, or a tensor [] or [B].
            orthographic: Draw without perspective, with ``scale`` in place of ``viewing_angle``.
            scale: Screen units per world unit: a number, or a tensor [] or [B]. The image is 2 screen units high.
            mirrored: Mirror the picture, as the old functions do.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: As the functions `look_at` and `perspective`.

        Example:
            >>> around = nr.get_points_from_angles(2.7, 30.0, torch.arange(0.0, 360.0, 90.0))
            >>> len(nr.Camera.look_at(around))
            4
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
        """Make cameras at ``eye`` that look along ``direction``.

        Args:
            eye: Position, [3] or [B, 3] in world units: list, tuple, array or tensor.
            direction: Viewing direction, likewise, of any length.
            up, viewing_angle, orthographic, scale, mirrored: As in `Camera.look_at`.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: As the functions `look` and `perspective`.

        Example:
            >>> camera = nr.Camera.look((0.0, 1.0, -2.5), direction=(0.0, -0.4, 1.0))
            >>> images = nr.render(mesh, camera, 64)
        """
        dtype = float_type(eye, direction, up, viewing_angle, scale)
        frame = look_frame(eye, direction, up, dtype, mirrored)
        return cls._with_lens(*frame, viewing_angle, orthographic, scale, mirrored)

    @classmethod
    def weak_perspective(cls, scale: Scalar, R: Array, shift: Array = (0.0, 0.0), *, distance: float = 10.0) -> Camera:
        """Make scaled orthographic cameras, as predicted by single-image networks.

        A world point X appears at scale · (R X)_xy + shift in an image over [−1, 1]²; its depth is (R X)_z + distance.
        As in OpenCV, the camera's axes point to the right, **down** and forward.

        Args:
            scale: Screen units per world unit, > 0: a number, or a tensor [] or [B].
            R: [3, 3] or [B, 3, 3], world-to-camera rotation.
            shift: [2] or [B, 2] in screen units, to the right and down.
            distance: Depth of the world's origin. Choose it so that the mesh lies between ``near`` and ``far``; the
                picture does not depend on it.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: A type, shape or batch size does not fit; while values are checked, also R is not a
                rotation.

        Example:
            >>> camera = nr.Camera.weak_perspective(0.8, torch.eye(3), (0.1, 0.0))
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

    @classmethod
    def cat(cls, cameras: Sequence[Camera]) -> Camera:
        """Put the cameras of several batches into one batch.

        Args:
            cameras: Cameras of one kind of lens: with a viewing angle, orthographic, or with K. Those with K may
                differ in ``orig_size``; the result has that of the first.

        Returns:
            As many cameras as in all batches together, in order.

        Raises:
            TypeError, ValueError: An item is not a Camera, there is none, or they differ in lens, device or mirroring.

        Example:
            >>> left, right = nr.Camera.look_at((-1.0, 0.0, -2.5)), nr.Camera.look_at((1.0, 0.0, -2.5))
            >>> len(nr.Camera.cat([left, right]))
            2
        """
        if not isinstance(cameras, (list, tuple)) or not all(isinstance(camera, Camera) for camera in cameras):
            kinds = [type(one).__name__ for one in cameras] if isinstance(cameras, (list, tuple)) else type(cameras)
            raise TypeError(f"cameras: expected a list of Camera, got {kinds}")
        if not cameras:
            raise ValueError("cameras: expected at least one Camera, got an empty list")
        return replace(cameras[0], **concatenated(cameras))

    def __getitem__(self, index: Any) -> Camera:
        """Choose cameras: one by a number, several by a slice, a list, or a tensor of numbers or of bools."""
        return replace(self, **chosen(self, index))

    def __iter__(self) -> Iterator[Camera]:
        return (self[i] for i in range(len(self)))
