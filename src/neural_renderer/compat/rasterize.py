"""The rasteriser under the names of the first packages; every function takes corners in screen space.

``faces`` is [B, F, 3, 3] throughout, as `raster.rasterize.rasterize_images` describes it; that function is what new
code uses. Images are float32, row 0 at the top.
"""

from __future__ import annotations

from typing import Any

from torch import Tensor, nn

from .. import validate
from ..raster.rasterize import rasterize_images

DEFAULT_IMAGE_SIZE = 256
DEFAULT_ANTI_ALIASING = True
DEFAULT_NEAR = 0.1
DEFAULT_FAR = 100
DEFAULT_EPS = 1e-4
DEFAULT_BACKGROUND_COLOR = (0, 0, 0)


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
    """Colour, alpha and depth at once.

    textures: [B, F, T, T, T, 3], needed for colour; the other arguments as in `rasterize_images`. Only faces whose
    corners run counter-clockwise on the screen are drawn.

    Returns a dict: "rgb" [B, 3, H, W], "alpha" [B, H, W], "depth" [B, H, W], each None where not asked for.
    Raises TypeError or ValueError as `rasterize_images` does, and ValueError if nothing is asked for.
    """
    asked = {"rgb": return_rgb, "alpha": return_alpha, "depth": return_depth}
    if not any(asked.values()):
        raise ValueError("return_rgb, return_alpha, return_depth: expected at least one, got none")
    with validate.called(background="background_color"):
        images = rasterize_images(
            faces,
            image_size,
            outputs=[name for name, wanted in asked.items() if wanted],
            textures=textures,
            background=background_color,
            near=near,
            far=far,
            eps=eps,
            anti_aliasing=anti_aliasing,
            gradient=gradient,
        )
    return images._asdict()


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
    """Colour [B, 3, H, W]; arguments as in `rasterize_rgbad`."""
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
    """Silhouettes [B, H, W]: 1 where a face is seen, 0 elsewhere; arguments as in `rasterize_rgbad`."""
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
    """Depth [B, H, W], ``far`` where no face is seen; arguments as in `rasterize_rgbad`."""
    options = (image_size, anti_aliasing, near, far, eps, DEFAULT_BACKGROUND_COLOR, False, False, True, gradient)
    return rasterize_rgbad(faces, None, *options)["depth"]  # type: ignore[return-value]


class Rasterize(nn.Module):
    """The bare rasteriser: no anti-aliasing, rows from the **bottom**, channels last.

    Called with ``faces`` [B, F, 3, 3] and, for colour, ``textures`` [B, F, T, T, T, 3]; returns a tuple (rgb [B, H, W,
    3], alpha [B, H, W], depth [B, H, W]), None where not asked for. Raises ValueError if nothing is asked for.
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
        images: dict[str, Tensor | None] = rasterize_rgbad(
            faces,
            textures,
            self.image_size,
            False,
            self.near,
            self.far,
            self.eps,
            self.background_color,
            self.return_rgb,
            self.return_alpha,
            self.return_depth,
            self.gradient,
        )
        rgb, alpha, depth = images["rgb"], images["alpha"], images["depth"]
        return (
            None if rgb is None else rgb.flip(2).permute(0, 2, 3, 1).contiguous(),
            None if alpha is None else alpha.flip(1),
            None if depth is None else depth.flip(1),
        )
