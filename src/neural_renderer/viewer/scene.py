"""`Scene`: the meshes of a page, as nodes of viser."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from .drawing.glb import Drawable, write_glb
from .drawing.snapshot import Snapshot
from .drawing.surface import Look, drawables, vertex_normals
from .layout import FIELD, Box, axes_of, clip_distances, first_view, places_in_row
from .worker import Worker

if TYPE_CHECKING:
    import viser

_LINES = (30, 40, 55)  # RGB of the wireframe
_NORMALS = (200, 60, 130)  # RGB of normals
_LIFT = 5e-4  # distance of the wireframe from its faces, relative to the size of the mesh
_NORMAL_LENGTH, _THICKNESS = 0.04, 0.0015  # relative to the size of the mesh
_MOST_NORMALS = 4000  # drawn
_DECODING, _DECODED = 0.1, 2e7  # a browser shows a mesh after so many seconds, and one more for so many bytes
_MOST_DECODING = 2.0  # seconds
_AMBIENT = 1.1  # intensities: π shows a white surface that faces a lamp as white
# A lamp shines from its place, right, up and backward, to the origin.
_LAMPS = (((-0.5, 0.8, 0.7), 1.8), ((0.7, -0.2, 0.3), 0.5), ((0.2, 0.3, -1.0), 0.8))
_UNMOVED = 0.02  # a camera that is nearer to its first place, relative to its distance, was not moved
_VIEWS = 16  # remembered, to tell which cameras were not moved
_GROWN = 1.4  # a mesh that is so many times larger, or smaller, than in the first view is seen whole again


@dataclass
class Shown:
    """A mesh and its nodes.

    Attributes:
        original: The mesh, without faces that cannot be drawn.
        snapshot: The same at the size at which it is shown.
        scale: Size of the one relative to the other.
        left_out: Number of those faces.
        visible: Whether it is shown.
        place: [3], where its origin lies in the scene.
        values: [V, 3] colours of vertices to show in place of its own, or None.
        path: Name of its nodes.
        framed: Its size when the first view was chosen.
    """

    original: Snapshot
    path: str
    snapshot: Snapshot = field(init=False)
    scale: float = 1.0
    left_out: int = 0
    visible: bool = True
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    values: Tensor | None = None
    framed: float = 0.0
    frame: Any = None
    front: Any = None  # node that is visible
    back: Any = None  # node that a browser is decoding
    wire: Any = None
    normals: Any = None
    count: int = 0

    def __post_init__(self) -> None:
        self.snapshot = self.original


class Scene:
    """The meshes of a page.

    Attributes:
        look: How meshes are shown.
        wireframe, normals: Whether edges and vertex normals are drawn.
        side_by_side: Whether meshes stand in a row; otherwise each at its own coordinates.
        equal_size: Whether the others are shown as large as the first.
        meshes: The meshes by name. Only the worker's thread changes them.
    """

    def __init__(self, server: viser.ViserServer, worker: Worker) -> None:
        self._server, self._worker = server, worker
        self._lock = threading.Lock()
        self._coming: dict[str, Snapshot] = {}
        self._stale: set[str] = set()
        self._frames = self._paths = 0
        self._axes = axes_of("+y")
        self.look, self.wireframe, self.normals = Look(), False, False
        self.side_by_side, self.equal_size = True, False
        self.meshes: dict[str, Shown] = {}
        self._first_positions: list[np.ndarray] = []  # the newest is the last
        self.on_change: Callable[[], None] = lambda: None
        """Called in the worker's thread after meshes have changed or moved."""
        self.other_bounds: Callable[[], list[Box]] = list
        """Returns the boxes around what else belongs into the first view."""
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
        server.on_client_connect(self._greet)

    def put(self, name: str, snapshot: Snapshot) -> None:
        """Show a mesh soon, in place of one of the same name. For any thread."""
        with self._lock:
            self._coming[name] = snapshot
        self._worker.post("meshes", self._update)

    def redraw(self, *names: str) -> None:
        """Show these meshes, or all, again soon, after the look has changed. For any thread."""
        with self._lock:
            self._stale.update(names or self.meshes)
        self._worker.post("meshes", self._update)

    def remove(self, names: Iterable[str]) -> None:
        """Take meshes away soon. For any thread."""
        gone = list(names)

        def job() -> None:
            for name in gone:
                shown = self.meshes.pop(name, None)
                if shown is not None and shown.frame is not None:
                    shown.frame.remove()
            self._arrange()
            self.on_change()

        with self._lock:
            for name in gone:
                self._coming.pop(name, None)
        self._worker.post(f"remove {' '.join(gone)}", job)

    def center(self) -> np.ndarray:
        """Return the centre [3] of all visible meshes."""
        return first_view(self._bounds(), self._axes)[1]

    def set_up(self, axis: str) -> None:
        """Choose the axis that is up, such as "+z". For any thread."""
        self._axes = axes_of(axis)
        self._server.scene.set_up_direction(axis)  # type: ignore[arg-type]
        for lamp, (direction, _) in zip(self._lamps, _LAMPS, strict=True):
            lamp.position = tuple(self._axes.T @ direction)
        self.arrange()

    def _first_view(self) -> tuple[np.ndarray, np.ndarray]:
        """Choose the position of a camera, and the point it looks at, so that everything visible is in the picture."""
        return first_view(self._bounds() + self.other_bounds(), self._axes)

    def _bounds(self) -> list[Box]:
        """Return the boxes around the visible meshes, as they are placed."""
        boxes = [(shown.place, *shown.snapshot.bounds()) for shown in list(self.meshes.values()) if shown.visible]
        return [(place + low, place + high) for place, low, high in boxes]

    def _update(self) -> None:
        """Draw what is new or stale."""
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
            self._draw(self.meshes[name])
        if len(self.meshes) != known:
            self._arrange()
            self._set_first_view(move=is_first)
        elif any(self._has_grown(self.meshes[name]) for name in coming):
            self._set_first_view(move=False)
        self._swap()
        if coming:
            self.on_change()

    def _resize(self, new: Iterable[str] = ()) -> None:
        """Choose the sizes at which meshes are shown; draw those again soon whose size changes, except new ones."""
        reference = 0.0
        for name, shown in self.meshes.items():
            extent = _extent(shown.original) if self.equal_size else 0.0
            reference = reference or extent
            scale = reference / extent if extent else 1.0
            if scale == shown.scale and (scale == 1 or name not in new):
                continue
            shown.snapshot = shown.original if scale == 1 else shown.original.scaled(scale)
            shown.scale = scale
            if name not in new:
                self.redraw(name)

    def _draw(self, shown: Shown) -> None:
        """Make the nodes of a mesh. Those that replace visible ones stay invisible until `_swap`."""
        if shown.frame is None:
            shown.frame = self._server.scene.add_frame(shown.path, show_axes=False, position=tuple(shown.place))
        shown.frame.visible = shown.visible
        if not len(shown.snapshot.faces):
            for node in (shown.front, shown.back, shown.wire, shown.normals):
                if node is not None:
                    node.remove()
            shown.front = shown.back = shown.wire = shown.normals = None
            return
        parts = drawables(shown.snapshot, self.look, shown.values)
        if len(parts) == 1 and parts[0].is_plain:
            self._draw_plain(shown, parts[0])
        else:
            self._draw_colored(shown, parts)
        self._draw_lines(shown)

    def _draw_plain(self, shown: Shown, part: Drawable) -> None:
        """Draw a mesh of one colour. Its node changes in place, without a flicker."""
        color: Any = tuple(round(255 * value) for value in part.color)
        flat = not self.look.smooth
        node = shown.front
        if node is not None and hasattr(node, "vertices") and node.flat_shading == flat:
            if not np.array_equal(node.faces, part.faces) or len(node.vertices) != len(part.positions):
                node.faces = part.faces
            node.vertices, node.color = part.positions, color
            return
        shown.count += 1
        shown.back = self._server.scene.add_mesh_simple(
            f"{shown.path}/plain_{shown.count % 2}",
            part.positions,
            part.faces,
            color=color,
            flat_shading=flat,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=shown.front is None,
        )

    def _draw_colored(self, shown: Shown, parts: list[Drawable]) -> None:
        """Draw a mesh with colours or images. A browser shows nothing while it decodes, so the old node stays."""
        shown.count += 1
        data = write_glb(parts)
        shown.back = self._server.scene.add_glb(
            f"{shown.path}/colored_{shown.count % 2}",
            data,
            cast_shadow=False,
            receive_shadow=False,
            visible=shown.front is None,
        )
        self._frames = max(self._frames, len(data))

    def _draw_lines(self, shown: Shown) -> None:
        """Draw the edges and the normals, if they are asked for."""
        snapshot = shown.snapshot
        if not self.wireframe and shown.wire is not None:
            shown.wire.remove()
            shown.wire = None
        if not self.normals and shown.normals is not None:
            shown.normals.remove()
            shown.normals = None
        if not (self.wireframe or self.normals):
            return
        low, high = snapshot.bounds()
        size = float((high - low).max())
        vertices, faces = snapshot.vertices.numpy(), snapshot.faces.numpy()
        normals = vertex_normals(vertices, faces)
        if self.wireframe:
            lifted = vertices + _LIFT * size * normals
            shown.wire = self._server.scene.add_mesh_simple(
                f"{shown.path}/wire", lifted, faces, color=_LINES, wireframe=True, cast_shadow=False
            )
        if self.normals:
            used = np.unique(faces)
            some = used[:: -(-len(used) // _MOST_NORMALS)]
            ends = np.stack((vertices[some], vertices[some] + _NORMAL_LENGTH * size * normals[some]), 1)
            shown.normals = self._server.scene.add_line_segments(
                f"{shown.path}/normals", ends, np.array(_NORMALS), thickness=_THICKNESS * size
            )

    def _swap(self) -> None:
        """Show the new nodes in place of the old ones, once a browser has had the time to decode them."""
        replaced = [shown for shown in self.meshes.values() if shown.back is not None]
        if any(shown.front is not None for shown in replaced) and self._server.get_clients():
            self._server.flush()
            time.sleep(min(_DECODING + self._frames / _DECODED, _MOST_DECODING))
        self._frames = 0
        with self._server.atomic():
            for shown in replaced:
                shown.back.visible = True
                if shown.front is not None:
                    shown.front.remove()
                shown.front, shown.back = shown.back, None

    def _arrange(self) -> None:
        """Put meshes in a row around the first one, on its ground, or each at its own coordinates."""
        meshes = list(self.meshes.values())
        places = [np.zeros(3) for _ in meshes]
        if self.side_by_side and len(meshes) > 1:
            places = places_in_row([shown.snapshot.bounds() for shown in meshes], self._axes)
        for shown, place in zip(meshes, places, strict=True):
            shown.place = place
            if shown.frame is not None:
                shown.frame.position = tuple(place)

    def arrange(self) -> None:
        """Arrange the meshes again soon, and show all of them. For any thread."""

        def job() -> None:
            self._resize()
            self._arrange()
            self._set_first_view()
            self.on_change()

        self._worker.post("arrange", job)

    def show_whole(self, client: viser.ClientHandle) -> None:
        """Move the camera of a browser so that everything is visible. For any thread."""
        position, center = self._first_view()
        with client.atomic():
            client.camera.position, client.camera.look_at = position, center

    def _set_first_view(self, move: bool = True) -> None:
        """Tell browsers that connect later where to look from; ``move`` all that are there, or those still there."""
        position, center = self._first_view()
        radius = float(np.linalg.norm(position - center))
        camera = self._server.initial_camera
        camera.fov, (camera.near, camera.far) = FIELD, clip_distances(radius)
        camera.position, camera.look_at = tuple(position), tuple(center)
        clients = self._server.get_clients().values()
        # Nobody's own choice of a view is changed because another mesh has come.
        moving = [client for client in clients if move or self._is_unmoved(client)]
        self._first_positions = [*self._first_positions[1 - _VIEWS :], position]
        for shown in self.meshes.values():
            shown.framed = _extent(shown.snapshot)
        for client in moving:
            self.show_whole(client)

    def _greet(self, client: viser.ClientHandle) -> None:
        """Show everything to a browser that has loaded an earlier first view, while it connected."""
        newest = self._first_positions[-1]
        if self._is_unmoved(client) and not np.allclose(client.camera.position, newest, rtol=1e-3, atol=1e-6):
            self.show_whole(client)

    def _is_unmoved(self, client: viser.ClientHandle) -> bool:
        """Tell whether the camera of a browser is still at a first view."""
        position = client.camera.position
        return any(
            np.linalg.norm(position - first) < _UNMOVED * np.linalg.norm(position - client.camera.look_at)
            for first in self._first_positions
        )

    def _has_grown(self, shown: Shown) -> bool:
        """Tell whether a mesh has become much larger or smaller since the first view was chosen."""
        extent = _extent(shown.snapshot)
        return not shown.framed / _GROWN <= extent <= shown.framed * _GROWN


def _extent(snapshot: Snapshot) -> float:
    """Return the largest side of the box around all vertices; quicker than `Snapshot.bounds`."""
    axes = np.ascontiguousarray(snapshot.vertices.numpy().T)  # numpy reduces long rows fast
    return float((axes.max(1) - axes.min(1)).max()) if axes.size else 0.0
