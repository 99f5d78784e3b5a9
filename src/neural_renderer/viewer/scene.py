"""`Scene`: the meshes of a page, as nodes of viser."""

from __future__ import annotations

import re
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
from .worker import Worker

if TYPE_CHECKING:
    import viser

_LINES = (30, 40, 55)  # RGB of the wireframe
_NORMALS = (200, 60, 130)  # RGB of normals
_LIFT = 5e-4  # distance of the wireframe from its faces, relative to the size of the mesh
_NORMAL_LENGTH, _THICKNESS = 0.04, 0.0015  # relative to the size of the mesh
_MOST_NORMALS = 4000  # drawn
_GAP = 0.25  # between meshes side by side, relative to the width of the widest
_DECODING, _DECODED = 0.1, 2e7  # a browser shows a mesh after so many seconds, and one more for so many bytes
_MOST_DECODING = 2.0  # seconds
_AMBIENT = 1.1  # intensities: π shows a white surface that faces a lamp as white
_LAMPS = (((-0.5, 0.8, 0.7), 1.8), ((0.7, -0.2, 0.3), 0.5), ((0.2, 0.3, -1.0), 0.8))
_VIEW = np.array([-0.45, 0.35, 1.0])  # direction of the first view
_FIELD, _ASPECT = 0.7, 1.2  # vertical field of view in radians, and width over height, at least, of the first view
_UNMOVED = 0.02  # a camera that is nearer to its first place, relative to its distance, was not moved
_MARGIN = 1.1  # of its distance, relative to the least one that shows everything


@dataclass
class Shown:
    """A mesh and its nodes.

    Attributes:
        snapshot: The mesh, without faces that cannot be drawn.
        left_out: Number of those faces.
        visible: Whether it is shown.
        place: [3], where its origin lies in the scene.
        values: [V, 3] colours of vertices to show in place of its own, or None.
    """

    snapshot: Snapshot
    left_out: int = 0
    visible: bool = True
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    values: Tensor | None = None
    frame: Any = None
    front: Any = None  # node that is visible
    back: Any = None  # node that a browser is decoding
    wire: Any = None
    normals: Any = None
    count: int = 0


