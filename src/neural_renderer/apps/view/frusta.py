"""Cameras as frusta, with their photographs."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...base import validate
from ...camera import Camera
from ...camera.rotations import to_quaternion
from .layout import Box

if TYPE_CHECKING:
    import viser

_MOST = 200  # frusta drawn
_PHOTO = 192  # longer side of a photograph in the scene, in pixels
_SIZE = 0.08  # size of a frustum, relative to the median distance of the cameras from the scene's centre
_FAR = 1.5  # distance, relative to that median, beyond which the first view may omit cameras
_COLOR = (70, 90, 120)  # RGB
_PAPER = 0.93  # grey behind the cut-out object of a photograph
_PARALLEL = 0.05  # drawn field of view of orthographic cameras, in radians


@dataclass(frozen=True, eq=False)
class Photograph:
    """A camera with its photograph [1, 3, H, W] and mask [1, H, W], both in [0, 1] or None."""

    camera: Camera
    masks: Tensor | None
    photos: Tensor | None

    @property
    def size(self) -> tuple[int, int] | None:
        """Height and width in pixels."""
        known = self.masks if self.photos is None else self.photos
        return None if known is None else (known.shape[-2], known.shape[-1])

    def pose(self) -> tuple[np.ndarray, np.ndarray, bool]:
        """Return axes [3, 3] (columns right, down, forward), position [3], and whether the picture is mirrored."""
        camera = self.camera.to(dtype=torch.float64)
        position, forward, up, axis = (
            part[0].detach().numpy() for part in (camera.position, camera.forward, camera.up, camera.axes[:, 0])
        )
        right = np.cross(forward, up)
        return np.stack((right, -up, forward), 1), position, bool(right @ axis < 0)

    def field(self) -> float:
        """Return the vertical field of view in radians."""
        fov = self.camera.fov
        return _PARALLEL if fov is None else math.radians(float(torch.as_tensor(fov).reshape(-1)[0]))


def photographs(camera: Any, photos: Any, masks: Any) -> list[Photograph]:
    """Check the arguments of `Viewer.show_cameras`, and split them by camera."""
    if not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a Camera, got {type(camera).__name__}")
    count = len(camera)
    if photos is not None:
        photos = validate.floating("photos", photos, (count, 3, "H", "W")).detach().float().cpu()
    if masks is not None:
        masks = validate.floating("masks", masks, (count, "H", "W")).detach().float().cpu()
        if photos is not None and masks.shape[1:] != photos.shape[2:]:
            raise ValueError(f"masks: expected the size of the photos, got {validate.shape_of(masks)}")
    parts: Any = ([None] * count if part is None else part.split(1) for part in (masks, photos))
    return [Photograph(*one) for one in zip(camera.to("cpu"), *parts, strict=True)]


class Frusta:
    """The cameras of a page, and photographs by name. The methods are called in the worker's thread."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._nodes: list[Any] = []
        self._box: Any = None
        self._near = np.zeros((0, 3))  # positions of the cameras that the first view shows
        self.photographs: dict[str, Photograph] = {}

    def show(self, name: str, taken: list[Photograph], center: np.ndarray) -> None:
        """Show cameras around meshes with this centre [3], in place of earlier cameras."""
        for node in self._nodes:
            node.remove()
        self.photographs = {f"photo {number + 1}": one for number, one in enumerate(taken)}
        poses = [one.pose() for one in taken]
        positions = np.array([position for _, position, _ in poses])
        distances = np.linalg.norm(positions - center, axis=1)
        distance = float(np.median(distances))
        self._near = positions[distances <= _FAR * distance]
        path = f"/cameras/{re.sub(r'[^0-9A-Za-z_.-]', '_', name)}"
        self._nodes = [
            self._add(f"{path}/{number}", taken[number], poses[number], _SIZE * max(distance, 1e-6))
            for number in sorted({round(i * (len(taken) - 1) / max(_MOST - 1, 1)) for i in range(_MOST)})
            if number < len(taken)
        ]
        if self._box is None:
            self._box = self._server.gui.add_checkbox("Cameras", True)
            self._box.on_update(self._hide)

    def bounds(self) -> list[Box]:
        """Return the box around the visible cameras, without far cameras; an empty list if there is none."""
        if self._box is None or not self._box.value or not len(self._near):
            return []
        return [(self._near.min(0), self._near.max(0))]

    def seen_in(self, point: np.ndarray) -> str:
        """Say where the first photograph that shows a point [3] has it, in shares of its width and height."""
        for name, one in self.photographs.items():
            if one.size is None:
                continue
            pixels, depth = one.camera.project(torch.as_tensor(point)[None].to(one.camera.rotation), one.size)
            x, y = (pixels[0, 0] / torch.tensor([one.size[1], one.size[0]])).tolist()
            if float(depth) > 0 and 0 <= x < 1 and 0 <= y < 1:
                return f"; {name} shows it at {x:.3f} {y:.3f}"
        return ""

    def _hide(self, _: Any) -> None:
        for node in self._nodes:
            node.visible = self._box.value

    def _add(self, path: str, one: Photograph, pose: tuple[np.ndarray, np.ndarray, bool], size: float) -> Any:
        """Add a frustum; a click on it takes the browser there."""
        axes, position, mirrored = pose
        height, width = one.size or (3, 4)
        node = self._server.scene.add_camera_frustum(
            path,
            one.field(),
            width / height,
            scale=size,
            thickness=1.5,
            thickness_units="screen",
            color=_COLOR,
            image=_pixels(one, mirrored),
            wxyz=quaternion(axes),
            position=position,
        )

        def go(event: Any) -> None:
            camera = event.client.camera
            with event.client.atomic():
                camera.wxyz, camera.position, camera.fov = quaternion(axes), position, one.field()

        node.on_click(go)
        return node


def quaternion(axes: np.ndarray) -> np.ndarray:
    """Convert a rotation [3, 3] to a quaternion (w, x, y, z)."""
    return np.asarray(to_quaternion(torch.from_numpy(axes)))


def _pixels(one: Photograph, mirrored: bool) -> np.ndarray | None:
    """Make the image on a frustum's plane, [H, W, 3] uint8."""
    if one.size is None:
        return None
    picture = torch.full((1, 3, *one.size), 0.6) if one.photos is None else one.photos
    if one.masks is not None:
        picture = picture * (1.0 if one.photos is not None else one.masks[:, None]) + _PAPER * (1 - one.masks[:, None])
    return thumbnail(picture[0].flip(2) if mirrored else picture[0], _PHOTO)


def thumbnail(picture: Tensor, most: int) -> np.ndarray:
    """Reduce a picture [3, H, W] in [0, 1] to ``most`` pixels a side: [H, W, 3] uint8."""
    scale = min(most / max(picture.shape[1:]), 1.0)
    size = [max(round(side * scale), 1) for side in picture.shape[1:]]
    small = F.interpolate(picture[None], size, mode="area")[0]
    return (small.permute(1, 2, 0).clamp(0, 1) * 255 + 0.5).byte().numpy()
