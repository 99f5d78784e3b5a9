"""Panels of what a program has written: pictures, and a slider through steps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....io import load_image
from ..frusta import thumbnail

if TYPE_CHECKING:
    import viser

_WIDTH = 320  # width of the panel of pictures, in pixels of the page
_LARGEST = 1200  # longer side of a picture


class PicturesPanel:
    """A panel with one of several pictures, at the left of the scene: it hides nothing."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._files: dict[str, Path] = {}
        panel = server.gui.add_panel()
        with panel.add_tab("Pictures"):
            self._choice: Any = server.gui.add_dropdown("File", ("–",))
            self._image: Any = server.gui.add_image(np.full((1, 1, 3), 255, np.uint8))
        panel.dock_left()
        panel.set_width(_WIDTH)
        self._choice.on_update(self._show)

    def offer(self, pictures: Mapping[str, Path]) -> None:
        """Offer these pictures in place of the others."""
        if not pictures:
            return
        self._files = dict(pictures)
        self._choice.options = tuple(pictures)
        self._show(None)

    def _show(self, _: Any) -> None:
        path = self._files.get(self._choice.value)
        if path is not None:
            self._image.image = thumbnail(load_image(path)[..., :3].movedim(2, 0), _LARGEST)


class StepsPanel:
    """A slider through steps."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._slider: Any = None

    def offer(self, labels: Sequence[str], choose: Callable[[int], None]) -> None:
        """Offer these steps, the last one chosen."""
        if self._slider is not None:
            self._folder.remove()
        last = len(labels) - 1
        self._folder: Any = self._server.gui.add_folder("Steps", order=-1)
        with self._folder:
            label: Any = self._server.gui.add_markdown(labels[-1])
            self._slider = self._server.gui.add_slider(
                "Frame", 0, max(last, 1), 1, last, disabled=not last, hint="Steps that were saved"
            )

        def move(_: Any) -> None:
            number = min(int(self._slider.value), last)
            label.content = labels[number]
            choose(number)

        self._slider.on_update(move)
