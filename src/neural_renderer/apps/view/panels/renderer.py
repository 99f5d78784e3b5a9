"""The panel of the package's own renderer: a picture from the browser's view, and gradients of a loss."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ....camera import Camera
from ..drawing.our_picture import FREE_LOSSES, IMAGE_LOSSES, Target, View, arrows, draw, heat, loss_gradient, picture
from ..frusta import Frusta
from ..scene import Scene
from ..shown import Shown
from ..worker import Worker

if TYPE_CHECKING:
    import viser

_OUTPUTS = {"colour": "rgb", "silhouette": "alpha", "depth": "depth"}
_HEIGHTS = (128, 256, 384, 512)
_WIDTH = 380  # width of the picture, in pixels of the page
_SHAFT, _HEAD = 0.003, 0.008  # radii of arrows, relative to the size of the mesh
_HEAD_LENGTH = 0.02


class RendererPanel:
    """Controls of our renderer's picture and of gradients. Nothing is computed until one is switched on."""

    def __init__(self, server: viser.ViserServer, scene: Scene, worker: Worker, frusta: Frusta) -> None:
        self._server, self._scene, self._worker, self._frusta = server, scene, worker, frusta
        self._view: View | None = None
        self._arrows: Any = None
        self._colored: str | None = None
        gui = server.gui
        with gui.add_folder("Our renderer"):
            self._on = gui.add_checkbox("Picture", False, hint="Our own renderer's picture from this view")
            self._output = gui.add_dropdown("Output", tuple(_OUTPUTS))
            self._height = gui.add_dropdown("Height", tuple(map(str, _HEIGHTS)), initial_value="256")
            self._gradient = gui.add_checkbox("Gradient", False, hint="Of a loss, on the vertices")
            self._mesh = gui.add_dropdown("Of", ("–",), visible=False)
            self._loss = gui.add_dropdown("Loss", (*FREE_LOSSES, *IMAGE_LOSSES), visible=False)
            self._target = gui.add_dropdown("Target", ("–",), visible=False)
            self._estimator = gui.add_dropdown("By", ("edge", "nmr"), visible=False)
            self._form = gui.add_dropdown("As", ("arrows", "colours"), visible=False)
            self._text = gui.add_markdown("", visible=False)
        self._panel = gui.add_panel(visible=False)
        with self._panel.add_tab("Our renderer"):
            self._image = gui.add_image(np.full((1, 1, 3), 255, np.uint8), format="png")
        self._panel.dock_left()  # next to the scene, which it does not cover
        self._panel.set_width(_WIDTH)
        controls = (self._on, self._output, self._height, self._gradient, self._mesh, self._loss, self._target)
        for control in (*controls, self._estimator, self._form):
            control.on_update(lambda _: self.update())
        server.on_client_connect(self._follow)

    def update(self) -> None:
        """Draw again soon, if anything is switched on. Any thread may call it."""
        self._worker.post("our picture", self._draw)

    def _follow(self, client: viser.ClientHandle) -> None:
        """Follow the camera of a browser, from where it is now: it may never move."""
        client.camera.on_update(self._move)
        self._move(client.camera)

    def _move(self, camera: viser.CameraHandle) -> None:
        """Follow the browser that moved last."""
        try:
            view = View(camera.wxyz, camera.position, camera.fov, camera.aspect)
        except ZeroDivisionError:  # a window without pixels
            return
        if not view.is_usable:
            return
        self._view = view
        if self._on.value or (self._gradient.value and self._loss.value not in FREE_LOSSES[2:]):
            self.update()

    def _pixels(self) -> int:
        """Return the height of the picture; messages may have heights that the list lacks."""
        return next((height for height in _HEIGHTS if str(height) == self._height.value), _HEIGHTS[0])

    def _draw(self) -> None:
        self._panel.visible = self._on.value
        self._list_choices()
        if self._view is None or not self._scene.meshes:
            return
        if self._on.value:
            shown = [one for one in self._scene.meshes.values() if one.visible and len(one.snapshot.faces)]
            placed, height = [(one.snapshot, one.place) for one in shown], self._pixels()
            output, lit = _OUTPUTS[self._output.value], self._scene.look.lit
            self._image.image = picture(placed, self._view, height, output=output, lit=lit)
        self._draw_gradient(self._view)

    def _list_choices(self) -> None:
        asked, compares = self._gradient.value, self._loss.value in IMAGE_LOSSES
        for control in (self._mesh, self._loss, self._form, self._text):
            control.visible = asked
        self._target.visible = asked and compares
        self._estimator.visible = asked and self._loss.value not in FREE_LOSSES[2:]
        names = tuple(self._scene.meshes)
        if names and self._mesh.options != names:
            self._mesh.options = names
        others = tuple(name for name in names if name != self._mesh.value)
        others = (*others, *(name for name, one in self._frusta.photographs.items() if one.size)) or ("–",)
        if self._target.options != others:
            self._target.options = others

    def _draw_gradient(self, view: View) -> None:
        """Compute the gradient, and show it; or take it away."""
        shown = self._scene.meshes.get(self._mesh.value) if self._gradient.value else None
        if shown is not None and not len(shown.snapshot.faces):
            shown = None
        as_colors = self._form.value == "colours"
        if self._arrows is not None and (shown is None or as_colors):
            self._arrows.remove()
            self._arrows = None
        if self._colored is not None and (shown is None or not as_colors or self._colored != self._mesh.value):
            before = self._scene.meshes.get(self._colored)
            if before is not None:
                before.values = None
                self._scene.redraw(self._colored)
            self._colored = None
        if shown is None:
            return
        scenery = self._scenery(view, shown)
        if scenery is None:
            self._text.content = "*Compared with another mesh from this view, or with a photograph: show one.*"
            return
        camera, size, target, lit = scenery
        value, found = loss_gradient(
            shown.snapshot, camera, size, self._loss.value, target=target, gradient=self._estimator.value, lit=lit
        )
        norms = found.norm(dim=1)
        most = float(norms.max())
        moving = f"{int((norms > 0).sum()):,} of {len(norms):,} vertices have one"
        self._text.content = f"loss **{value:.4g}**, largest gradient {most:.3g}  \n{moving}"
        if as_colors:
            self._colored = self._mesh.value
            shown.values = heat(norms / max(most, 1e-30))
            self._scene.redraw(self._colored)
        else:
            self._show_arrows(shown, found)

    def _scenery(self, view: View, shown: Shown) -> tuple[Camera, tuple[int, int], Target | None, bool] | None:
        """Choose camera, size, target and light of a loss; None without the target that it needs."""
        lit, camera, size = self._scene.look.lit, view.camera(shown.place), view.size(self._pixels())
        if self._loss.value not in IMAGE_LOSSES:
            return camera, size, None, lit
        photograph = self._frusta.photographs.get(self._target.value)
        if photograph is not None and photograph.size is not None:
            masks = photograph.masks
            if masks is None:
                masks = torch.ones(1, *photograph.size)
            return photograph.camera, photograph.size, Target(masks, photograph.photos), False
        other = self._scene.meshes.get(self._target.value)
        if other is None or other is shown or not len(other.snapshot.faces):
            return None
        # Both meshes are compared in their own coordinates, as a loss does, even where they stand side by side.
        images = draw(other.snapshot, camera, size, lit=lit)
        return camera, size, Target(images.alpha, images.rgb), lit

    def _show_arrows(self, shown: Shown, gradient: Any) -> None:
        """Show the negative gradient of each vertex."""
        points, colors = arrows(shown.snapshot, gradient)
        if self._arrows is not None:
            self._arrows.remove()
            self._arrows = None
        if not len(points):
            return
        low, high = shown.snapshot.bounds()
        size = float((high - low).max())
        self._arrows = self._server.scene.add_arrows(
            "/gradient",
            points,
            colors,
            shaft_radius=_SHAFT * size,
            head_radius=_HEAD * size,
            head_length=_HEAD_LENGTH * size,
            position=tuple(shown.place),
        )
