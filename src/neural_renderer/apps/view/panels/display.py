"""The part of the page's panel that says how meshes are shown."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from ..drawing.surface import SURFACES
from ..layout import Up
from ..scene import Scene
from ..worker import Worker
from .faces import FacesPanel

if TYPE_CHECKING:
    import viser

_BACKGROUND = (236, 238, 242)  # RGB
_UP = {"+y": "+y", "−y": "-y", "+z": "+z", "−z": "-z", "+x": "+x", "−x": "-x"}
_OWN_UP = "of the cameras"  # choice of a direction that is no axis
_MOST_PIXELS = 4096  # longest side of a saved picture
_RENDERING = 30.0  # seconds that a browser may take for a picture


class DisplayPanel:
    """Controls of the surface, the lines, the arrangement, the background and the pictures to save."""

    def __init__(self, server: viser.ViserServer, scene: Scene, worker: Worker) -> None:
        self._server, self._scene, self._worker = server, scene, worker
        self._boxes: dict[str, Any] = {}
        self._ups: dict[str, Up] = dict(_UP)
        gui = server.gui
        with gui.add_folder("Display"):
            surface = gui.add_dropdown("Surface", SURFACES)
            light = gui.add_checkbox("Light", True)
            smooth = gui.add_checkbox("Smooth", True, hint="Interpolate the light over faces that share vertices")
            wireframe = gui.add_checkbox("Wireframe", False)
            normals = gui.add_checkbox("Normals", False)
            self.faces = FacesPanel(server, scene, worker)
            self._row: Any = gui.add_checkbox("Side by side", scene.side_by_side)
            self._equal: Any = gui.add_checkbox("Equal size", scene.equal_size, hint="Show all as large as the first")
            up: Any = gui.add_dropdown("Up", tuple(_UP))
            background = gui.add_rgb("Background", _BACKGROUND)
            whole: Any = gui.add_button("Whole view")
            save = gui.add_button("Save picture", hint="Of the browser's view, as a PNG")
        self._meshes = gui.add_folder("Meshes")
        with self._meshes:
            self._info = gui.add_markdown("*No mesh yet.*")

        def look(_: Any) -> None:
            scene.look = replace(scene.look, surface=surface.value, lit=light.value, smooth=smooth.value)
            scene.wireframe, scene.normals = wireframe.value, normals.value
            scene.redraw()

        for control in (surface, light, smooth, wireframe, normals):
            control.on_update(look)

        def arrange(_: Any) -> None:
            scene.side_by_side, scene.equal_size = self._row.value, self._equal.value
            scene.arrange()

        self._row.on_update(arrange)
        self._equal.on_update(arrange)
        up.on_update(lambda _: scene.set_up(self._ups[up.value]))
        background.on_update(lambda _: self._set_background(background.value))
        whole.on_click(lambda event: scene.show_whole(event.client))
        save.on_click(self._save_picture)
        self._set_background(_BACKGROUND)
        self._up = up

    def set_up(self, up: Up) -> None:
        """Choose what is up: an axis, or a direction, which the list then offers, too."""
        if not isinstance(up, str):
            self._ups[_OWN_UP] = up
            self._up.options = tuple(self._ups)
        self._up.value = next(name for name, value in self._ups.items() if value == up)
        self._scene.set_up(up)

    def arrange(self, side_by_side: bool, equal_size: bool) -> None:
        """Arrange meshes in a row or at their coordinates, scaled to the size of the first or unscaled."""
        self._row.value = self._scene.side_by_side = side_by_side
        self._equal.value = self._scene.equal_size = equal_size
        self._scene.arrange()

    def list_meshes(self) -> None:
        """List the meshes, each with a box to hide it. Called in the worker's thread when meshes change."""
        lines = []
        for name, shown in self._scene.meshes.items():
            snapshot = shown.snapshot
            lines.append(f"{_plain(name)}: {len(snapshot.vertices):,} vertices, {len(snapshot.faces):,} faces")
            if shown.left_out:
                lines[-1] += f", and {shown.left_out:,} left out because a vertex is not finite"
            if shown.scale != 1:
                lines[-1] += f", shown {shown.scale:.3g} times as large"
        text = "  \n".join(lines) or "*No mesh yet.*"
        if self._info.content != text:
            self._info.content = text
        wanted = list(self._scene.meshes) if len(self._scene.meshes) > 1 else []
        for name in set(self._boxes) - set(wanted):
            self._boxes.pop(name).remove()
        for name in wanted:
            if name not in self._boxes:
                self._boxes[name] = self._add_box(name)

    def _add_box(self, name: str) -> Any:
        with self._meshes:
            box = self._server.gui.add_checkbox(f"{name}", True)

        def hide(_: Any) -> None:
            shown = self._scene.meshes.get(name)
            if shown is not None:
                shown.visible = box.value
                if shown.frame is not None:
                    shown.frame.visible = box.value

        box.on_update(hide)
        return box

    def _save_picture(self, event: Any) -> None:
        """Send the browser whose button was pressed the picture that it shows, as a file to keep."""
        camera = event.client.camera
        height, width = (max(min(side, _MOST_PIXELS), 1) for side in (camera.image_height, camera.image_width))
        pixels = event.client.get_render(height, width, transport_format="png", timeout=_RENDERING)
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "PNG")
        event.client.send_file_download("neural-renderer.png", file.getvalue(), save_immediately=True)

    def _set_background(self, color: tuple[int, int, int]) -> None:
        self._server.scene.set_background_image(np.full((1, 1, 3), color, np.uint8), format="png")


def _plain(name: str) -> str:
    """Keep Markdown from reading anything into a name."""
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", name)
