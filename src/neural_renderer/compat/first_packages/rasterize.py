"""Rasteriser under the names of the first packages. New code uses `rasterize_images`.

Faces are [B, F, 3 corners, 3]: x right, y up in [−1, 1] over the image, and depth z. Images are float32, row 0 at the
top.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from ...base import validate
from ...raster.outputs import OUTPUTS
from ...raster.rasterize import rasterize_images

DEFAULT_IMAGE_SIZE = 256
DEFAULT_ANTI_ALIASING = True
DEFAULT_NEAR = 0.1
DEFAULT_FAR = 100
DEFAULT_EPS = 1e-4
DEFAULT_BACKGROUND_COLOR = (0, 0, 0)
_SETTINGS = ("image_size", "near", "far", "eps", "background_color", "gradient", *(f"return_{n}" for n in OUTPUTS))


def near_plane(near: Any, corners: Tensor) -> float:
    """Return ``near``, or 0 if it is below 0: for positive depths, the first packages drew the same.

    Raises:
        ValueError: ``near`` is below 0, and a depth, too.
    """
    near = validate.number("near", near)
    if near >= 0:
        return near
    depth = validate.floating("faces", corners, ("B", "F", 3, 3)).detach()[..., 2]
    if validate.values_are_checked(depth) and bool((depth < 0).any()):
        least = float(depth.min())
        raise ValueError(f"near: expected 0 or more for faces behind the camera, at depth {least:g}, got {near:g}")
    return 0.0


def rasterize_rgbad(
    faces: Tensor,
    textures: Tensor | None = None,
    image_size: int | tuple[int, int] = DEFAULT_IMAGE_SIZE,
    anti_aliasing: bool = DEFAULT_ANTI_ALIASING,
    near: float = DEFAULT_NEAR,
    far: float = DEFAULT_FAR,
    eps: float = DEFAULT_EPS,
    background_color: Any = DEFAULT_BACKGROUND_COLOR,
    return_rgb: bool = True,
    return_alpha: bool = True,
    return_depth: bool = True,
    gradient: str = "nmr",
) -> dict[str, Tensor | None]:
    """Draw colour, alpha and depth. Only faces whose corners run counter-clockwise on the screen are drawn.

    Args:
        faces: [B, F, 3 corners, 3] floating, in screen space.
        textures: [B, F, T, T, T, 3] floating, for colour; otherwise None.
        image_size: Side, or (height, width), in pixels.
        anti_aliasing: Supersample at twice the size.
        near, far: Smallest and largest visible depth. A number below 0 for ``near`` is 0.
        eps: See `rasterize_images`.
        background_color: Number, [3], [B, 3] or an image.
        return_rgb, return_alpha, return_depth: Whether to return colour, alpha and depth.
        gradient: Gradient estimator, "nmr" or "edge".

    Returns:
        "rgb" [B, 3, H, W], "alpha" [B, H, W] and "depth" [B, H, W] by name, None if not requested.

    Raises:
        TypeError, ValueError: As `rasterize_images`, or nothing is requested.

    Example:
        >>> faces = torch.tensor([[[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0]]]])  # half of the image
        >>> nr.rasterize_rgbad(faces, image_size=64, return_rgb=False)["alpha"].mean()
        tensor(0.50...)
    """
    asked = {"rgb": return_rgb, "alpha": return_alpha, "depth": return_depth}
    if not any(asked.values()):
        raise ValueError("return_rgb, return_alpha, return_depth: expected at least one, got none")
    with validate.called(background="background_color", size="image_size"):
        images = rasterize_images(
            faces,
            image_size,
            outputs=[name for name, wanted in asked.items() if wanted],
            textures=textures,
            background=background_color,
            near=near_plane(near, faces),
            far=far,
            eps=eps,
            anti_aliasing=anti_aliasing,
            gradient=gradient,
        )
    return dict(zip(OUTPUTS, images, strict=True))


def rasterize(
    faces: Tensor,
    textures: Tensor | None = None,
    image_size: int | tuple[int, int] = DEFAULT_IMAGE_SIZE,
    anti_aliasing: bool = DEFAULT_ANTI_ALIASING,
    near: float = DEFAULT_NEAR,
    far: float = DEFAULT_FAR,
    eps: float = DEFAULT_EPS,
    background_color: Any = DEFAULT_BACKGROUND_COLOR,
    gradient: str = "nmr",
) -> Tensor:
    """Draw colour.

    Args:
        faces, textures, image_size, anti_aliasing, near, far, eps, background_color, gradient: As in `rasterize_rgbad`.

    Returns:
        [B, 3, H, W] float32, differentiable in faces and textures.

    Raises:
        TypeError, ValueError: As `rasterize_rgbad`.

    Example:
        >>> faces = torch.tensor([[[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0]]]])
        >>> nr.rasterize(faces, torch.ones(1, 1, 1, 1, 1, 3), image_size=64).shape
        torch.Size([1, 3, 64, 64])
    """
    options = (image_size, anti_aliasing, near, far, eps, background_color, True, False, False, gradient)
    return rasterize_rgbad(faces, textures, *options)["rgb"]  # type: ignore[return-value]


def rasterize_silhouettes(
    faces: Tensor,
    image_size: int | tuple[int, int] = DEFAULT_IMAGE_SIZE,
    anti_aliasing: bool = DEFAULT_ANTI_ALIASING,
    near: float = DEFAULT_NEAR,
    far: float = DEFAULT_FAR,
    eps: float = DEFAULT_EPS,
    gradient: str = "nmr",
) -> Tensor:
    """Draw silhouettes.

    Args:
        faces, image_size, anti_aliasing, near, far, eps, gradient: As in `rasterize_rgbad`.

    Returns:
        [B, H, W] float32: 1 on faces, 0 elsewhere, fractions with ``anti_aliasing``. Differentiable in faces.

    Raises:
        TypeError, ValueError: As `rasterize_rgbad`.

    Example:
        >>> faces = torch.tensor([[[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0]]]])
        >>> nr.rasterize_silhouettes(faces, image_size=64).shape
        torch.Size([1, 64, 64])
    """
    options = (image_size, anti_aliasing, near, far, eps, DEFAULT_BACKGROUND_COLOR, False, True, False, gradient)
    return rasterize_rgbad(faces, None, *options)["alpha"]  # type: ignore[return-value]


def rasterize_depth(
    faces: Tensor,
    image_size: int | tuple[int, int] = DEFAULT_IMAGE_SIZE,
    anti_aliasing: bool = DEFAULT_ANTI_ALIASING,
    near: float = DEFAULT_NEAR,
    far: float = DEFAULT_FAR,
    eps: float = DEFAULT_EPS,
    gradient: str = "nmr",
) -> Tensor:
    """Draw depth.

    Args:
        faces, image_size, anti_aliasing, near, far, eps, gradient: As in `rasterize_rgbad`.

    Returns:
        [B, H, W] float32, ``far`` in the background. Differentiable in faces.

    Raises:
        TypeError, ValueError: As `rasterize_rgbad`.

    Example:
        >>> faces = torch.tensor([[[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0]]]])
        >>> nr.rasterize_depth(faces, image_size=64).amin()
        tensor(1.)
    """
    options = (image_size, anti_aliasing, near, far, eps, DEFAULT_BACKGROUND_COLOR, False, False, True, gradient)
    return rasterize_rgbad(faces, None, *options)["depth"]  # type: ignore[return-value]


class Rasterize(nn.Module):
    """Rasteriser as a module: no anti-aliasing, rows from the **bottom**, channels last.

    Args:
        image_size, near, far, eps, background_color, return_rgb, return_alpha, return_depth, gradient: As in
            `rasterize_rgbad`.

    Raises:
        ValueError: Nothing is requested.

    Example:
        >>> rasterizer = nr.Rasterize(64, 0.1, 100, 1e-4, (0, 0, 0), return_alpha=True)
        >>> faces = torch.tensor([[[[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0]]]])
        >>> rgb, alpha, depth = rasterizer(faces)
    """

    def __init__(
        self,
        image_size: int | tuple[int, int],
        near: float,
        far: float,
        eps: float,
        background_color: Any,
        return_rgb: bool = False,
        return_alpha: bool = False,
        return_depth: bool = False,
        gradient: str = "nmr",
    ) -> None:
        super().__init__()
        if not (return_rgb or return_alpha or return_depth):
            raise ValueError("return_rgb, return_alpha, return_depth: expected at least one, got none")
        self.image_size = image_size
        self.near = near
        self.far = far
        self.eps = eps
        self.background_color = background_color
        self.return_rgb = return_rgb
        self.return_alpha = return_alpha
        self.return_depth = return_depth
        self.gradient = gradient

    def forward(
        self, faces: Tensor, textures: Tensor | None = None
    ) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
        """Draw faces.

        Args:
            faces, textures: As in `rasterize_rgbad`.

        Returns:
            (rgb [B, H, W, 3], alpha [B, H, W], depth [B, H, W]), None if not requested.

        Raises:
            TypeError, ValueError: As `rasterize_images`.
        """
        settings: dict[str, Any] = {name: getattr(self, name) for name in _SETTINGS}
        images = rasterize_rgbad(faces, textures, anti_aliasing=False, **settings)
        rgb, alpha, depth = images["rgb"], images["alpha"], images["depth"]
        return (
            None if rgb is None else rgb.flip(2).permute(0, 2, 3, 1).contiguous(),
            None if alpha is None else alpha.flip(1),
            None if depth is None else depth.flip(1),
        )
