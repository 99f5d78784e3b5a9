"""`EnvironmentLight`: distant light given by an equirectangular image."""

from __future__ import annotations

import os
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...base import private, validate
from ...base.color_space import linear_to_srgb, srgb_to_linear
from ...base.constants import on_device
from ...base.one_line import OneLine
from ...camera import Camera
from ...camera.parameters import Array, Scalar, as_tensor, batch_size, scalar
from ...io.image_formats.exr import read_exr
from ...io.image_formats.radiance import read_radiance
from ...io.images import load_image
from ...raster.settings import image_size
from ...raster.warp.registration import is_plain
from ..lights import Ambience, FaceLight
from ..spherical_harmonics import SphericalHarmonicLight, harmonics
from .equirectangular import direction_uv, directions_of, from_convention, look_up, solid_angles
from .prefilter import prefiltered, reflected

_ROWS = 64  # rows of a picture in a strip that is converted


@dataclass(frozen=True, eq=False, repr=False)
class EnvironmentLight(OneLine, FaceLight, Ambience):
    """Distant light as an equirectangular image, for one scene or for each scene of a batch.

    Matt surfaces are lit by its spherical harmonics of order 2 (`SphericalHarmonicLight`; within 1 % for most images),
    glossy ones by blurred copies for each roughness and the split sum (Karis, "Real Shading in Unreal Engine 4",
    2013). There are no shadows. Results that depend only on an image without gradient are cached.

    Attributes:
        image: [H, W, 3] or [B, H, W, 3] floating tensor or array: **linear** radiance ≥ 0, row 0 up (+y), the middle
            column −z, columns to its right towards +x. Under radiance 1 everywhere, a white surface stays white. `load`
            reads it from a file.
        intensity: Factor: number, or tensor [] or [B].
        convention: Argument only, the program whose axes the given image has: "mitsuba", "blender", "gltf" (three.js
            and Khronos' viewer, too), or "neural_renderer", the ones above. ``image`` is then a rolled copy. The world
            of "blender" is that of its exported files, with +y up. Images of libraries such as Poly Haven have the
            axes of the program that shows them.

    Raises:
        TypeError, ValueError: The image or the name does not fit; in drawing, also if a number is not finite.

    Example:
        >>> image = torch.rand(32, 64, 3, requires_grad=True)
        >>> light = nr.EnvironmentLight(image)
        >>> nr.render(mesh, camera, 64, light=light, shading=nr.PBR(metallic=1.0, roughness=0.2)).rgb.sum().backward()
    """

    image: Array
    intensity: Scalar = 1.0
    convention: InitVar[str] = "neural_renderer"
    _computed: dict[str, tuple[Any, Tensor]] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self, convention: str) -> None:
        image = as_tensor("image", self.image, torch.float32)
        shape: tuple[int | str, ...] = ("H", "W", 3) if image.ndim == 3 else ("B", "H", "W", 3)
        validate.floating("image", image, shape)
        if not image.numel():
            raise ValueError(f"image: expected at least one pixel, got {validate.shape_of(image)}")
        object.__setattr__(self, "image", from_convention(image, convention))

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], intensity: Scalar = 1.0, convention: str = "neural_renderer"
    ) -> EnvironmentLight:
        """Read an environment from an equirectangular image file.

        Args:
            path: Radiance (.hdr, .pic) or OpenEXR (.exr; needs OpenEXR) file with linear light, or a picture of
                8 or 16 bits such as .jpg, which is converted from sRGB.
            intensity, convention: As of the class.

        Returns:
            The light, on the CPU.

        Raises:
            FileNotFoundError: The file does not exist.
            ModuleNotFoundError: OpenEXR is not installed.
            ValueError: The file is damaged, too large, or of another format.

        Example:
            >>> nr.save_image("room.png", torch.full((8, 16, 3), 0.5))
            >>> round(nr.EnvironmentLight.load("room.png").image.mean().item(), 2)
            0.22
        """
        suffix = Path(path).suffix.lower()
        if suffix in (".hdr", ".pic", ".exr"):
            read = read_exr if suffix == ".exr" else read_radiance
            return cls(torch.from_numpy(read(Path(path))), intensity, convention)
        picture = load_image(path)
        colors = picture if picture.shape[2] == 3 else picture.new_empty(*picture.shape[:2], 3)
        for rows, target in zip(picture.split(_ROWS), colors.split(_ROWS), strict=True):  # in strips, to save memory
            target.copy_(srgb_to_linear(rows[..., :3]))
        return cls(colors, intensity, convention)

    def radiance(self, directions: Tensor) -> Tensor:
        """Look up the light from directions.

        Args:
            directions: [B, H, W, 3] floating, away from the viewer, of any length.

        Returns:
            **Linear** RGB [B, H, W, 3], differentiable in directions and parameters.

        Raises:
            TypeError, ValueError: A type or batch size does not fit.

        Example:
            >>> sky = torch.zeros(8, 16, 3)
            >>> sky[:4] = 1.0
            >>> nr.EnvironmentLight(sky).radiance(torch.tensor([[[[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]]]))[..., 0]
            tensor([[[1., 0.]]])
        """
        return self._strength(look_up(self._looked_up(directions), direction_uv(directions)))

    def background(self, camera: Camera, size: int | tuple[int, int]) -> Tensor:
        """Render the environment from a camera, for ``background`` of `render`.

        Args:
            camera: B cameras with perspective.
            size: Side of the images, or (height, width), in pixels.

        Returns:
            **Display values** [B, 3, H, W] float32.

        Raises:
            TypeError, ValueError: A type, size or batch size does not fit, or the camera is orthographic.

        Example:
            >>> light = nr.EnvironmentLight(torch.rand(32, 64, 3))
            >>> behind = light.background(camera, 64)
            >>> images = nr.render(mesh, camera, 64, light=light, shading="pbr", background=behind)
        """
        if not camera.perspective:
            raise ValueError("camera: expected one with perspective, got an orthographic one, with parallel rays")
        height, width = image_size("size", size)
        like = on_device(camera.origin, torch.as_tensor(self.image).new_empty(0, dtype=torch.float32))
        y, x = (torch.arange(side, dtype=like.dtype, device=like.device) + 0.5 for side in (height, width))
        pixels = torch.stack((x.expand(height, width), y[:, None].expand(height, width)), -1).view(-1, 2)
        near, far = (
            camera.unproject(pixels, pixels.new_full((len(pixels),), depth), (height, width)) for depth in (1, 2)
        )
        return linear_to_srgb(self.radiance((far - near).view(-1, height, width, 3))).movedim(-1, 1)

    def ambience(self, directions: Tensor, roughness: Tensor | None = None) -> Tensor:
        image = self._looked_up(directions)
        if roughness is None:
            return self._strength(self._matt(directions).on(directions))
        return self._strength(reflected(image, self._cached("levels", image), directions, roughness))

    def two_sided(self, corners: Tensor, mirrored: bool = False) -> Tensor:
        validate.finite("corners", validate.floating("corners", corners, ("B", "F", 3, 3)))
        return self._strength(self._matt(corners).two_sided(corners, mirrored))

    def coefficients(self) -> Tensor:
        """Project the image onto spherical harmonics of order 2.

        Returns:
            [9, 3] or [B, 9, 3] float32, for `SphericalHarmonicLight`; without ``intensity``. Differentiable.

        Example:
            >>> nr.EnvironmentLight(torch.ones(16, 32, 3)).coefficients()[0]
            tensor([3.5449, 3.5449, 3.5449])
        """
        image = torch.as_tensor(self.image).float()
        found = projected(image if image.ndim == 4 else image[None])
        return found if image.ndim == 4 else found[0]

    def _pixels(self, like: Tensor) -> Tensor:
        """Return the image as [1 or B, H, W, 3] float32 on the device of ``like``."""
        image = on_device(torch.as_tensor(self.image), like.new_empty(0, dtype=torch.float32))
        validate.finite("image", image)
        return image if image.ndim == 4 else image[None]

    def _looked_up(self, directions: Tensor) -> Tensor:
        """Return `_pixels`; raise ValueError if there are more environments than images of directions."""
        image = self._pixels(directions)
        if len(image) not in (1, len(directions)):
            raise ValueError(f"image: expected a batch of 1 or {len(directions)} like directions, got {len(image)}")
        return image

    def _matt(self, like: Tensor) -> SphericalHarmonicLight:
        return SphericalHarmonicLight(self._cached("coefficients", self._pixels(like)))

    def _cached(self, name: str, image: Tensor) -> Tensor:
        """Compute levels or coefficients of the image; cache them until it changes, unless it needs gradients."""
        compute = prefiltered if name == "levels" else projected
        source = torch.as_tensor(self.image)
        version = None if image.requires_grad or not is_plain((image,)) else private.version_of(source)
        if version is None:
            return compute(image)
        key = (version, image.device)
        known = self._computed.get(name)
        if known is None or known[0] != key:
            with torch.inference_mode(False), torch.no_grad():
                known = self._computed[name] = (key, compute(image.clone()))
        return known[1]

    def _strength(self, light: Tensor) -> Tensor:
        strength: Any = scalar("intensity", self.intensity, light.dtype, light.device)
        if isinstance(strength, Tensor) and strength.ndim:
            batch_size(points=len(light), intensity=len(strength))
            strength = strength.reshape(-1, *(1,) * (light.ndim - 1))
        return light * strength


def projected(image: Tensor) -> Tensor:
    """Project images [B, H, W, 3] float32 onto spherical harmonics of order 2, [B, 9, 3]."""
    height, width = image.shape[1:3]
    weighted = image * solid_angles(height, width, image)[:, None, None]
    bands = harmonics(directions_of(height, width, image))
    return torch.stack([(weighted * band[..., None]).sum((1, 2)) for band in bands], 1)
