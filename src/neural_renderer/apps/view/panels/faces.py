"""Indices of faces: labels on meshes with few faces, and the index of a clicked face."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..scene import Scene
from ..shown import Shown
from ..worker import Worker

if TYPE_CHECKING:
    import viser

_MOST_LABELS = 300
_PARALLEL = 1e-12  # determinant below which a ray counts as parallel to a face


class FacesPanel:
    """A box that turns the numbers on, and a line that says what was clicked."""

    def __init__(self, server: viser.ViserServer, scene: Scene, worker: Worker) -> None:
        self._server, self._scene, self._worker = server, scene, worker
        self._labels: list[Any] = []
        hint = "Click a face to see its number and its vertices"
        self._box: Any = server.gui.add_checkbox("Face indices", False, hint=hint)
        self._text = server.gui.add_markdown("", visible=False)
        self._box.on_update(self._toggle)
        self._clicked: Any = None
        self.seen_in: Callable[[np.ndarray], str] = lambda point: ""
        """Says which photograph shows a point [3], and where."""

    def update(self) -> None:
        """Label the faces of small meshes, if that is switched on. Runs in the worker's thread."""
        for label in self._labels:
            label.remove()
        self._labels = []
        shown = [one for one in self._scene.meshes.values() if one.visible]
        if not self._box.value or sum(len(one.snapshot.faces) for one in shown) > _MOST_LABELS:
            return
        for one in shown:
            vertices, faces = one.snapshot.vertices.numpy(), one.snapshot.faces.numpy()
            for number, middle in enumerate(vertices[faces].mean(1) + one.place):
                self._label(str(number), middle)

    def _toggle(self, _: Any) -> None:
        """Listen to clicks, or stop."""
        self._text.visible = self._box.value
        self._text.content = "*Click a face.*"
        if self._box.value:
            self._clicked = self._server.scene.on_click()(self._click)
        elif self._clicked is not None:
            self._server.scene.remove_click_callback(self._click)
            self._clicked = None
        self._worker.post("faces", self.update)

    def _click(self, event: Any) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        self._worker.post("click", lambda: self._show(origin, direction))

    def _show(self, origin: np.ndarray, direction: np.ndarray) -> None:
        best: tuple[float, str, int, Shown] | None = None
        for name, one in self._scene.meshes.items():
            if one.visible and len(one.snapshot.faces):
                number, distance = first_face(
                    one.snapshot.vertices.numpy(), one.snapshot.faces.numpy(), origin - one.place, direction
                )
                if number >= 0 and (best is None or distance < best[0]):
                    best = distance, name, number, one
        self.update()
        if best is None:
            self._text.content = "*No face there.*"
            return
        distance, name, number, one = best
        vertices = ", ".join(str(value) for value in one.snapshot.faces[number].tolist())
        photograph = self.seen_in(origin + distance * direction - one.place)
        self._text.content = f"**{name}: face {number}**, vertices {vertices}{photograph}"
        self._label(f"face {number}", origin + distance * direction)

    def _label(self, text: str, place: np.ndarray) -> None:
        label = self._server.scene.add_label(
            f"/faces/{len(self._labels)}", text, position=place, anchor="bottom-center", font_screen_scale=0.8
        )
        self._labels.append(label)


def first_face(vertices: np.ndarray, faces: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[int, float]:
    """Find the first face that a ray meets: its number, −1 if there is none, and its distance.

    The distance is in lengths of the direction, which has any. Origin and direction are [3].
    """
    corner = vertices[faces[:, 0]].astype(float)
    first, second = vertices[faces[:, 1]] - corner, vertices[faces[:, 2]] - corner
    across = np.cross(direction, second)
    determinant = (first * across).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / np.where(np.abs(determinant) < _PARALLEL, np.nan, determinant)
        offset = origin - corner
        u = (offset * across).sum(1) * inverse
        other = np.cross(offset, first)
        v = (other @ direction) * inverse
        distance = (second * other).sum(1) * inverse
        meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    if not meets.any():
        return -1, float("inf")
    number = int(np.where(meets, distance, np.inf).argmin())
    return number, float(distance[number])
