"""Cameras from calibrations and matrices of other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from .. import validate
from .lens import calibration, check_intrinsics, check_rotation, image_size, viewing_angle
from .matrices import clip_frame, view_frame
from .model import CameraModel
from .parameters import Array, Scalar, batch_of, batch_size, common_device, float_type, scalar

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, eq=False, repr=False)
class CalibratedCamera(CameraModel):
    """Constructors of `Camera` from calibrations and matrices."""

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
            TypeError, ValueError: A type or shape does not fit, or ``orig_size`` is missing or not positive; while
                values are checked, also a number that is not finite, a wrong third row of K, or R is not a rotation.

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
            K: [3, 3] or [B, 3, 3], intrinsic matrix in pixels, with the third row (0, 0, 1).
            R: [3, 3] or [B, 3, 3], world-to-camera rotation.
            t: [3], [B, 3] or [B, 1, 3], world-to-camera translation; or columns [3, 1], [B, 3, 1].
            dist_coeffs: [4] or [B, 4], (k1, k2, k3, k4), or a column. None means zeros, the equidistant lens.
            orig_size: Side or (height, width) in pixels of the image that K describes. Required, as in
                `Camera.projection`.

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
                stay as they are.
            viewing_angle: Half the vertical field of view in degrees, in (0, 90): a number, or a tensor [] or [B].
            K, dist_coeffs, orig_size: As in `Camera.projection`, in place of ``viewing_angle``. Pixels run to the right
                and **down** in every convention.
            fisheye: Whether K belongs to a fisheye lens, with the four coefficients of `Camera.fisheye`.
            orthographic: Draw without perspective, with ``scale`` in place of ``viewing_angle``.
            scale: Screen units per world unit: a number, or a tensor [] or [B].

        Returns:
            B cameras; one if no argument has a batch.

        Raises:
            TypeError, ValueError: A type or shape does not fit, the convention is unknown, or not one matrix and one
                lens are given; while values are checked, also a matrix that is not a rotation and a translation.

        Example:
            >>> pose = torch.eye(4)
            >>> pose[2, 3] = 3.0  # three units along +z, looking back at the origin
            >>> camera = nr.Camera.from_matrix(camera_to_world=pose, convention="blender", viewing_angle=20)
            >>> camera(torch.tensor([[0.0, 0.5, 0.0]]))[0, 0]
            tensor([0.0000, 0.4579, 3.0000])
        """
        if [viewing_angle is not None, K is not None, validate.flag("orthographic", orthographic)].count(True) != 1:
            raise ValueError("viewing_angle: expected one lens: this, K with orig_size, or orthographic=True")
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
        ``far`` of `render` replace those of the matrix. Images of any size show the whole range [−1, 1]², so that the
        matrix determines the aspect.

        Args:
            matrix: [4, 4] or [B, 4, 4], for columns of points. A matrix whose second row is negated, for images with
                row 0 at the bottom, gives pictures upside down: negate the row first.

        Returns:
            B cameras, with K for an image of 2 × 2 pixels.

        Raises:
            TypeError, ValueError: A type or shape does not fit; while values are checked, also a matrix without
                perspective, or one that projects to a line.

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

    @classmethod
    def _with_intrinsics(cls, K: Any, R: Any, t: Any, dist_coeffs: Any, orig_size: Any, coefficients: int) -> Self:
        """Make cameras from a calibration with this number of coefficients."""
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
