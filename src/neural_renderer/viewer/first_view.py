"""`FirstView`: the first view of browsers, and of cameras that nobody has moved since."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .layout import FIELD, clip_distances

if TYPE_CHECKING:
    import viser

_UNMOVED = 0.02  # distance from a first view, relative to the target's, below which a camera counts as unmoved
_VIEWS = 16  # first views remembered, to recognise unmoved cameras


class FirstView:
    """First view of a page. A camera that somebody has moved stays where it is."""

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
        """Tell whether the camera of a browser is still at a first view."""
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
