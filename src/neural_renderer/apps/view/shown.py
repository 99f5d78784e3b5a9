"""`Shown`: a mesh of a page and its nodes of viser."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from torch import Tensor

from .drawing.glb import Drawable, write_glb
from .drawing.snapshot import Snapshot
from .drawing.surface import Look, drawables, vertex_normals

if TYPE_CHECKING:
    import viser

_LINES = (30, 40, 55)  # RGB of the wireframe
_NORMALS = (200, 60, 130)  # RGB of normals
_LIFT = 5e-4  # distance of the wireframe from its faces, relative to the size of the mesh
_NORMAL_LENGTH, _THICKNESS = 0.04, 0.0015  # relative to the size of the mesh
_MOST_NORMALS = 4000  # most normals drawn


@dataclass
class Shown:
    """A mesh and its nodes."""

    original: Snapshot  # the mesh without faces that cannot be drawn
    path: str  # name of the nodes
    snapshot: Snapshot = field(init=False)  # the mesh in its shown size
    scale: float = 1.0  # size of ``snapshot`` relative to ``original``
    left_out: int = 0  # number of faces that cannot be drawn
    visible: bool = True
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))  # origin of the mesh in the scene
    values: Tensor | None = None  # colours [V, 3] to show in place of the mesh's own
    framed: float = 0.0  # size of the mesh when the first view was chosen
    coming: int = 0  # bytes that a browser has to decode before `swap`
    frame: Any = None
    front: Any = None  # node that is visible
    back: Any = None  # node that a browser is decoding
    wire: Any = None
    normals: Any = None
    count: int = 0

    def __post_init__(self) -> None:
        self.snapshot = self.original

    def resize(self, scale: float) -> None:
        """Choose the size at which the mesh is shown."""
        self.snapshot = self.original if scale == 1 else self.original.scaled(scale)
        self.scale = scale

    def place_at(self, place: np.ndarray) -> None:
        """Choose where the origin of the mesh lies in the scene, [3]."""
        self.place = place
        if self.frame is not None:
            self.frame.position = tuple(place)

    def draw(self, server: viser.ViserServer, look: Look, wireframe: bool, normals: bool) -> None:
        """Make the nodes; nodes that replace visible ones stay invisible until `swap`."""
        if self.frame is None:
            self.frame = server.scene.add_frame(self.path, show_axes=False, position=tuple(self.place))
        self.frame.visible = self.visible
        if not len(self.snapshot.faces):
            for node in (self.front, self.back, self.wire, self.normals):
                if node is not None:
                    node.remove()
            self.front = self.back = self.wire = self.normals = None
            return
        parts = drawables(self.snapshot, look, self.values)
        if len(parts) == 1 and parts[0].is_plain:
            self._draw_plain(server, parts[0], look)
        else:
            self._draw_colored(server, parts)
        self._draw_lines(server, wireframe, normals)

    def _draw_plain(self, server: viser.ViserServer, part: Drawable, look: Look) -> None:
        """Draw a mesh of one colour. Its node changes in place, without a flicker."""
        color: Any = tuple(round(255 * value) for value in part.color)
        flat = not look.smooth
        node = self.front
        if node is not None and hasattr(node, "vertices") and node.flat_shading == flat:
            with server.atomic():
                if not np.array_equal(node.faces, part.faces) or len(node.vertices) != len(part.positions):
                    node.faces = part.faces
                node.vertices = part.positions
                if tuple(node.color) != color:
                    node.color = color
            return
        self.count += 1
        self.back = server.scene.add_mesh_simple(
            f"{self.path}/plain_{self.count % 2}",
            part.positions,
            part.faces,
            color=color,
            flat_shading=flat,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=self.front is None,
        )

    def _draw_colored(self, server: viser.ViserServer, parts: list[Drawable]) -> None:
        """Draw a mesh with colours or images. A browser shows nothing while it decodes, so the old node stays."""
        self.count += 1
        data = write_glb(parts)
        self.back = server.scene.add_glb(
            f"{self.path}/colored_{self.count % 2}",
            data,
            cast_shadow=False,
            receive_shadow=False,
            visible=self.front is None,
        )
        self.coming = len(data)

    def _draw_lines(self, server: viser.ViserServer, wireframe: bool, normals: bool) -> None:
        snapshot = self.snapshot
        if not wireframe and self.wire is not None:
            self.wire.remove()
            self.wire = None
        if not normals and self.normals is not None:
            self.normals.remove()
            self.normals = None
        if not (wireframe or normals):
            return
        low, high = snapshot.bounds()
        size = float((high - low).max())
        vertices, faces = snapshot.vertices.numpy(), snapshot.faces.numpy()
        directions = vertex_normals(vertices, faces)
        if wireframe:
            lifted = vertices + _LIFT * size * directions
            self.wire = server.scene.add_mesh_simple(
                f"{self.path}/wire", lifted, faces, color=_LINES, wireframe=True, cast_shadow=False
            )
        if normals:
            used = np.unique(faces)
            some = used[:: -(-len(used) // _MOST_NORMALS)]
            ends = np.stack((vertices[some], vertices[some] + _NORMAL_LENGTH * size * directions[some]), 1)
            self.normals = server.scene.add_line_segments(
                f"{self.path}/normals", ends, np.array(_NORMALS), thickness=_THICKNESS * size
            )

    def swap(self) -> None:
        """Show the new node in place of the old one."""
        self.back.visible = True
        if self.front is not None:
            self.front.remove()
        self.front, self.back, self.coming = self.back, None, 0


def extent_of(snapshot: Snapshot) -> float:
    """Return the largest side of the box around all vertices; quicker than `Snapshot.bounds`."""
    axes = np.ascontiguousarray(snapshot.vertices.numpy().T)  # numpy reduces long rows fast
    return float((axes.max(1) - axes.min(1)).max()) if axes.size else 0.0
