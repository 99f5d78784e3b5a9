"""Cameras as tensors: attributes, checks, and the way from the world to the screen and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from .. import validate
from ..constants import on_device
from .lens import image_size, in_parallel, in_perspective, pixels_to_screen
from .parameters import Array, Scalar, as_tensor, batch_of, batch_size
from .pixels import camera_points, pixel_size, pixels_of
from .view import rotate, transform

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, eq=False, repr=False)
class CameraModel:
    """Attributes of `Camera`, which explains them, and the projection of points."""

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
            size = (4,) if name == "dist_coeffs" and self.is_fisheye else size
            if value is not None or name in ("origin", "translation"):
                validate.floating(name, value, (len(self.rotation), *size))
                validate.same_device(rotation=self.rotation, **{name: value})
                validate.finite(name, value)
        if self.K is not None:
            image_size(self.orig_size)

    @property
    def perspective(self) -> bool:
        """Whether the projection is perspective; False for an orthographic camera."""
        return self.viewing_angle is not None or self.K is not None

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens is a fisheye, with four coefficients."""
        return getattr(self.dist_coeffs, "shape", (0,))[-1] == 4

    @property
    def axes(self) -> Tensor:
        """Directions to the right, up and forward of each camera, [B, 3, 3], in the world."""
        if self.K is None:
            return self.rotation
        return self.rotation * self.rotation.new_tensor([1.0, -1.0, 1.0])[:, None]  # K's y points down

    def __repr__(self) -> str:
        number, lens = self.viewing_angle, "orthographic"
        if self.K is not None:
            lens = "fisheye" if self.is_fisheye else "K with distortion" if self.dist_coeffs is not None else "K"
        elif number is not None:
            lens = f"viewing angle {number:g}" if isinstance(number, (int, float)) else "viewing angles"
        size = "" if self.orig_size is None else " of {:g} × {:g}".format(*self.orig_size)
        mirrored = ", mirrored" if self.mirrored else ""
        count = "1 camera" if len(self) == 1 else f"{len(self)} cameras"
        return f"Camera({count}, {lens}{size}{mirrored}, {self.rotation.device})"

    def __len__(self) -> int:
        return self.rotation.shape[0]

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
            TypeError, ValueError: A type, shape or batch size does not fit, or ``aspect`` is not positive; while values
                are checked, also a vertex that is not finite.

        Example:
            >>> camera = nr.Camera.look_at((0.0, 0.0, -2.5), viewing_angle=45)
            >>> camera(torch.tensor([[-1.0, 1.0, 0.0]]))  # from the −z side, −x is on the right
            tensor([[[0.4000, 0.4000, 2.5000]]])
        """
        vertices = validate.wide(validate.vertices(vertices))
        aspect = validate.positive("aspect", aspect)
        points = transform(vertices, self.rotation, self.origin)
        if self.K is not None and self.orig_size is not None:
            points = points + on_device(self.translation, points)[..., None, :]
            dist_coeffs = None if self.dist_coeffs is None else on_device(self.dist_coeffs, points)
            return pixels_to_screen(points, on_device(self.K, points), dist_coeffs, self.orig_size)
        if self.viewing_angle is not None:
            screen = in_perspective(points, self.viewing_angle)
        else:
            screen = in_parallel(points, self.scale)
        if aspect == 1:
            return screen
        x, y, z = screen.unbind(-1)
        return torch.stack((x / aspect, y, z), dim=-1)

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
            TypeError, ValueError: A type, shape or batch size does not fit, or the size is missing or not positive;
                while values are checked, also a point that is not finite.

        Example:
            >>> camera = nr.Camera.look_at((0.0, 0.0, -2.5), viewing_angle=45)
            >>> pixels, depth = camera.project(torch.tensor([[-1.0, 1.0, 0.0]]), size=(100, 200))
            >>> pixels.round(), depth
            (tensor([[[120.,  30.]]]), tensor([[2.5000]]))
        """
        height, width = pixel_size(size, self)
        points = self._numbers("points", points)
        with validate.called(vertices="points"):
            screen = self(points, width / height)
        return pixels_of(screen, (height, width)), screen[..., 2]

    def unproject(self, pixels: Array, depth: Array, size: float | Sequence[float] | None = None) -> Tensor:
        """Find the world points that are visible at pixels; the inverse of `project`.

        Args:
            pixels: [V, 2] or [B, V, 2] floating, as `project` returns them. Arrays and lists as there.
            depth: [V] or [B, V] floating, depth of each in world units, as in `Images`.
            size: As in `project`.

        Returns:
            [B, V, 3], in the world. Differentiable in all arguments and the camera. Lens distortion is inverted by
            Newton's method; pixels that it does not reach have no meaning.

        Raises:
            TypeError, ValueError: A type, shape or batch size does not fit, or the size is missing or not positive;
                while values are checked, also a number that is not finite.

        Example:
            >>> camera = nr.Camera.look_at((0.0, 0.0, -2.5), viewing_angle=45)
            >>> camera.unproject(torch.tensor([[120.0, 30.0]]), torch.tensor([3.5]), size=(100, 200))
            tensor([[[-1.4000,  1.4000,  1.0000]]])
        """
        image = pixel_size(size, self)
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
        points = camera_points(self, pixels, depth, image) - on_device(self.translation, pixels)[:, None]
        axes = on_device(self.rotation, pixels)
        return rotate(axes.transpose(-1, -2), points) + on_device(self.origin, pixels)[:, None]

    def _numbers(self, name: str, value: Array) -> Tensor:
        """Convert arrays and lists to tensors of the camera's dtype and device."""
        if isinstance(value, Tensor):
            return value
        return as_tensor(name, value, self.rotation.dtype).to(self.rotation.device)

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> Self:
        """Copy the cameras to another device or floating dtype.

        Args:
            device: Device of the copy; None keeps the device.
            dtype: Floating dtype of the copy; None keeps the dtype.

        Returns:
            The copy. Gradients flow back to the original.

        Raises:
            TypeError: ``dtype`` is not a floating dtype.

        Example:
            >>> nr.Camera.look_at((0.0, 0.0, -2.5)).to(dtype=torch.float64).rotation.dtype
            torch.float64
        """
        if not (dtype is None or (isinstance(dtype, torch.dtype) and dtype.is_floating_point)):
            raise TypeError(f"dtype: expected a floating dtype, got {dtype!r}")
        tensors = {f.name: v for f in fields(self) if isinstance(v := getattr(self, f.name), Tensor)}
        moved: dict[str, Any] = {name: v.to(device=device, dtype=dtype) for name, v in tensors.items()}
        return replace(self, **moved)
