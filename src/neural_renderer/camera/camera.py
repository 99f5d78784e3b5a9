"""`Camera`, a batch of cameras."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ..base import validate
from ..base.constants import on_device
from ..raster.ops.project_corners import rotate
from .constructors import Constructors
from .distortion import BROWN_CONRADY, KANNALA_BRANDT, lens_model
from .lens import (
    image_size,
    in_parallel,
    in_perspective,
    pixels_to_screen,
    undo_intrinsics,
    viewing_angle,
)
from .parameters import (
    Array,
    Scalar,
    as_tensor,
    batch_of,
    batch_size,
    outside,
    scalar,
)
from .view import eye_position, transform


@dataclass(frozen=True, eq=False, repr=False)
class Camera(Constructors):
    """A batch of B cameras: ``camera(vertices)`` projects world vertices onto the screen.

    Build it with `Camera.look_at`, `Camera.look`, `Camera.projection`, `Camera.fisheye`, `Camera.from_matrix`,
    `Camera.from_clip` or `Camera.weak_perspective`. ``camera[i]`` and ``camera[2:5]`` select from the batch,
    ``for one in camera`` iterates over it, and `Camera.cat` concatenates batches.

    The world is right-handed and the image is not mirrored: x of the screen points to the right of the viewer
    (viewing direction × up). Faces that are counter-clockwise seen from outside are counter-clockwise on the screen.
    ``mirrored=True`` gives the mirror image, as the old functions `look_at` and `look` do.

    Numbers and arrays become tensors of torch's default dtype, or of the dtype of a tensor given with them. A camera is
    immutable. Each call copies its tensors to the vertices' device and dtype; `to` saves these copies. Gradients flow
    to the tensors that the camera was built from.

    Attributes:
        rotation: [B, 3, 3], the camera's axes as rows: right, up and forward; with K, OpenCV's R, as `projection` takes
            it and files store it: right, **down** and forward. `axes`, `position`, `forward` and `up` are the same for
            all cameras. Camera coordinates of a world point X are rotation · (X − origin) + translation.
        origin: [B, 3], the eye (zero for `projection`).
        translation: [B, 3], the ``t`` of `projection` (zero for the others).
        viewing_angle: **Half** the vertical field of view in degrees, a number or [B]; None for other lenses. `fov` is
            the whole angle.
        scale: Screen units per world unit, a number or [B]; used if ``viewing_angle`` and ``K`` are None.
        K: [B, 3, 3], the intrinsic matrix of `projection` in pixels; None otherwise.
        dist_coeffs: [B, 5], the distortion of `projection`; [B, 4], that of `fisheye`; or None.
        orig_size: (height, width) in pixels of the image that K describes.
        mirrored: Whether the image is mirrored.

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or ``orig_size`` is missing for K; while values are
            checked, also a number that is not finite.

    Example:
        >>> camera = nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)
        >>> x, y, depth = camera(torch.zeros(1, 3))[0, 0]  # the origin, at the image's centre
        >>> depth
        tensor(2.6926)
        >>> two = nr.Camera.cat([camera, nr.Camera.look((0.0, 0.0, -3.0), direction=(0.0, 0.0, 1.0))])
        >>> two.to(dtype=torch.float64).save("views/cameras.json", size=(256, 256), names=["front.png", "low.png"])
        >>> nr.Camera.load("views/cameras.json")
        Camera(2 cameras, K of 256 × 256, cpu)
    """

    @classmethod
    def cat(cls, cameras: Sequence[Camera]) -> Camera:
        """Concatenate batches of cameras.

        Args:
            cameras: Cameras of one kind of lens: with a viewing angle, orthographic, or with K. Those with K may
                differ in ``orig_size``; the result has that of the first.

        Returns:
            All cameras in one batch, in order.

        Raises:
            TypeError, ValueError: An item is not a Camera, there is none, or they differ in lens, device or mirroring.
        """
        if not isinstance(cameras, (list, tuple)) or not all(isinstance(camera, Camera) for camera in cameras):
            kinds = [type(one).__name__ for one in cameras] if isinstance(cameras, (list, tuple)) else type(cameras)
            raise TypeError(f"cameras: expected a list of Camera, got {kinds}")
        if not cameras:
            raise ValueError("cameras: expected at least one Camera, got an empty list")
        first = cameras[0]
        if len({_lens(camera) for camera in cameras}) > 1:
            found = " and ".join(sorted({_lens(camera) for camera in cameras}))
            raise ValueError(f"cameras: expected one kind of lens, got {found}")
        if len({camera.mirrored for camera in cameras}) > 1:
            raise ValueError("cameras: expected all mirrored or none, got both")
        validate.same_device(**{f"cameras[{i}]": camera.rotation for i, camera in enumerate(cameras)})
        frame = ("rotation", "origin", "translation")
        parts: dict[str, Any] = {name: torch.cat([getattr(camera, name) for camera in cameras]) for name in frame}
        for name in ("viewing_angle", "scale"):
            if getattr(first, name) is not None:
                parts[name] = _concatenated([getattr(camera, name) for camera in cameras], list(map(len, cameras)))
        if first.K is not None:
            parts["K"] = torch.cat([_resized(camera, first.orig_size) for camera in cameras])
        if any(camera.dist_coeffs is not None for camera in cameras):
            parts["dist_coeffs"] = torch.cat([_distortion(camera) for camera in cameras])
        return replace(first, **parts)

    @classmethod
    def load(cls, path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> Camera:
        """Read the cameras of a file: what `save` wrote, or NeRF's, COLMAP's and the other files that `fit` reads.

        Args:
            path: The file, or a folder that holds one.
            size: Height and width of the images in pixels, for files without it.

        Returns:
            B cameras in torch's default dtype, or float32.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: The file is malformed, or `Camera` does not have the lens.
        """
        camera: Camera = import_module(f"{__package__}.files.load").load_cameras(Path(path), size)[0]
        return camera

    def save(
        self, path: str | os.PathLike[str], size: tuple[int, int] | None = None, names: Sequence[str] = ()
    ) -> None:
        """Write the cameras as JSON, atomically. `load` and ``render --camera`` read the file.

        Cameras with K, or with perspective and ``size``, are written as K, R and t of OpenCV, which `fit` reads, too;
        ``size`` makes K of a viewing angle. Others are written with their attributes: fisheye and mirrored ones, those
        without perspective or without ``size``. Without ``size``, `load` returns the same cameras.

        Args:
            path: Name of the file, such as cameras.json. Missing folders are made.
            size: Height and width of the images in pixels, for cameras without K.
            names: Name of each image, for `fit`; by default 000.png, 001.png and so on.

        Raises:
            ValueError: There are not as many names as cameras.
            OSError: The file cannot be written. An existing file stays as it was.
        """
        import_module(f"{__package__}.files.load").save(path, self, size, names)

    @property
    def perspective(self) -> bool:
        """Whether the projection is perspective; False for an orthographic camera."""
        return self.viewing_angle is not None or self.K is not None

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens is a fisheye, with four coefficients."""
        return lens_model(self.dist_coeffs) is KANNALA_BRANDT

    @property
    def position(self) -> Tensor:
        """Positions of the eyes in the world, [B, 3]; of orthographic cameras, the points of depth 0 on their axes.

        Differentiable, like `forward`, `up` and `axes`.
        """
        return eye_position(self.rotation, self.origin, self.translation)

    @property
    def forward(self) -> Tensor:
        """Unit viewing directions in the world, [B, 3]."""
        return self.rotation[:, 2]

    @property
    def up(self) -> Tensor:
        """Unit vectors in the world that point up in the images, [B, 3]."""
        if self.K is None:
            return self.rotation[:, 1]
        return self.rotation[:, 1] * -self.K[:, 1, 1, None].detach().sign()  # rows of the image run along K11 · y

    @property
    def axes(self) -> Tensor:
        """Unit vectors in the world to the right, up and forward, as rows of [B, 3, 3].

        The right is that of the viewer: in a mirrored image this vector points left.
        """
        return self.rotation if self.K is None else torch.stack((self.rotation[:, 0], self.up, self.forward), 1)

    @property
    def fov(self) -> Scalar | None:
        """Whole vertical field of view in degrees, a number or [B]; None without perspective.

        With K, it is that of a pinhole with the same focal length and the principal point at the image's centre.
        """
        if self.K is not None and self.orig_size is not None:
            return 2 * torch.rad2deg(torch.atan(self.orig_size[0] / 2 / self.K[:, 1, 1].abs()))
        return None if self.viewing_angle is None else 2 * self.viewing_angle

    def __repr__(self) -> str:
        number, lens = self.viewing_angle, "orthographic"
        if self.K is not None:
            model = lens_model(self.dist_coeffs)
            lens = "K" if model is None else model.name
        elif number is not None:
            lens = f"viewing angle {number:g}" if isinstance(number, (int, float)) else "viewing angles"
        size = "" if self.orig_size is None else " of {:g} × {:g}".format(*self.orig_size)
        mirrored = ", mirrored" if self.mirrored else ""
        count = "1 camera" if len(self) == 1 else f"{len(self)} cameras"
        return f"Camera({count}, {lens}{size}{mirrored}, {self.rotation.device})"

    def __len__(self) -> int:
        return self.rotation.shape[0]

    def __getitem__(self, index: Any) -> Camera:
        """Select cameras: one by an index, several by a slice, a list, or a tensor of indices or bools."""
        if isinstance(index, bool) or (isinstance(index, Tensor) and index.ndim == 0 and index.dtype == torch.bool):
            raise TypeError("index: expected a number, a slice, a list or a tensor, got a bool")
        rows = torch.arange(len(self), device=self.rotation.device)
        if isinstance(index, slice) and (index.step or 1) < 0:  # torch has no negative steps
            index = list(range(len(self))[index])
        elif isinstance(index, range):
            index = list(index)
        try:
            rows = torch.atleast_1d(rows[index])
        except (TypeError, IndexError) as error:
            kind = IndexError if isinstance(error, IndexError) else TypeError
            raise kind(f"index: expected some of {len(self)} cameras, got {index!r}") from None
        if rows.ndim > 1:
            raise IndexError(f"index: expected some of {len(self)} cameras, got {index!r}")
        with_batch = {name: v for name, v in self._tensors().items() if v.ndim and len(v) == len(self)}
        parts: dict[str, Any] = {name: v[rows.to(v.device)] for name, v in with_batch.items()}
        return replace(self, **parts)

    def __iter__(self) -> Iterator[Camera]:
        return (self[i] for i in range(len(self)))

    def __call__(self, vertices: Tensor, aspect: float = 1.0) -> Tensor:
        """Project world vertices onto the screen. One camera can project B meshes, and B cameras one mesh.

        Args:
            vertices: [V, 3] or [B, V, 3] floating.
            aspect: Width / height of the image. x is divided by it, which makes pixels square. `Camera.projection`
                ignores it and uses ``orig_size``.

        Returns:
            [B, V, 3], float64 for float64 vertices, else float32. x (right) and y (up) are in [-1, 1] over the image; z
            is the depth along the viewing direction in world units, negative behind the camera.

        Raises:
            TypeError, ValueError: A type, shape, batch size or number does not fit (see `check_values`).

        Example:
            >>> camera = nr.Camera.look_at((0.0, 0.0, -2.5), viewing_angle=45)
            >>> camera(torch.tensor([[-1.0, 1.0, 0.0]]))  # from the −z side, −x is on the right
            tensor([[[0.4000, 0.4000, 2.5000]]])
        """
        vertices = validate.wide(validate.vertices(vertices))
        aspect = validate.positive("aspect", aspect)
        points = transform(vertices, self.rotation, self.origin)
        points = points + on_device(self.translation, points)[..., None, :]
        if self.K is not None and self.orig_size is not None:
            dist_coeffs = None if self.dist_coeffs is None else on_device(self.dist_coeffs, points)
            return pixels_to_screen(points, on_device(self.K, points), dist_coeffs, self.orig_size)
        angle = self.viewing_angle
        screen = in_parallel(points, self.scale) if angle is None else in_perspective(points, angle)
        if aspect == 1:
            return screen
        x, y, z = screen.unbind(-1)
        # By a tensor: on CUDA torch multiplies by the reciprocal of a number, which rounds twice.
        return torch.stack((x / torch.full_like(x, aspect), y, z), dim=-1)

    def project(self, points: Array, size: float | Sequence[float] | None = None) -> tuple[Tensor, Tensor]:
        """Project world points to pixels and depth.

        Args:
            points: [V, 3] or [B, V, 3] floating, in the world. Arrays and lists get the dtype of the camera.
            size: Side or (height, width) of the image in pixels. A camera with K has a default: the size that K
                describes.

        Returns:
            Pixels [B, V, 2], x to the right and y down, with (0, 0) at the image's upper left corner and the centre of
            the first pixel at (0.5, 0.5); and the depth [B, V] in world units, negative behind the camera.

        Raises:
            TypeError, ValueError: A type, shape, batch size or number does not fit, or the size is missing.

        Example:
            >>> camera = nr.Camera.look_at((0.0, 0.0, -2.5), viewing_angle=45)
            >>> pixels, depth = camera.project(torch.tensor([[-1.0, 1.0, 0.0]]), size=(100, 200))
            >>> pixels.round(), depth
            (tensor([[[120.,  30.]]]), tensor([[2.5000]]))
        """
        height, width = self._image_size(size)
        points = self._numbers("points", points)
        with validate.called(vertices="points"):
            screen = self(points, width / height)
        x, y, depth = screen.unbind(-1)
        return torch.stack(((x + 1) * (width / 2), (1 - y) * (height / 2)), -1), depth

    def unproject(self, pixels: Array, depth: Array, size: float | Sequence[float] | None = None) -> Tensor:
        """Find the world points that are visible at pixels; the inverse of `project`.

        Args:
            pixels: [V, 2] or [B, V, 2] floating, as `project` returns them. Arrays and lists as in `project`.
            depth: [V] or [B, V] floating, depth of each in world units, as in `Images`.
            size: As in `project`.

        Returns:
            [B, V, 3], in the world. Differentiable in all arguments and the camera. Lens distortion is inverted by
            Newton's method; results for pixels outside the range of the distortion are meaningless.

        Raises:
            TypeError, ValueError: As `project`.

        Example:
            >>> camera = nr.Camera.look_at((0.0, 0.0, -2.5), viewing_angle=45)
            >>> camera.unproject(torch.tensor([[120.0, 30.0]]), torch.tensor([3.5]), size=(100, 200))
            tensor([[[-1.4000,  1.4000,  1.0000]]])
        """
        image = self._image_size(size)
        pixels, depth = self._numbers("pixels", pixels), self._numbers("depth", depth)
        validate.floating("pixels", pixels, ("V", 2) if getattr(pixels, "ndim", 3) == 2 else ("B", "V", 2))
        count = pixels.shape[-2]
        validate.floating("depth", depth, (count,) if getattr(depth, "ndim", 2) == 1 else ("B", count))
        validate.same_device(pixels=pixels, depth=depth)
        validate.finite("pixels", pixels)
        validate.finite("depth", depth)
        pixels, depth = validate.wide(pixels), validate.wide(depth)
        dtype = torch.promote_types(pixels.dtype, depth.dtype)
        batch_size(pixels=batch_of(pixels, 2), depth=batch_of(depth, 1), camera=len(self))
        pixels, depth = pixels.to(dtype).reshape(-1, count, 2), depth.to(dtype).reshape(-1, count)
        points = self._points_at(pixels, depth, image) - on_device(self.translation, pixels)[:, None]
        axes = on_device(self.rotation, pixels)
        return rotate(axes.transpose(-1, -2), points) + on_device(self.origin, pixels)[:, None]

    def with_K(self, size: float | Sequence[float] | None = None) -> Camera:
        """Convert cameras with perspective to K, R and t of OpenCV, for images of a size.

        Args:
            size: As in `project`.

        Returns:
            Cameras that draw the same images of this size.

        Raises:
            TypeError, ValueError: The cameras have no perspective, or the size is missing or not positive.

        Example:
            >>> nr.Camera.look_at((0.0, 0.0, -2.5), viewing_angle=45).with_K((100, 200)).K
            tensor([[[ 50.,   0., 100.],
                     [  0.,  50.,  50.],
                     [  0.,   0.,   1.]]])
        """
        height, width = full = self._image_size(size)
        if self.K is not None:
            return replace(self, K=_resized(self, full), orig_size=full)
        if self.viewing_angle is None:
            raise ValueError("camera: expected perspective, got an orthographic lens")
        R = self.axes * self.axes.new_tensor([1.0, -1.0, 1.0])[:, None]
        t = -rotate(R, self.position[:, None])[:, 0]
        angle = torch.deg2rad(torch.as_tensor(self.viewing_angle).to(R)).expand(len(self))
        K = torch.diag_embed(torch.stack((1 / torch.tan(angle),) * 2 + (torch.zeros_like(angle),), 1)) * (height / 2)
        K = K + K.new_tensor([[0.0, 0.0, width / 2], [0.0, 0.0, height / 2], [0.0, 0.0, 1.0]])
        origin = torch.zeros_like(t)
        return replace(self, rotation=R, origin=origin, translation=t, K=K, viewing_angle=None, orig_size=full)

    def zoomed(self, factor: Scalar) -> Camera:
        """Multiply the focal length, or the scale of orthographic cameras.

        Args:
            factor: A number above 0, or a tensor [] or [B].

        Returns:
            Cameras at the same places, with images enlarged by the factor around their principal points. Differentiable
            in ``factor``.

        Raises:
            TypeError, ValueError: ``factor`` has another type or shape, or is not above 0 (see `check_values`).

        Example:
            >>> nr.Camera.look_at((0.0, 0.0, -2.5), fov=90).zoomed(2.0).fov
            tensor(53.1301)
        """
        factor = scalar("factor", factor, self.rotation.dtype, self.rotation.device)
        if outside(factor, 0.0, math.inf):
            raise ValueError(f"factor: expected a number above 0, got {factor}")
        if self.K is not None:
            zoom = torch.ones_like(self.K)
            zoom[:, :2, :2] = factor[..., None, None] if isinstance(factor, Tensor) and factor.ndim else factor
            return replace(self, K=self.K * zoom)
        if self.viewing_angle is None:
            return replace(self, scale=self.scale * factor)
        half = torch.deg2rad(torch.as_tensor(self.viewing_angle).to(self.rotation))
        return replace(self, viewing_angle=torch.rad2deg(torch.atan(torch.tan(half) / factor)))

    def shifted(self, shift: Array, size: float | Sequence[float] | None = None) -> Camera:
        """Shift the images, for example by fractions of a pixel to average several images.

        Args:
            shift: [2] or [B, 2], in pixels to the right and down.
            size: As in `project`.

        Returns:
            The cameras, with K if they have perspective.

        Raises:
            TypeError, ValueError: ``shift`` has another type or shape, or the size is missing or not positive.

        Example:
            >>> camera = nr.Camera.look_at((0.0, 0.0, -2.5)).shifted((0.25, -0.5), size=64)
            >>> camera.project(torch.zeros(1, 3))[0]
            tensor([[[32.2500, 31.5000]]])
        """
        height, _ = full = self._image_size(size)
        shift = self._numbers("shift", shift)
        validate.floating("shift", shift, (2,) if getattr(shift, "ndim", 2) == 1 else (len(self), 2))
        move = functional.pad(shift.to(self.rotation), (0, 1)).expand(len(self), 3)
        if self.perspective:
            camera = self.with_K(full)
            return replace(camera, K=camera.K + functional.pad(move[..., None], (2, 0)))  # type: ignore[operator]
        scale = torch.as_tensor(self.scale).to(move) * (height / 2)
        across = move * move.new_tensor([1.0, -1.0, 0.0]) / scale.reshape(-1, 1)
        return replace(self, origin=self.origin - rotate(self.rotation.mT, across[:, None])[:, 0])

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Camera:
        """Copy the cameras to another device or floating dtype.

        Args:
            device: Device of the copy; None keeps the device.
            dtype: Floating dtype of the copy; None keeps the dtype.

        Returns:
            The copy. Gradients flow back to the original.

        Raises:
            TypeError: ``dtype`` is not a floating dtype.
        """
        if not (dtype is None or (isinstance(dtype, torch.dtype) and dtype.is_floating_point)):
            raise TypeError(f"dtype: expected a floating dtype, got {dtype!r}")
        moved: dict[str, Any] = {name: v.to(device=device, dtype=dtype) for name, v in self._tensors().items()}
        return replace(self, **moved)

    def _image_size(self, size: Any) -> tuple[float, float]:
        """Convert a side or (height, width) to (height, width); by default the size that K describes."""
        size = self.orig_size if size is None else size
        if size is None:
            raise ValueError("size: expected the side or (height, width) of the image in pixels, got None")
        with validate.called(orig_size="size"):
            return image_size(size)

    def _points_at(self, pixels: Tensor, depth: Tensor, size: tuple[float, float]) -> Tensor:
        """Compute the camera coordinates [B, V, 3] of points at pixels [B, V, 2] and depths [B, V]."""
        height, width = size
        x, y = pixels.unbind(-1)
        if self.K is not None and self.orig_size is not None:
            rows, columns = self.orig_size
            x, y = undo_intrinsics(x * (columns / width), y * (rows / height), on_device(self.K, pixels))
            model = lens_model(self.dist_coeffs)
            if model is not None and self.dist_coeffs is not None:
                x, y = model.unproject(x, y, on_device(self.dist_coeffs, pixels))
            return torch.stack(torch.broadcast_tensors(x * depth, y * depth, depth), -1)
        x, y = (2 * x / width - 1) * (width / height), 1 - 2 * y / height
        if self.viewing_angle is None:
            scale = as_tensor("scale", scalar("scale", self.scale, pixels.dtype, pixels.device), pixels.dtype)
            scale = scale[..., None] if scale.ndim else scale
            return torch.stack(torch.broadcast_tensors(x / scale, y / scale, depth), -1)
        angle = viewing_angle("viewing_angle", self.viewing_angle, pixels.dtype, pixels.device)
        across = torch.tan(torch.deg2rad(as_tensor("viewing_angle", angle, pixels.dtype)))
        across = (across[..., None] if across.ndim else across) * depth
        return torch.stack(torch.broadcast_tensors(x * across, y * across, depth), -1)

    def _tensors(self) -> dict[str, Tensor]:
        return {f.name: v for f in fields(self) if isinstance(v := getattr(self, f.name), Tensor)}

    def _numbers(self, name: str, value: Array) -> Tensor:
        if isinstance(value, Tensor):
            return value
        return as_tensor(name, value, self.rotation.dtype).to(self.rotation.device)


