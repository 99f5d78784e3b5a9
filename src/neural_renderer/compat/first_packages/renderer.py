"""`Renderer` of the first packages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ...base import constants, validate
from ...camera import look, look_at, projection
from ...camera.lens import in_perspective
from ...camera.lens import viewing_angle as checked_angle
from ...camera.parameters import as_tensor, scalar
from ...raster.faces import checked_faces, vertices_to_faces
from ...raster.outputs import Images
from ...raster.rasterize import rasterize_images
from ...raster.settings import image_size
from ...shading.lights import Light, light_factors
from .rasterize import DEFAULT_EPS, DEFAULT_FAR, DEFAULT_NEAR, near_plane

# Attribute of `Light` → attribute of `Renderer`.
_LIGHT = {
    "ambient": "light_intensity_ambient",
    "directional": "light_intensity_directional",
    "ambient_color": "light_color_ambient",
    "directional_color": "light_color_directional",
    "direction": "light_direction",
}
# Argument of `rasterize_images` → attribute of `Renderer`.
_RASTERIZER = {"size": "image_size", "background": "background_color", "eps": "rasterizer_eps", "light": "light_*"}
_COLOR_EPS = 1e-3  # default of the first packages


class Renderer(nn.Module):
    """Renderer of the first packages. Each argument is also an attribute, which can be set at any time.

    As in the first packages, "look_at" and "look" mirror the image, and in "projection" mode the back sides of faces
    are lit. New code uses `render`, which does neither.

    ``camera_mode`` chooses the camera:

    - "projection": calibrated camera as in OpenCV, with K, R, t, dist_coeffs and orig_size; see `projection`.
    - "look_at": camera at ``eye`` that looks at the origin, with ``camera_up`` upwards.
    - "look": camera at ``eye`` that looks along ``camera_direction``.
    - any other string: no camera; vertices are in screen space.

    Args:
        image_size: Side, or (height, width), in pixels.
        anti_aliasing: Supersample at twice the size.
        background_color: Number, [3], [B, 3] or an image.
        fill_back: Render both sides of every face.
        camera_mode: See above.
        K: Intrinsic matrix in pixels, [3, 3] or [B, 3, 3]. Arrays and lists become float32 tensors on the device of
            `load_obj`, here and for R, t and dist_coeffs.
        R: World-to-camera rotation, [3, 3] or [B, 3, 3].
        t: World-to-camera translation, [3], [B, 3] or [B, 1, 3].
        dist_coeffs: (k1, k2, p1, p2, k3), [5] or [B, 5]; None means zeros [1, 5].
        orig_size: Side, or (height, width), in pixels of the image that K describes.
        perspective: Divide by depth, in the modes "look_at" and "look".
        viewing_angle: Half the field of view in degrees, in (0, 90): number, or tensor [] or [B]. The initial eye is on
            the −z axis, where a square of side 2 at z = −1 fills the image.
        camera_direction: Viewing direction in the mode "look", [3] or [B, 3].
        near, far: Smallest and largest visible depth. A number below 0 for ``near`` is 0.
        light_intensity_ambient, light_intensity_directional: See ``ambient`` and ``directional`` of `Light`.
        light_color_ambient, light_color_directional: See ``ambient_color`` and ``directional_color`` of `Light`.
        light_direction: See ``direction`` of `Light`.
        gradient: Gradient estimator, "nmr" or "edge".
        camera_up: Direction that is up in the picture, [3] or [B, 3].
        image_height, image_width: Height and width in pixels; they take precedence over ``image_size``.

    Attributes:
        eye: Position of the camera, [3] or [B, 3].
        rasterizer_eps: eps of `rasterize_images` for colour, 1e-3. For silhouettes and depth it is always 1e-4.

    Raises:
        TypeError, ValueError: An argument does not fit. Most attributes are checked when they are used.

    Example:
        >>> renderer = nr.Renderer(image_size=64, camera_mode="look_at")
        >>> renderer.eye = nr.get_points_from_angles(2.7, 0.0, 30.0)
        >>> vertices, faces, textures = mesh.get_batch(1)
        >>> rgb, depth, alpha = renderer(vertices, faces, textures)
        >>> alpha = renderer(vertices, faces, mode="silhouettes")
        >>> rgb, depth, alpha = renderer.render(vertices, faces, textures)
        >>> rgb = renderer.render_rgb(vertices, faces, textures)
        >>> alpha = renderer.render_silhouettes(vertices, faces)
        >>> depth = renderer.render_depth(vertices, faces)
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
        self.background_color = _list_copy(background_color)
        self.fill_back = fill_back
        self.camera_mode = _mode(camera_mode)
        self.K, self.R, self.t = _as_tensor("K", K), _as_tensor("R", R), _as_tensor("t", t)
        self.dist_coeffs = _as_tensor("dist_coeffs", [[0.0] * 5] if dist_coeffs is None else dist_coeffs)
        self.orig_size = orig_size
        self.perspective = perspective
        self.viewing_angle = viewing_angle
        if camera_mode in ("look_at", "look") and perspective:
            checked_angle("viewing_angle", viewing_angle, torch.get_default_dtype())
        self.eye: Any = _default_eye(viewing_angle)
        self.camera_direction = _list_copy(camera_direction)
        self.camera_up = _list_copy(camera_up)
        self.near = near
        self.far = far
        self.light_intensity_ambient = light_intensity_ambient
        self.light_intensity_directional = light_intensity_directional
        self.light_color_ambient = _list_copy(light_color_ambient)
        self.light_color_directional = _list_copy(light_color_directional)
        self.light_direction = _list_copy(light_direction)
        self.rasterizer_eps = _COLOR_EPS
        self.gradient = gradient

    @property
    def image_height(self) -> int:
        """Height of the images in pixels. Setting it keeps the width."""
        return image_size("image_size", self.image_size)[0]

    @image_height.setter
    def image_height(self, height: int) -> None:
        self.image_size = height, self.image_width

    @property
    def image_width(self) -> int:
        """Width of the images in pixels. Setting it keeps the height."""
        return image_size("image_size", self.image_size)[1]

    @image_width.setter
    def image_width(self, width: int) -> None:
        self.image_size = self.image_height, width

    def __setattr__(self, name: str, value: Any) -> None:
        # nn.Module does not allow a parameter to be replaced by a number.
        if name in getattr(self, "_parameters", ()) and not isinstance(value, nn.Parameter):
            del self._parameters[name]
        super().__setattr__(name, value)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Pickles of the first packages and of earlier versions lack some attributes. These get their defaults.
        super().__setstate__({**vars(Renderer()), **state})  # type: ignore[no-untyped-call]

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
        """Draw images.

        Args:
            vertices, faces, textures, K, R, t, dist_coeffs, orig_size: As in `render`.
            mode: None calls `render`, "rgb" `render_rgb`, "silhouettes" `render_silhouettes`, "depth" `render_depth`.

        Returns:
            The result of the method that ``mode`` selects.

        Raises:
            TypeError, ValueError: As `render`, or the mode is unknown.
        """
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
        """Draw colour, depth and alpha.

        Args:
            vertices: [B, V, 3] floating.
            faces: [B, F, 3] or [F, 3], whole numbers.
            textures: [B, F, T, T, T, 3] floating.
            K, R, t, dist_coeffs, orig_size: Replace the attributes of the same name for this call.

        Returns:
            (rgb [B, 3, H, W], depth [B, H, W], alpha [B, H, W]).

        Raises:
            TypeError, ValueError: An argument or attribute does not fit.
        """
        images = self._draw(("rgb", "alpha", "depth"), vertices, faces, textures, (K, R, t, dist_coeffs, orig_size))
        return images.rgb, images.depth, images.alpha

    def render_rgb(
        self, vertices: Tensor, faces: Tensor, textures: Tensor | None, K: Any = None, R: Any = None, t: Any = None,
        dist_coeffs: Any = None, orig_size: int | tuple[int, int] | None = None,
    ) -> Tensor:  # fmt: skip
        """Draw colour.

        Args:
            vertices, faces, textures, K, R, t, dist_coeffs, orig_size: As in `render`.

        Returns:
            [B, 3, H, W] float32.

        Raises:
            TypeError, ValueError: As `render`.
        """
        return self._draw(("rgb",), vertices, faces, textures, (K, R, t, dist_coeffs, orig_size)).rgb

    def render_silhouettes(
        self, vertices: Tensor, faces: Tensor, K: Any = None, R: Any = None, t: Any = None,
        dist_coeffs: Any = None, orig_size: int | tuple[int, int] | None = None,
    ) -> Tensor:  # fmt: skip
        """Draw silhouettes.

        Args:
            vertices, faces, K, R, t, dist_coeffs, orig_size: As in `render`.

        Returns:
            [B, H, W] float32: 1 on faces, 0 elsewhere, fractions with ``anti_aliasing``.

        Raises:
            TypeError, ValueError: As `render`.
        """
        return self._draw(("alpha",), vertices, faces, None, (K, R, t, dist_coeffs, orig_size)).alpha

    def render_depth(
        self, vertices: Tensor, faces: Tensor, K: Any = None, R: Any = None, t: Any = None,
        dist_coeffs: Any = None, orig_size: int | tuple[int, int] | None = None,
    ) -> Tensor:  # fmt: skip
        """Draw depth.

        Args:
            vertices, faces, K, R, t, dist_coeffs, orig_size: As in `render`.

        Returns:
            [B, H, W] float32, in world units; ``far`` in the background.

        Raises:
            TypeError, ValueError: As `render`.
        """
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
        corners = vertices_to_faces(validate.in_float32("vertices on the screen", screen), faces)
        light = None
        if "rgb" in outputs:
            lamp = Light(**{name: getattr(self, attribute) for name, attribute in _LIGHT.items()})
            # Light is computed in world space, on the side that the first packages lit (see the class).
            with validate.called(**_LIGHT):
                light = light_factors([lamp], vertices, faces, len(corners), mirrored=True)
        with validate.called(**_RASTERIZER):
            return rasterize_images(
                corners,
                self.image_size,
                outputs=outputs,
                textures=textures,
                light=light,
                background=self.background_color,
                near=near_plane(self.near, corners),
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
        """Project vertices to screen space; return also whether depth is interpolated in perspective."""
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
        """Return the argument of a call, or else the attribute ``name``; raise ValueError if both are None."""
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
    """Place the eye on the −z axis so that a square of side 2 at z = −1 fills the image: [3], or [B, 3]."""
    angle = scalar("viewing_angle", angle, torch.get_default_dtype())
    if isinstance(angle, Tensor):
        z = -1 / torch.tan(torch.deg2rad(angle.detach())) - 1
        return torch.stack((torch.zeros_like(z), torch.zeros_like(z), z), -1)
    return [0, 0, -(1.0 / math.tan(math.radians(angle)) + 1) if angle else -math.inf]


def _as_tensor(name: str, value: Any) -> Any:
    """Convert arrays and lists to tensors, so that programs can multiply them; keep other values."""
    given = isinstance(value, (np.ndarray, list, tuple))
    return as_tensor(name, value, torch.float32).to(constants.old_device()) if given else value


def _list_copy(value: Any) -> Any:
    """Copy a sequence to a list, as in the first packages, so that renderers share none; keep tensors and numbers."""
    return value if isinstance(value, torch.Tensor) or not hasattr(value, "__iter__") else list(value)
