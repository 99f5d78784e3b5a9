"""The package's own rendering from the browser's view, as a loss receives it, and the gradient of a loss."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ....camera import Camera
from ....camera.rotations import from_quaternion
from ....optim import losses
from ....raster import Images
from ....rendering.forward import render
from ....shading.lights import CameraLight
from .snapshot import Snapshot
from .surface import vertex_normals

IMAGE_LOSSES = ("silhouette IoU", "photometric")
"""Losses that compare with a target."""
FREE_LOSSES = ("area", "brightness", "laplacian", "edge length", "normal consistency", "smoothness")
"""Losses without a target: the first two of the picture, the others of the mesh."""
_NEAREST, _FARTHEST = 1e-3, 1e3  # clipping planes, relative to the eye's distance from the mesh
_LENGTH, _LEAST = 0.1, 0.02  # longest arrow, relative to the mesh; least gradient of an arrow, relative to the largest
_MOST_ARROWS = 3000
_ASPECT = 16  # greatest aspect of a picture, and of its inverse
_COLD, _WARM, _HOT = (0.80, 0.83, 0.88), (0.96, 0.62, 0.20), (0.72, 0.05, 0.12)  # colours of small to large gradients


@dataclass(frozen=True, eq=False)
class View:
    """The camera of a browser: a quaternion [4] with the axes right, down and forward, and a position [3].

    The vertical field of view is in radians; the aspect is width over height.
    """

    wxyz: np.ndarray
    position: np.ndarray
    field: float
    aspect: float

    @property
    def is_usable(self) -> bool:
        """Whether it is a camera that browsers have: messages may hold anything."""
        numbers = (*self.wxyz, *self.position, self.field)
        return all(map(math.isfinite, numbers)) and 0 < self.field < math.pi and 1 / _ASPECT < self.aspect < _ASPECT

    def camera(self, place: np.ndarray) -> Camera:
        """Make the camera in the coordinates of a mesh whose origin is at ``place`` [3]."""
        pose = torch.eye(4)
        pose[:3, :3] = from_quaternion(torch.from_numpy(np.asarray(self.wxyz, np.float64)))
        pose[:3, 3] = torch.from_numpy(np.asarray(self.position - place, np.float64))
        return Camera.from_matrix(camera_to_world=pose, fov=math.degrees(self.field))

    def size(self, height: int) -> tuple[int, int]:
        """Return height and width of a picture."""
        return height, max(round(height * self.aspect), 1)


def draw(
    snapshot: Snapshot,
    camera: Camera,
    size: tuple[int, int],
    *,
    lit: bool,
    vertices: Tensor | None = None,
    gradient: str = "edge",
) -> Images:
    """Render a mesh as colour, alpha and depth by one camera in its coordinates, on black.

    ``lit``: a lamp over the viewer's shoulder lights it. ``vertices`` are others [V, 3], such as those that require a
    gradient.
    """
    reach = _reach(snapshot, camera)
    return render(
        snapshot.shape() if vertices is None else snapshot.moved(vertices),
        camera,
        size,
        light=CameraLight() if lit else None,
        background=0.0,
        near=reach * _NEAREST,
        far=reach * _FARTHEST,
        gradient=gradient,
    )


def _reach(snapshot: Snapshot, camera: Camera) -> float:
    """Return an upper bound of the distance from the eye to a mesh."""
    low, high = snapshot.bounds()
    return float(np.linalg.norm(camera.position[0].numpy() - (low + high) / 2) + np.linalg.norm(high - low))


@torch.no_grad()
def picture(
    meshes: Iterable[tuple[Snapshot, np.ndarray]],
    view: View,
    height: int,
    *,
    output: str = "rgb",
    lit: bool = True,
    background: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> np.ndarray:
    """Draw meshes, each with the place [3] of its origin, the nearest surface in front: [H, W, 3] uint8.

    ``output`` is "rgb", "alpha" or "depth"; a background is RGB in [0, 1].
    """
    size = view.size(height)
    rgb = torch.tensor(background)[:, None, None].expand(3, *size)
    alpha, depth = torch.zeros(size), torch.full(size, math.inf)
    for snapshot, place in meshes:
        camera = view.camera(place)
        images = draw(snapshot, camera, size, lit=lit)
        covers = images.alpha[0]
        # Depth at outlines is a mean of samples on the mesh and of samples at the far plane.
        beyond = (1 - covers) * _FARTHEST * _reach(snapshot, camera)
        unmixed = torch.where(covers > 0, (images.depth[0] - beyond) / covers, math.inf)
        front = unmixed <= depth
        # Colours over black are multiplied by alpha. The outlines of the mesh in front blend with what is behind.
        over = images.rgb[0] + (1 - covers) * rgb
        rgb = torch.where(front, over, rgb)
        alpha, depth = torch.maximum(alpha, covers), torch.minimum(unmixed, depth)
    shown = rgb if output == "rgb" else (alpha if output == "alpha" else _grey(depth)).expand(3, *size)
    return (shown.permute(1, 2, 0).clamp(0, 1) * 255 + 0.5).byte().numpy()


def _grey(depth: Tensor) -> Tensor:
    """Convert depth to grey: the nearest point is white, the farthest dark, the background black."""
    known = depth[torch.isfinite(depth)]
    if not len(known):
        return torch.zeros_like(depth)
    low, high = torch.quantile(known[:: max(len(known) // 100_000, 1)], torch.tensor([0.0, 0.98]))
    grey = 1 - 0.75 * ((depth - low) / (high - low).clamp(min=1e-6)).clamp(0, 1)
    return torch.where(torch.isfinite(depth), grey, 0.0)


@dataclass(frozen=True, eq=False)
class Target:
    """Target of a loss: alpha [1, H, W] in [0, 1], and RGB [1, 3, H, W], multiplied by alpha, or None."""

    alpha: Tensor
    rgb: Tensor | None


def loss_gradient(
    snapshot: Snapshot,
    camera: Camera,
    size: tuple[int, int],
    loss: str,
    *,
    target: Target | None = None,
    gradient: str = "edge",
    lit: bool = True,
) -> tuple[float, Tensor]:
    """Compute one of `IMAGE_LOSSES` or `FREE_LOSSES`, and its gradient on the vertices, [V, 3]; arguments as of `draw`.

    An image loss compares with the target; ValueError: it has none.
    """
    vertices = snapshot.vertices.clone().requires_grad_()
    if loss in ("laplacian", "edge length", "normal consistency", "smoothness"):
        value = getattr(losses, loss.replace(" ", "_"))(vertices, snapshot.faces)
    else:
        images = draw(snapshot, camera, size, lit=lit, vertices=vertices, gradient=gradient)
        if loss == "area":
            value = images.alpha.mean()
        elif loss == "brightness":
            value = images.rgb.mean()
        elif target is None:
            raise ValueError(f"target: expected one for the loss {loss}, got none")
        elif loss == "silhouette IoU":
            value = losses.silhouette_iou_loss(images.alpha, target.alpha)
        else:
            rgb = target.alpha[:, None].expand(-1, 3, -1, -1) if target.rgb is None else target.rgb
            value = losses.photometric(images.rgb, rgb)
    (found,) = torch.autograd.grad(value, vertices)
    return float(value.detach()), found.nan_to_num(posinf=0.0, neginf=0.0)


def arrows(snapshot: Snapshot, gradient: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Make arrows of descent, at vertices against their gradients: starts and ends [N, 2, 3], colours [N, 3] uint8.

    Lengths are proportional to the roots of the gradients.
    """
    size = gradient.norm(dim=1)
    most = size.max() if len(size) else size.new_zeros(())
    if not float(most) > 0:
        return np.zeros((0, 2, 3), np.float32), np.zeros((0, 3), np.uint8)
    rows = torch.nonzero(size > _LEAST * most).flatten()
    if len(rows) > _MOST_ARROWS:
        rows = rows[size[rows].topk(_MOST_ARROWS).indices]
    low, high = snapshot.bounds()
    length = _LENGTH * float((high - low).max())
    starts = snapshot.vertices[rows]
    ends = starts - gradient[rows] / (size[rows, None] * most).sqrt() * length
    # An arrow that points into the mesh ends at its vertex, so that it is visible.
    normals = torch.from_numpy(vertex_normals(snapshot.vertices.numpy(), snapshot.faces.numpy()))[rows]
    inward = ((ends - starts) * normals).sum(1, keepdim=True) < 0
    starts, ends = torch.where(inward, 2 * starts - ends, starts), torch.where(inward, starts, ends)
    colors = (heat(size[rows] / most) * 255 + 0.5).byte()
    return torch.stack((starts, ends), 1).numpy(), colors.numpy()


def heat(values: Tensor) -> Tensor:
    """Choose colours [N, 3] for values [N] in [0, 1]: grey, orange, red; small values stay distinct."""
    cold, warm, hot = (torch.tensor(color) for color in (_COLD, _WARM, _HOT))
    t = values.clamp(0, 1).sqrt()[:, None]
    return torch.where(t < 0.5, cold + (warm - cold) * 2 * t, warm + (hot - warm) * (2 * t - 1))