def _lens(camera: Camera) -> str:
    if camera.K is not None:
        model = lens_model(camera.dist_coeffs)
        return "K" if model in (None, BROWN_CONRADY) else str(model and model.name)
    return "orthographic" if camera.viewing_angle is None else "viewing_angle"


def _concatenated(values: list[Scalar], counts: list[int]) -> Scalar:
    """Concatenate the values of batches: numbers, or tensors [] or [B]; equal numbers stay a number."""
    if not any(isinstance(value, Tensor) for value in values) and len(set(values)) == 1:
        return values[0]
    like = next((v for v in values if isinstance(v, Tensor)), torch.empty(0))
    parts = [torch.as_tensor(value, dtype=like.dtype, device=like.device) for value in values]
    return torch.cat([part.expand(count) for part, count in zip(parts, counts, strict=True)])


def world_origin(camera: Camera) -> Tensor:
    """Compute the camera coordinates of the world's origin, [B, 3]: OpenCV's t."""
    return camera.translation - torch.einsum("bij,bj->bi", camera.rotation, camera.origin)


def with_extrinsics(camera: Camera, rotation: Tensor, translation: Tensor) -> Camera:
    """Replace rotation [B, 3, 3] and `world_origin` [B, 3] of cameras; others keep their form."""
    zero = torch.zeros_like(translation)
    if camera.K is not None:
        return replace(camera, rotation=rotation, origin=zero, translation=translation)
    position = eye_position(rotation, zero, translation)
    return replace(camera, rotation=rotation, origin=position, translation=zero)


def rotation_and_position(camera: Camera, like: Tensor) -> tuple[Tensor, Tensor]:
    """Return ``rotation`` and `Camera.position` on the device and in the dtype of a tensor."""
    rotation = on_device(camera.rotation, like)
    return rotation, eye_position(rotation, on_device(camera.origin, like), on_device(camera.translation, like))


def _resized(camera: Camera, size: tuple[float, float] | None) -> Tensor:
    """Scale a camera's K to another image size with the same field of view."""
    K: Any = camera.K
    if camera.orig_size is None or size is None or camera.orig_size == size:
        return K
    return K * K.new_tensor([size[1] / camera.orig_size[1], size[0] / camera.orig_size[0], 1.0])[:, None]


def _distortion(camera: Camera) -> Tensor:
    """Return the coefficients of cameras with K, without a fisheye lens: zeros for pinholes."""
    if camera.dist_coeffs is not None:
        return camera.dist_coeffs
    return camera.rotation.new_zeros(len(camera), BROWN_CONRADY.coefficients)