class Scene:
    """The meshes of a page.

    Attributes:
        look: How meshes are shown.
        wireframe, normals: Whether edges and vertex normals are drawn.
        side_by_side: Whether meshes stand in a row; otherwise each at its own coordinates.
        meshes: The meshes by name. Only the worker's thread changes them.
    """

    def __init__(self, server: viser.ViserServer, worker: Worker) -> None:
        self._server, self._worker = server, worker
        self._lock = threading.Lock()
        self._coming: dict[str, Snapshot] = {}
        self._stale: set[str] = set()
        self._frames = 0
        self.look, self.wireframe, self.normals, self.side_by_side = Look(), False, False, True
        self.meshes: dict[str, Shown] = {}
        self._first_position = np.zeros(3)
        self.on_change: Callable[[], None] = lambda: None
        """Called in the worker's thread after meshes have changed or moved."""
        server.scene.set_up_direction("+y")
        server.scene.configure_default_lights(False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_ambient("/lights/ambient", intensity=_AMBIENT)
        for number, (direction, intensity) in enumerate(_LAMPS):
            # A lamp shines from its place to the origin.
            server.scene.add_light_directional(
                f"/lights/lamp_{number}", intensity=intensity, position=direction, cast_shadow=False
            )

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
        return self.first_view()[1]

    def first_view(self) -> tuple[np.ndarray, np.ndarray]:
        """Choose the position of a camera, and the point it looks at, so that everything visible is in the picture."""
        boxes = [(shown.place, *shown.snapshot.bounds()) for shown in list(self.meshes.values()) if shown.visible]
        if not boxes:
            return _VIEW, np.zeros(3)
        low = np.min([place + one for place, one, _ in boxes], 0)
        high = np.max([place + one for place, _, one in boxes], 0)
        corners = np.stack(np.meshgrid(*np.stack((low, high), 1)), -1).reshape(-1, 3) - (low + high) / 2
        backward = _VIEW / np.linalg.norm(_VIEW)
        right = np.cross((0.0, 1.0, 0.0), backward)
        right /= np.linalg.norm(right)
        height, width = np.abs(corners @ np.cross(backward, right)), np.abs(corners @ right)
        needed = np.maximum(height, width / _ASPECT) / np.tan(_FIELD / 2) + corners @ backward
        distance = _MARGIN * max(float(needed.max()), 1e-6)
        return (low + high) / 2 + distance * backward, (low + high) / 2

    def _update(self) -> None:
        """Draw what is new or stale."""
        with self._lock:
            coming, self._coming = self._coming, {}
            stale, self._stale = self._stale | set(coming), set()
        is_first = not self.meshes
        known = len(self.meshes)
        for name, snapshot in coming.items():
            usable, left_out = snapshot.finite()
            shown = self.meshes.setdefault(name, Shown(usable))
            if shown.values is not None and len(shown.values) != len(usable.vertices):
                shown.values = None
            shown.snapshot, shown.left_out = usable, left_out
        for name in stale & set(self.meshes):
            self._draw(name, self.meshes[name])
        if len(self.meshes) != known:
            self._arrange()
            self._set_first_view(move=is_first)
        self._swap()
        if coming:
            self.on_change()

    def _draw(self, name: str, shown: Shown) -> None:
        """Make the nodes of a mesh. Those that replace visible ones stay invisible until `_swap`."""
        path = f"/meshes/{re.sub(r'[^0-9A-Za-z_.-]', '_', name)}"
        if shown.frame is None:
            shown.frame = self._server.scene.add_frame(path, show_axes=False, position=tuple(shown.place))
        shown.frame.visible = shown.visible
        if not len(shown.snapshot.faces):
            for node in (shown.front, shown.back, shown.wire, shown.normals):
                if node is not None:
                    node.remove()
            shown.front = shown.back = shown.wire = shown.normals = None
            return
        parts = drawables(shown.snapshot, self.look, shown.values)
        if len(parts) == 1 and parts[0].is_plain:
            self._draw_plain(path, shown, parts[0])
        else:
            self._draw_colored(path, shown, parts)
        self._draw_lines(path, shown)

    def _draw_plain(self, path: str, shown: Shown, part: Drawable) -> None:
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
            f"{path}/plain_{shown.count % 2}",
            part.positions,
            part.faces,
            color=color,
            flat_shading=flat,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=shown.front is None,
        )

    def _draw_colored(self, path: str, shown: Shown, parts: list[Drawable]) -> None:
        """Draw a mesh with colours or images. A browser shows nothing while it decodes, so the old node stays."""
        shown.count += 1
        data = write_glb(parts)
        shown.back = self._server.scene.add_glb(
            f"{path}/colored_{shown.count % 2}",
            data,
            cast_shadow=False,
            receive_shadow=False,
            visible=shown.front is None,
        )
        self._frames = max(self._frames, len(data))

    def _draw_lines(self, path: str, shown: Shown) -> None:
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
                f"{path}/wire", lifted, faces, color=_LINES, wireframe=True, cast_shadow=False
            )
        if self.normals:
            used = np.unique(faces)
            some = used[:: -(-len(used) // _MOST_NORMALS)]
            ends = np.stack((vertices[some], vertices[some] + _NORMAL_LENGTH * size * normals[some]), 1)
            shown.normals = self._server.scene.add_line_segments(
                f"{path}/normals", ends, np.array(_NORMALS), thickness=_THICKNESS * size
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
        boxes = [shown.snapshot.bounds() for shown in self.meshes.values()]
        widths = [float(high[0] - low[0]) for low, high in boxes]
        gap = _GAP * max(widths, default=0.0)
        left = -(sum(widths) + gap * (len(widths) - 1)) / 2
        start_low, start_high = boxes[0] if boxes else (np.zeros(3), np.zeros(3))
        middle_x, _, middle_z = (start_low + start_high) / 2
        left += middle_x
        for shown, (low, high), width in zip(self.meshes.values(), boxes, widths, strict=True):
            shown.place = np.zeros(3)
            if self.side_by_side and len(boxes) > 1:
                middle = (low + high) / 2
                shown.place = np.array([left + width / 2 - middle[0], start_low[1] - low[1], middle_z - middle[2]])
                left += width + gap
            if shown.frame is not None:
                shown.frame.position = tuple(shown.place)

    def arrange(self) -> None:
        """Arrange the meshes again soon, and show all of them. For any thread."""

        def job() -> None:
            self._arrange()
            self._set_first_view()
            self.on_change()

        self._worker.post("arrange", job)

    def show_whole(self, client: viser.ClientHandle) -> None:
        """Move the camera of a browser so that everything is visible. For any thread."""
        position, center = self.first_view()
        with client.atomic():
            client.camera.position, client.camera.look_at = position, center

    def _set_first_view(self, move: bool = True) -> None:
        """Tell browsers that connect later where to look from; ``move`` all that are there, or those still there."""
        position, center = self.first_view()
        radius = float(np.linalg.norm(position - center))
        camera = self._server.initial_camera
        camera.fov, camera.near, camera.far = _FIELD, radius * 1e-3, radius * 1e2
        camera.position, camera.look_at = tuple(position), tuple(center)
        for client in self._server.get_clients().values():
            # Nobody's own choice of a view is changed because another mesh has come.
            if move or np.linalg.norm(client.camera.position - self._first_position) < _UNMOVED * radius:
                self.show_whole(client)
        self._first_position = position
