"""Attributes and constructors of `Camera`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from ..base import validate
from ..raster.ops.project_corners import rotate
from .distortion import lens_model
from .lens import calibration, check_intrinsics, check_rotation, half_angle, image_size, viewing_angle
from .matrices import clip_frame, clip_range, view_frame
from .parameters import (
    Array,
    Scalar,
    batch_of,
    batch_size,
    common_device,
    float_type,
    outside,
    parameter,
    scalar,
)
from .view import look_at_frame, look_frame

if TYPE_CHECKING:
    from typing_extensions import Self

_DEFAULT_ANGLE = 30.0  # half the field of view in degrees


@dataclass(frozen=True, eq=False, repr=False)
class Constructors:
    """Base of `Camera`, with its attributes and constructors."""

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
            if name == "dist_coeffs" and (model := lens_model(value)) is not None:
                size = (model.coefficients,)
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
        viewing_angle: Scalar | None = None,
        *,
        fov: Scalar | None = None,
        orthographic: bool = False,
        scale: Scalar = 1.0,
        mirrored: bool = False,
    ) -> Self:
        """Make cameras at ``eye`` that look at the points ``at``.

        Args:
            eye: Position, [3] or [B, 3] in world units: list, tuple, array or tensor.
            at: Point at the image's centre, in the same forms.
            up: Direction that is up in the image, in the same forms, of any length.
            viewing_angle: **Half** the vertical field of view in degrees, in (0, 90): a number, or a tensor [] or [B].
                The default is 30.
            fov: Whole vertical field of view in degrees, in (0, 180), in place of ``viewing_angle``.
            orthographic: Draw without perspective, with ``scale`` in place of an angle.
            scale: Screen units per world unit: a number, or a tensor [] or [B]. The image is 2 screen units high.
            mirrored: Mirror the image, as the old functions do.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: As the functions `look_at` and `perspective`.

        Example:
            >>> around = nr.get_points_from_angles(2.7, 30.0, torch.arange(0.0, 360.0, 90.0))
            >>> camera = nr.Camera.look_at(around, fov=40)
            >>> camera.position.shape, camera.viewing_angle
            (torch.Size([4, 3]), 20.0)
        """
        angle = half_angle(viewing_angle, fov, _DEFAULT_ANGLE)
        dtype = float_type(eye, at, up, angle, scale)
        frame = look_at_frame(eye, at, up, dtype, mirrored)
        return cls._with_lens(*frame, angle, orthographic, scale, mirrored)

    @classmethod
    def look(
        cls,
        eye: Array,
        direction: Array,
        up: Array = (0.0, 1.0, 0.0),
        viewing_angle: Scalar | None = None,
        *,
        fov: Scalar | None = None,
        orthographic: bool = False,
        scale: Scalar = 1.0,
        mirrored: bool = False,
    ) -> Self:
        """Make cameras at ``eye`` that look along ``direction``.

        Args:
            direction: Viewing direction, [3] or [B, 3], of any length.
            eye, up, viewing_angle, fov, orthographic, scale, mirrored: As in `Camera.look_at`.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: As the functions `look` and `perspective`.
        """
        angle = half_angle(viewing_angle, fov, _DEFAULT_ANGLE)
        dtype = float_type(eye, direction, up, angle, scale)
        frame = look_frame(eye, direction, up, dtype, mirrored)
        return cls._with_lens(*frame, angle, orthographic, scale, mirrored)

    @classmethod
    def weak_perspective(cls, scale: Scalar, R: Array, shift: Array = (0.0, 0.0), *, distance: float = 10.0) -> Self:
        """Make scaled orthographic cameras, as predicted by single-image networks.

        A world point X appears at scale · (R X)_xy + shift in an image over [−1, 1]²; its depth is (R X)_z + distance.
        As in OpenCV, the camera's axes point to the right, **down** and forward.

        Args:
            scale: Screen units per world unit, > 0: a number, or a tensor [] or [B].
            R: [3, 3] or [B, 3, 3], world-to-camera rotation.
            shift: [2] or [B, 2] in screen units, to the right and down.
            distance: Depth of the world's origin. Choose it so that the mesh lies between ``near`` and ``far``; the
                image does not depend on it.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: A type, shape or batch size does not fit, or R is no rotation (see `check_values`).

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
        translation = torch.cat((shift / across, shift.new_full((batch, 1), distance)), 1)
        origin = -rotate(R.transpose(1, 2), translation[:, None])[:, 0]
        up = R * R.new_tensor([1.0, -1.0, 1.0])[:, None]
        return cls(rotation=up, origin=origin, translation=torch.zeros_like(origin), scale=scale)

    @classmethod
    def projection(
        cls,
        K: Array,
        R: Array,
        t: Array,
        dist_coeffs: Array | None = None,
        orig_size: float | Sequence[float] | None = None,
    ) -> Self:
        """Make calibrated cameras in the conventions of OpenCV; see the function `projection`.

        Args:
            K: [3, 3] or [B, 3, 3], intrinsic matrix in pixels, with the third row (0, 0, 1).
            R: [3, 3] or [B, 3, 3], world-to-camera rotation.
            t: [3], [B, 3] or [B, 1, 3], world-to-camera translation; or columns [3, 1], [B, 3, 1].
            dist_coeffs: [5] or [B, 5], (k1, k2, p1, p2, k3), or the first four; or a column. None means no distortion.
            orig_size: Side or (height, width) in pixels of the image that K describes. Required. A render of any size
                shows this whole image, stretched if its aspect is different.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: A type or shape does not fit, ``orig_size`` is missing or not positive, or K or R has
                numbers that do not fit (see `check_values`).

        Example:
            >>> K = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]
            >>> camera = nr.Camera.projection(K, torch.eye(3), (0.0, 0.0, 3.0), orig_size=(480, 640))
            >>> images = nr.render(mesh, camera, (240, 320))
        """
        return cls._with_intrinsics(K, R, t, dist_coeffs, orig_size, 5)

    @classmethod
    def fisheye(
        cls,
        K: Array,
        R: Array,
        t: Array,
        dist_coeffs: Array | None = None,
        orig_size: float | Sequence[float] | None = None,
    ) -> Self:
        """Make calibrated fisheye cameras in the conventions of ``cv2.fisheye`` (also COLMAP's OPENCV_FISHEYE).

        A point at the angle θ from the viewing direction appears at the distance θ · (1 + k1·θ² + k2·θ⁴ + k3·θ⁶ +
        k4·θ⁸) from the axis, before the multiplication by K. Edges of faces are drawn straight, so that large faces
        need `Mesh.subdivide`. Depth is along the viewing direction, as for all cameras: what lies 90° or more off the
        axis is not drawn, and faces that reach beyond it are drawn inexactly near it.

        Args:
            K, R, t, orig_size: As in `Camera.projection`.
            dist_coeffs: [4] or [B, 4], (k1, k2, k3, k4), or a column. None means zeros, the equidistant lens.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: As `Camera.projection`.

        Example:
            >>> K = [[200.0, 0.0, 320.0], [0.0, 200.0, 240.0], [0.0, 0.0, 1.0]]
            >>> camera = nr.Camera.fisheye(K, torch.eye(3), (0.0, 0.0, 3.0), (0.1, 0.0, 0.0, 0.0), orig_size=(480, 640))
            >>> pixels, depth = camera.project(torch.tensor([[3.0, 0.0, 0.0]]))  # 45° to the right
            >>> pixels.round()
            tensor([[[487., 240.]]])
        """
        dist_coeffs = (0.0, 0.0, 0.0, 0.0) if dist_coeffs is None else dist_coeffs
        return cls._with_intrinsics(K, R, t, dist_coeffs, orig_size, 4)

    @classmethod
    def from_matrix(
        cls,
        *,
        world_to_camera: Array | None = None,
        camera_to_world: Array | None = None,
        convention: str = "opencv",
        viewing_angle: Scalar | None = None,
        fov: Scalar | None = None,
        K: Array | None = None,
        dist_coeffs: Array | None = None,
        orig_size: float | Sequence[float] | None = None,
        fisheye: bool = False,
        orthographic: bool = False,
        scale: Scalar = 1.0,
    ) -> Self:
        """Make cameras from view matrices of other programs, with one of three lenses.

        Args:
            world_to_camera: View matrix, [3, 4], [4, 4] or with a batch: a rotation and a translation.
            camera_to_world: Its inverse, the pose of the camera. Give one of the two.
            convention: Axes of the camera. ``"opencv"`` (also COLMAP): right, down, forward. ``"opengl"`` and
                ``"blender"`` (also NeRF): right, up, backward. ``"pytorch3d"``: left, up, forward, and the matrix [4,
                4] multiplies rows of points from the right, as that of ``Transform3d.get_matrix()``. The world's axes
                are not changed.
            K, dist_coeffs, orig_size: As in `Camera.projection`, in place of an angle. Pixels run to the right
                and **down** in every convention.
            fisheye: Whether K belongs to a fisheye lens, with the four coefficients of `Camera.fisheye`.
            viewing_angle, fov, orthographic, scale: As in `Camera.look_at`, without a default.

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: A type or shape does not fit, the convention is unknown, or the number of matrices
                or of lenses is not 1; while values are checked, also a matrix that is not a rotation and a translation.

        Example:
            >>> pose = torch.eye(4)
            >>> pose[2, 3] = 3.0  # three units along +z, looking back at the origin
            >>> camera = nr.Camera.from_matrix(camera_to_world=pose, convention="blender", viewing_angle=20)
            >>> camera(torch.tensor([[0.0, 0.5, 0.0]]))[0, 0]
            tensor([0.0000, 0.4579, 3.0000])
        """
        viewing_angle = half_angle(viewing_angle, fov)
        if [viewing_angle is not None, K is not None, validate.flag("orthographic", orthographic)].count(True) != 1:
            raise ValueError("viewing_angle: expected one lens: this, fov, K with orig_size, or orthographic=True")
        given = (world_to_camera, camera_to_world, K, viewing_angle, scale)
        dtype, device = float_type(*given), common_device(*given)
        R, eye, t = view_frame(world_to_camera, camera_to_world, convention, dtype, device)
        if K is not None:
            if validate.flag("fisheye", fisheye):
                return cls.fisheye(K, R, t, dist_coeffs, orig_size)
            return cls.projection(K, R, t, dist_coeffs, orig_size)
        axes = R * R.new_tensor([1.0, -1.0, 1.0])[:, None]  # right, up, forward
        return cls._with_lens(axes, eye, viewing_angle, orthographic, scale, False)

    @classmethod
    def from_clip(cls, matrix: Array) -> Self:
        """Make cameras from matrices to clip space: the product of projection and view matrix of OpenGL or nvdiffrast.

        A world point X has clip coordinates (x, y, z, w) = matrix · (X, 1) and appears at (x / w, y / w), y up. Its
        depth is the distance along the viewing direction in world units, whatever the scale of the matrix; ``near`` and
        ``far`` of `render` replace those of the matrix, which `clip_range` reads. Images of any size show the whole
        range [−1, 1]², so that the matrix determines the aspect.

        Args:
            matrix: [4, 4] or [B, 4, 4], for columns of points. A matrix whose second row is negated, for images with
                row 0 at the bottom, gives images upside down: negate the row first.

        Returns:
            B cameras, with K for an image of 2 × 2 pixels.

        Raises:
            TypeError, ValueError: A type or shape does not fit, or a matrix has no perspective (see `check_values`).

        Example:
            >>> f, near, far = 2.0, 0.1, 10.0
            >>> projection = torch.tensor([[f, 0, 0, 0], [0, f, 0, 0], [0, 0, -1, -2 * near], [0, 0, -1, 0]])
            >>> view = torch.eye(4)
            >>> view[2, 3] = -3.0
            >>> camera = nr.Camera.from_clip(projection @ view)
            >>> camera(torch.tensor([[0.0, 0.5, 0.0]]))[0, 0]
            tensor([0.0000, 0.3333, 3.0000])
        """
        K, R, t, mirrored = clip_frame(matrix, float_type(matrix), common_device(matrix))
        return cls(R, torch.zeros_like(t), t, K=K, orig_size=(2.0, 2.0), mirrored=mirrored)

    @staticmethod
    def clip_range(matrix: Array) -> tuple[float, float]:
        """Read ``near`` and ``far`` for `render` from a matrix to clip space, where z / w runs from −1 to 1.

        Args:
            matrix: [4, 4], or [B, 4, 4] with one range: as for `from_clip`, or a projection matrix alone.

        Returns:
            The depths of the near and of the far plane, in world units. ``far`` is the largest float32 for a plane at
            infinity.

        Raises:
            TypeError, ValueError: A type or shape does not fit, z is no function of the depth, or ranges differ.

        Example:
            >>> f, near, far = 2.0, 0.5, 10.0
            >>> z = (far + near) / (near - far), 2 * far * near / (near - far)
            >>> near, far = nr.Camera.clip_range([[f, 0, 0, 0], [0, f, 0, 0], [0, 0, *z], [0, 0, -1, 0]])
            >>> round(near, 6), round(far, 6)
            (0.5, 10.0)
        """
        return clip_range(matrix, common_device(matrix))

    @classmethod
    def _with_lens(
        cls, rotation: Tensor, eye: Tensor, angle: Any, is_orthographic: bool, scale: Any, mirrored: bool
    ) -> Self:
        """Make cameras from axes and eye, with a perspective or an orthographic lens."""
        lens: dict[str, Any]
        if is_orthographic:
            lens = {"scale": scalar("scale", scale, eye.dtype)}
        else:
            lens = {"viewing_angle": viewing_angle("viewing_angle", angle, eye.dtype)}
        sizes = {name: batch_of(value, 0) for name, value in lens.items()}
        batch = batch_size(camera=batch_of(rotation, 2), eye=batch_of(eye, 1), **sizes)
        origin = eye.expand(batch, 3)
        return cls(rotation.expand(batch, 3, 3), origin, torch.zeros_like(origin), mirrored=mirrored, **lens)

    @classmethod
    def _with_intrinsics(cls, K: Any, R: Any, t: Any, dist_coeffs: Any, orig_size: Any, coefficients: int) -> Self:
        """Make cameras from a calibration with this number of distortion coefficients."""
        if orig_size is None:
            raise ValueError("orig_size: expected the side or (height, width) of the image that K describes, got None")
        given = (K, R, t, dist_coeffs)
        K, R, t, dist_coeffs = calibration(*given, float_type(*given), common_device(*given), coefficients)
        check_intrinsics(K)
        check_rotation(R)
        batch = batch_size(K=batch_of(K, 2), R=batch_of(R, 2), t=batch_of(t, 1), dist_coeffs=batch_of(dist_coeffs, 1))
        t = t.expand(batch, 3)
        return cls(
            rotation=R.expand(batch, 3, 3),
            origin=torch.zeros_like(t),
            translation=t,
            K=K.expand(batch, 3, 3),
            dist_coeffs=None if dist_coeffs is None else dist_coeffs.expand(batch, coefficients),
            orig_size=image_size(orig_size),
        )
