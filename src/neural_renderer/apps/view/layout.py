"""Layout of meshes in the scene, and a first view that shows all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import viser

Box = tuple[np.ndarray, np.ndarray]
"""Least and greatest coordinates, [3] each."""
Up = str | tuple[float, float, float]
"""An axis, such as "+z", or a direction."""
FIELD = 0.7
"""Vertical field of view of the first view, in radians."""
_ASPECT = 0.9  # least width over height of the first view: panels may be on both sides
_VIEW = np.array([-0.45, 0.35, 1.0])  # direction of the first view: right, up, backward
_GAP = 0.25  # gap between meshes in a row, relative to the widest mesh
_SLANTED = 0.9  # above this cosine between the direction up and z, x is right
_NEAR, _FAR = 1e-3, 1e2  # clipping planes, relative to the distance of the first view
_BACKGROUND = 1.0  # distance of viser's background plane
_MOST_NEARER = 10.0  # largest near distance, relative to the background's, that is shortened to show the background
_MARGIN = 1.1  # distance of the first view, relative to the least that shows everything
_UNMOVED = 0.02  # distance from a first view, relative to the target's, below which a camera counts as unmoved
_VIEWS = 16  # first views remembered, to recognise unmoved cameras


def axes_of(up: Up) -> np.ndarray:
    """Return directions right, up and backward as rows [3, 3], for an axis that is up, such as "+z", or a direction."""
    if not isinstance(up, str):
        upward = np.asarray(up, np.float64) / np.linalg.norm(up)
        right = np.cross(upward, np.eye(3)[2] if abs(upward[2]) < _SLANTED else np.eye(3)[0])
        right /= np.linalg.norm(right)
        return np.stack((right, upward, np.cross(right, upward)))
    number, sign = "xyz".index(up[1]), -1.0 if up[0] == "-" else 1.0
    upward = sign * np.eye(3)[number]
    right = np.eye(3)[0 if number else 1]
    return np.stack((right, upward, np.cross(right, upward)))


def places_in_row(boxes: Sequence[Box], axes: np.ndarray) -> list[np.ndarray]:
    """Choose places [3] of the origins of meshes, so that they stand in a row on the ground of the first mesh.

    Boxes bound the meshes, each in its own coordinates; ``axes`` are as in `axes_of`.
    """
    turned = [_turned(box, axes) for box in boxes]
    widths = [float(high[0] - low[0]) for low, high in turned]
    gap = _GAP * max(widths, default=0.0)
    left = -(sum(widths) + gap * (len(widths) - 1)) / 2
    places = []
    for (low, high), width in zip(turned, widths, strict=True):
        start_low, start_high = turned[0]
        start, middle = (start_low + start_high) / 2, (low + high) / 2
        place = np.array([start[0] + left + width / 2 - middle[0], start_low[1] - low[1], start[2] - middle[2]])
        places.append(axes.T @ place)
        left += width + gap
    return places


def first_view(boxes: Sequence[Box], axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Choose the position of a camera, and the point it looks at, [3] each, so that all boxes are in the picture."""
    backward = axes.T @ _VIEW
    if not boxes:
        return backward, np.zeros(3)
    low, high = np.min([one for one, _ in boxes], 0), np.max([one for _, one in boxes], 0)
    center = (low + high) / 2
    corners = np.stack(np.meshgrid(*np.stack((low, high), 1)), -1).reshape(-1, 3) - center
    backward = backward / np.linalg.norm(backward)
    right = np.cross(axes[1], backward)
    right /= np.linalg.norm(right)
    height, width = np.abs(corners @ np.cross(backward, right)), np.abs(corners @ right)
    needed = np.maximum(height, width / _ASPECT) / np.tan(FIELD / 2) + corners @ backward
    distance = _MARGIN * max(float(needed.max()), 1e-6)
    return center + distance * backward, center


def clip_distances(radius: float) -> tuple[float, float]:
    """Choose near and far planes for a camera at distance ``radius`` from its target.

    viser draws the background on a plane at distance 1, which has to lie between them. In very large scenes the
    background is lost: a closer near plane would exhaust depth precision.
    """
    near = radius * _NEAR
    if _BACKGROUND <= near <= _MOST_NEARER * _BACKGROUND:
        near = _BACKGROUND / 2
    return near, max(radius * _FAR, 2 * _BACKGROUND)


def _turned(box: Box, axes: np.ndarray) -> Box:
    one, other = axes @ box[0], axes @ box[1]
    return np.minimum(one, other), np.maximum(one, other)


class FirstView:
    """First view of a page. Cameras that a user has moved stay."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._positions: list[np.ndarray] = []  # the newest is the last
        self._center = np.zeros(3)
        server.on_client_connect(self._greet)

    def choose(self, position: np.ndarray, center: np.ndarray, move: bool) -> None:
        """Choose the view, a position [3] and where it looks, [3], of browsers that connect later, and of those there.

        ``move`` all their cameras; otherwise those that nobody has moved.
        """
        radius = float(np.linalg.norm(position - center))
        camera = self._server.initial_camera
        camera.fov, (camera.near, camera.far) = FIELD, clip_distances(radius)
        camera.position, camera.look_at = tuple(position), tuple(center)
        clients = self._server.get_clients().values()
        moving = [client for client in clients if move or self.is_unmoved(client)]
        self._positions, self._center = [*self._positions[1 - _VIEWS :], position], center
        for client in moving:
            look_from(client, position, center)

    def is_unmoved(self, client: viser.ClientHandle) -> bool:
        """Return whether a browser's camera is still at a first view."""
        position = client.camera.position
        return any(
            np.linalg.norm(position - first) < _UNMOVED * np.linalg.norm(position - client.camera.look_at)
            for first in self._positions
        )

    def _greet(self, client: viser.ClientHandle) -> None:
        """Show everything to a browser that has loaded an earlier first view, while it connected."""
        newest = self._positions[-1]
        if self.is_unmoved(client) and not np.allclose(client.camera.position, newest, rtol=1e-3, atol=1e-6):
            look_from(client, newest, self._center)


def look_from(client: viser.ClientHandle, position: np.ndarray, center: np.ndarray) -> None:
    """Move the camera of a browser to a position [3], to look at a centre [3]."""
    with client.atomic():
        client.camera.position, client.camera.look_at = position, center
