"""`Scene`: the meshes of a page."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from .drawing.snapshot import Snapshot
from .drawing.surface import Look
from .layout import Box, FirstView, Up, axes_of, first_view, look_from, places_in_row
from .shown import Shown, extent_of
from .worker import Worker

if TYPE_CHECKING:
    import viser

_DECODING, _DECODED = 0.1, 2e7  # least seconds for which a browser decodes a mesh, and bytes per second beyond
_MOST_DECODING = 2.0  # most seconds for which a browser decodes a mesh
_AMBIENT = 1.1  # intensities: π shows a white surface that faces a lamp as white
# A lamp shines from its place, right, up and backward, to the origin.
_LAMPS = (((-0.5, 0.8, 0.7), 1.8), ((0.7, -0.2, 0.3), 0.5), ((0.2, 0.3, -1.0), 0.8))
_GROWN = 1.4  # growth or shrinkage since the first view after which a mesh is seen whole again


class Scene:
    """The meshes of a page."""

    def __init__(self, server: viser.ViserServer, worker: Worker) -> None:
        self._server, self._worker = server, worker
        self._lock = threading.Lock()
        self._coming: dict[str, Snapshot] = {}
        self._stale: set[str] = set()
        self._paths = 0
        self._axes = axes_of("+y")
        self.look, self.wireframe, self.normals = Look(), False, False
        self.side_by_side = True  # arrange meshes in a row; otherwise at their coordinates
        self.equal_size = False  # all meshes are shown as large as the first
        self.meshes: dict[str, Shown] = {}  # only the worker's thread changes these
        self.first_view = FirstView(server)
        self.on_change: Callable[[], None] = lambda: None
        """Called in the worker's thread after meshes have changed or moved."""
        self.other_bounds: Callable[[], list[Box]] = list
        """Returns the boxes around everything else that the first view has to show."""
        server.scene.set_up_direction("+y")
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/lights/ambient", intensity=_AMBIENT)
        self._lamps = [
            server.scene.add_light_directional(
                f"/lights/lamp_{number}", intensity=intensity, position=direction, cast_shadow=False
            )
            for number, (direction, intensity) in enumerate(_LAMPS)
        ]
        self._set_first_view()

    def put(self, name: str, snapshot: Snapshot) -> None:
        """Show a mesh soon, in place of one of the same name. Any thread may call it."""
        with self._lock:
            self._coming[name] = snapshot
        self._worker.post("meshes", self._update)

    def redraw(self, *names: str) -> None:
        """Show these meshes, or all, again soon, after the look has changed. Any thread may call it."""
        with self._lock:
            self._stale.update(names or self.meshes)
        self._worker.post("meshes", self._update)

    def remove(self, name: str) -> None:
        """Take a mesh away soon. Any thread may call it."""

        def job() -> None:
            shown = self.meshes.pop(name, None)
            if shown is not None and shown.frame is not None:
                shown.frame.remove()
            self._arrange()
            self.on_change()

        with self._lock:
            self._coming.pop(name, None)
        self._worker.post(f"remove {name}", job)

    def center(self) -> np.ndarray:
        """Return the centre [3] of all visible meshes."""
        return first_view(self._bounds(), self._axes)[1]

    def set_up(self, up: Up) -> None:
        """Choose what is up. Any thread may call it."""
        self._axes = axes_of(up)
        self._server.scene.set_up_direction(up)  # type: ignore[arg-type]
        for lamp, (direction, _) in zip(self._lamps, _LAMPS, strict=True):
            lamp.position = tuple(self._axes.T @ direction)
        self.arrange()

    def _choose_view(self) -> tuple[np.ndarray, np.ndarray]:
        """Choose the position of a camera, and the point it looks at, so that everything visible is in the picture."""
        return first_view(self._bounds() + self.other_bounds(), self._axes)

    def _bounds(self) -> list[Box]:
        boxes = [(shown.place, *shown.snapshot.bounds()) for shown in list(self.meshes.values()) if shown.visible]
        return [(place + low, place + high) for place, low, high in boxes]

    def _update(self) -> None:
        with self._lock:
            coming, self._coming = self._coming, {}
            stale, self._stale = self._stale | set(coming), set()
        is_first = not self.meshes
        known = len(self.meshes)
        for name, snapshot in coming.items():
            usable, left_out = snapshot.finite()
            if name not in self.meshes:
                self._paths += 1  # not the name: two names may differ in characters that a path cannot have
                self.meshes[name] = Shown(usable, f"/meshes/{self._paths}")
            shown = self.meshes[name]
            if shown.values is not None and len(shown.values) != len(usable.vertices):
                shown.values = None
            shown.original = shown.snapshot = usable
            shown.left_out = left_out
        self._resize(set(coming))
        for name in stale & set(self.meshes):
            self.meshes[name].draw(self._server, self.look, self.wireframe, self.normals)
        if len(self.meshes) != known:
            self._arrange()
            self._set_first_view(move=is_first)
        elif any(self._has_grown(self.meshes[name]) for name in coming):
            self._set_first_view(move=False)
        self._swap()
        if coming:
            self.on_change()

    def _resize(self, new: Iterable[str] = ()) -> None:
        """Choose the sizes of meshes as shown; draw meshes soon whose size changes, except ``new`` ones."""
        reference = 0.0
        for name, shown in self.meshes.items():
            extent = extent_of(shown.original) if self.equal_size else 0.0
            reference = reference or extent
            scale = reference / extent if extent else 1.0
            if scale == shown.scale and (scale == 1 or name not in new):
                continue
            shown.resize(scale)
            if name not in new:
                self.redraw(name)

    def _swap(self) -> None:
        replaced = [shown for shown in self.meshes.values() if shown.back is not None]
        if any(shown.front is not None for shown in replaced) and self._server.get_clients():
            self._server.flush()
            largest = max(shown.coming for shown in replaced)
            time.sleep(min(_DECODING + largest / _DECODED, _MOST_DECODING))
        with self._server.atomic():
            for shown in replaced:
                shown.swap()

    def _arrange(self) -> None:
        """Arrange meshes in a row around the first one, on its ground, or at their coordinates."""
        meshes = list(self.meshes.values())
        places = [np.zeros(3) for _ in meshes]
        if self.side_by_side and len(meshes) > 1:
            places = places_in_row([shown.snapshot.bounds() for shown in meshes], self._axes)
        for shown, place in zip(meshes, places, strict=True):
            shown.place_at(place)

    def arrange(self) -> None:
        """Arrange the meshes again soon, and show all of them. Any thread may call it."""

        def job() -> None:
            self._resize()
            self._arrange()
            self._set_first_view()
            self.on_change()

        self._worker.post("arrange", job)

    def show_whole(self, client: viser.ClientHandle) -> None:
        """Move the camera of a browser so that everything is visible. Any thread may call it."""
        look_from(client, *self._choose_view())

    def _set_first_view(self, move: bool = True) -> None:
        """Choose the first view; ``move`` the cameras of all browsers, or else only those that nobody has moved."""
        self.first_view.choose(*self._choose_view(), move=move)  # nobody's own view changes because a mesh has come
        for shown in self.meshes.values():
            shown.framed = extent_of(shown.snapshot)

    def _has_grown(self, shown: Shown) -> bool:
        """Return whether a mesh has become much larger or smaller since the first view was chosen."""
        extent = extent_of(shown.snapshot)
        return not shown.framed / _GROWN <= extent <= shown.framed * _GROWN
