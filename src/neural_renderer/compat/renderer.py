"""`Renderer`, the class that code written for the first packages uses: a thin face over the same parts as `render`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from .. import validate
from ..camera import look, look_at, projection
from ..camera.lens import in_perspective
from ..camera.lens import viewing_angle as checked_angle
from ..camera.parameters import as_tensor, common_device, scalar
from ..raster.faces import checked_faces, vertices_to_faces, world_corners
from ..raster.images import Images
from ..raster.rasterize import rasterize_images
from ..raster.settings import image_size
from ..shading.lights import Light
from .rasterize import DEFAULT_EPS, DEFAULT_FAR, DEFAULT_NEAR

# What `Light` calls the attributes of `Renderer`.
_LIGHT = {
    "ambient": "light_intensity_ambient",
    "directional": "light_intensity_directional",
    "ambient_color": "light_color_ambient",
    "directional_color": "light_color_directional",
    "direction": "light_direction",
}


class Renderer(nn.Module):
    """A renderer with settable attributes; each constructor argument is an attribute of the same name.

    "look_at" and "look" mirror the world, and light in "projection" mode falls on the far sides of faces, as in the
    first packages; `render` has neither property.

    Args:
        image_size: side, or (height, width), in pixels; image_height and image_width set either alone.
        anti_aliasing: draw at twice the size and average.
        background_color: a number, [3], [B, 3] or an image.
        fill_back: draw both sides of every face.
        camera_mode: where the camera comes from, which may change at any time:
            "projection": a calibrated camera as in OpenCV, by K, R, t, dist_coeffs and orig_size (see `projection`);
            "look_at": the attribute eye; it looks at the origin, with camera_up upwards;
            "look": the same, but it looks along camera_direction;
            any other string: no camera; vertices are in screen space already.
        K, R, t, dist_coeffs: tensors, kept as they are; arrays and lists become float32 tensors. dist_coeffs None is
            zeros [1, 5].
        orig_size: the size of the image that K describes: a number or (height, width).
        perspective: divide by depth ("look_at" and "look" only).
        viewing_angle: half the field of view in degrees, a number, or a tensor [] or [B]; in (0, 90) where it is used.
            The eye begins on the -z axis where a square of side 2 at z = -1 fills the image.
        near, far: only what has near < depth < far at a pixel is seen, in every mode.
        light_*: intensities, colours and direction (towards the light) as in `Light`: one for all images or [B].
        gradient: the estimator through visibility.

    Attributes:
        eye: the camera's position, [3] or [B, 3].
        rasterizer_eps: eps of colour renders, 1e-3 (see `rasterize_images`); that of silhouettes is always 1e-4.

    Raises:
        TypeError, ValueError: with a sentence, here for what cannot be kept, and at each call for what is used.
    """

    def __init__(
        self,
        image_size: int | tuple[int, int] = 256,
        anti_aliasing: bool = True,
        background_color: Any = (0, 0, 0),
        fill_back: bool = True,
        camera_mode: str = "projection",
        K: Any = None,
        R: Any = None,
        t: Any = None,
        dist_coeffs: Any = None,
        orig_size: int | tuple[int, int] = 1024,
        perspective: bool = True,
        viewing_angle: float | Tensor = 30,
        camera_direction: Any = (0, 0, 1),
        near: float = DEFAULT_NEAR,
        far: float = DEFAULT_FAR,
        light_intensity_ambient: float | Tensor = 0.5,
        light_intensity_directional: float | Tensor = 0.5,
        light_color_ambient: Any = (1, 1, 1),
        light_color_directional: Any = (1, 1, 1),
        light_direction: Any = (0, 1, 0),
        gradient: str = "nmr",
        camera_up: Any = (0, 1, 0),
        image_height: int | None = None,
        image_width: int | None = None,
    ) -> None:
        super().__init__()
        self.image_size = image_size
        if image_height is not None:
            self.image_height = image_height
        if image_width is not None:
            self.image_width = image_width
        self.anti_aliasing = anti_aliasing
        self.background_color = _own(background_color)
        self.fill_back = fill_back
        self.camera_mode = _mode(camera_mode)
        self.K, self.R, self.t = _as_tensor("K", K), _as_tensor("R", R), _as_tensor("t", t)
        none = torch.zeros((1, 5), device=common_device(K, R, t))
        self.dist_coeffs = none if dist_coeffs is None else _as_tensor("dist_coeffs", dist_coeffs)
        self.orig_size = orig_size
        self.perspective = perspective
        self.viewing_angle = viewing_angle
        if camera_mode in ("look_at", "look") and perspective:
            checked_angle("viewing_angle", viewing_angle, torch.get_default_dtype())
        self.eye: Any = _default_eye(viewing_angle)
        self.camera_direction = _own(camera_direction)
        self.camera_up = _own(camera_up)
        self.near = near
        self.far = far
        self.light_intensity_ambient = light_intensity_ambient
        self.light_intensity_directional = light_intensity_directional
        self.light_color_ambient = _own(light_color_ambient)
        self.light_color_directional = _own(light_color_directional)
        self.light_direction = _own(light_direction)
        self.rasterizer_eps = 1e-3
        self.gradient = gradient

    @property
    def image_height(self) -> int:
        """The images' height; setting it keeps their width."""
        return image_size("image_size", self.image_size)[0]

    @image_height.setter
    def image_height(self, height: int) -> None:
        self.image_size = height, self.image_width

    @property
    def image_width(self) -> int:
        """The images' width; setting it keeps their height."""
        return image_size("image_size", self.image_size)[1]

    @image_width.setter
    def image_width(self, width: int) -> None:
        self.image_size = self.image_height, width

    def __setattr__(self, name: str, value: Any) -> None:
        # A number takes the place of a parameter too, which nn.Module would refuse.
        if name in getattr(self, "_parameters", ()) and not isinstance(value, nn.Parameter):
            del self._parameters[name]
        super().__setattr__(name, value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Pickles of the first packages and of earlier versions lack some attributes: these get their defaults.
        super().__setstate__({**vars(Renderer()), **state})

    def forward(
        self,
        vertices: Tensor,
        faces: Tensor,
        textures: Tensor | None = None,
        mode: str | None = None,
        K: Any = None,
        R: Any = None,
        t: Any = None,
        dist_coeffs: Any = None,
        orig_size: int | tuple[int, int] | None = None,
    ) -> Any:
        """What ``mode`` names: None → `render`, "rgb", "silhouettes", "depth"; ValueError for another."""
        camera = (K, R, t, dist_coeffs, orig_size)
        if mode is None:
            return self.render(vertices, faces, textures, *camera)
        if mode == "rgb":
            return self.render_rgb(vertices, faces, textures, *camera)
        if mode == "silhouettes":
            return self.render_silhouettes(vertices, faces, *camera)
        if mode == "depth":
            return self.render_depth(vertices, faces, *camera)
        raise ValueError(f"mode: expected None, 'rgb', 'silhouettes' or 'depth', got {mode!r}")

    def render(
        self, vertices: Tensor, faces: Tensor, textures: Tensor | None, K: Any = None, R: Any = None, t: Any = None,
        dist_coeffs: Any = None, orig_size: int | tuple[int, int] | None = None,
    ) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
        """(rgb [B, 3, H, W], depth [B, H, W], alpha [B, H, W]) of vertices [B, V, 3], faces [B, F, 3] or [F, 3] and
        textures [B, F, T, T, T, 3]; K, R, t, dist_coeffs, orig_size replace the attributes for this call."""
        images = self._draw(("rgb", "alpha", "depth"), vertices, faces, textures, (K, R, t, dist_coeffs, orig_size))
        return images.rgb, images.depth, images.alpha

    def render_rgb(
        self, vertices: Tensor, faces: Tensor, textures: Tensor | None, K: Any = None, R: Any = None, t: Any = None,
        dist_coeffs: Any = None, orig_size: int | tuple[int, int] | None = None,
    ) -> Tensor:  # fmt: skip
        """Colour [B, 3, H, W]; arguments as in `render`."""
        return self._draw(("rgb",), vertices, faces, textures, (K, R, t, dist_coeffs, orig_size)).rgb

    def render_silhouettes(
        self, vertices: Tensor, faces: Tensor, K: Any = None, R: Any = None, t: Any = None,
        dist_coeffs: Any = None, orig_size: int | tuple[int, int] | None = None,
    ) -> Tensor:  # fmt: skip
        """Silhouettes [B, H, W]; arguments as in `render`."""
        return self._draw(("alpha",), vertices, faces, None, (K, R, t, dist_coeffs, orig_size)).alpha

    def render_depth(
        self, vertices: Tensor, faces: Tensor, K: Any = None, R: Any = None, t: Any = None,
        dist_coeffs: Any = None, orig_size: int | tuple[int, int] | None = None,
    ) -> Tensor:  # fmt: skip
        """Depth [B, H, W]; arguments as in `render`."""
        return self._draw(("depth",), vertices, faces, None, (K, R, t, dist_coeffs, orig_size)).depth

    def _draw(
        self,
        outputs: tuple[str, ...],
        vertices: Tensor,
        faces: Tensor,
        textures: Tensor | None,
        camera: tuple[Any, ...],
    ) -> Images:
        validate.floating("vertices", vertices, ("B", "V", 3))
        faces = checked_faces(faces)
        screen, perspective = self._project(validate.wide(vertices), *camera)
        screen = validate.in_float32("vertices on the screen", screen)
        light = None
        if "rgb" in outputs:
            lamp = Light(
                self.light_intensity_ambient,
                self.light_intensity_directional,
                self.light_color_ambient,
                self.light_color_directional,
                self.light_direction,
            )
            # Light falls on the world, before the camera; on the side that the first packages lit (see the class).
            with validate.called(**_LIGHT):
                light = lamp.two_sided(world_corners(vertices, faces, len(screen)), mirrored=True)
        with validate.called(background="background_color", eps="rasterizer_eps", light="light_*"):
            return rasterize_images(
                vertices_to_faces(screen, faces),
                self.image_size,
                outputs=outputs,
                textures=textures,
                light=light,
                background=self.background_color,
                near=self.near,
                far=self.far,
                eps=self.rasterizer_eps if "rgb" in outputs else DEFAULT_EPS,
                anti_aliasing=self.anti_aliasing,
                two_sided=validate.flag("fill_back", self.fill_back),
                perspective=perspective,
                gradient=self.gradient,
            )

    def _project(
        self, vertices: Tensor, K: Any, R: Any, t: Any, dist_coeffs: Any, orig_size: Any
    ) -> tuple[Tensor, bool]:
        """Vertices in screen space, and whether depth runs in perspective between them."""
        mode = _mode(self.camera_mode)
        if mode == "projection":
            K, R, t = (self._given(name, value) for name, value in (("K", K), ("R", R), ("t", t)))
            dist_coeffs = self.dist_coeffs if dist_coeffs is None else dist_coeffs
            size = self.orig_size if orig_size is None else orig_size
            return projection(vertices, K, R, t, dist_coeffs, size), True
        divided = validate.flag("perspective", self.perspective)
        if mode == "look_at":
            vertices = look_at(vertices, self.eye, up=self.camera_up)
        elif mode == "look":
            vertices = look(vertices, self.eye, self.camera_direction, self.camera_up)
        else:
            return validate.vertices(vertices), True
        if divided:
            vertices = in_perspective(vertices, self.viewing_angle, "viewing_angle")
        return vertices, divided

    def _given(self, name: str, value: Any) -> Any:
        value = getattr(self, name) if value is None else value
        if value is None:
            raise ValueError(
                f'{name}: expected a camera matrix for camera_mode "projection", got None; give K, R and t to '
                'Renderer or to the call, or choose camera_mode="look_at"'
            )
        return value


def _mode(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"camera_mode: expected a string, got {type(value).__name__}")
    return value


def _default_eye(angle: Any) -> Any:
    """The place on -z from which a square of side 2 at z = -1 fills the image: [3], or [B, 3] for angles [B]."""
    angle = scalar("viewing_angle", angle, torch.get_default_dtype())
    if isinstance(angle, Tensor):
        z = -1 / torch.tan(torch.deg2rad(angle.detach())) - 1
        return torch.stack((torch.zeros_like(z), torch.zeros_like(z), z), -1)
    return [0, 0, -(1.0 / math.tan(math.radians(angle)) + 1) if angle else -math.inf]


def _as_tensor(name: str, value: Any) -> Any:
    """Arrays and lists as tensors, so that programs can move and multiply them; anything else as it is."""
    return as_tensor(name, value, torch.float32) if isinstance(value, (np.ndarray, list, tuple)) else value


def _own(value: Any) -> Any:
    """Settable attributes are lists, as they were, and never shared between renderers."""
    return value if isinstance(value, torch.Tensor) or not hasattr(value, "__iter__") else list(value)
