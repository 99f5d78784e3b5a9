"""`Page`: what a browser shows, a scene and its panels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from .frusta import Frusta, Photograph
from .panels.display import DisplayPanel
from .panels.pictures import PicturesPanel, StepsPanel
from .panels.renderer import RendererPanel
from .panels.run import Run, RunPanel
from .scene import Scene
from .server import start_server, stop_server
from .worker import Worker


class Page:
    """The page of a viewer: a worker's thread changes it. ``url`` is its address for a browser."""

    def __init__(self, host: str, port: int, title: str, worker: Worker, run: Run) -> None:
        self.server, self.url = start_server(host, port, title)
        self._run = run
        self._run_panel: RunPanel | None = None
        self.scene = Scene(self.server, worker)
        self.display = DisplayPanel(self.server, self.scene, worker)
        self.frusta = Frusta(self.server)
        self.display.faces.seen_in = self.frusta.seen_in
        self.renderer = RendererPanel(self.server, self.scene, worker, self.frusta)
        self._pictures: PicturesPanel | None = None
        self._steps: StepsPanel | None = None
        self.scene.on_change, self.scene.other_bounds = self._follow, self.frusta.bounds

    @property
    def clients(self) -> int:
        """Number of browsers that show the page."""
        return len(self.server.get_clients())

    def show_cameras(self, name: str, taken: list[Photograph]) -> None:
        """Show cameras with their photographs. Runs in the worker's thread."""
        if self.scene.side_by_side or self.scene.equal_size:
            self.display.arrange(side_by_side=False, equal_size=False)  # cameras fit one place only
        self.frusta.show(name, taken, self.scene.center())
        self.scene.arrange()
        self.renderer.update()

    def show_pictures(self, pictures: Mapping[str, Path]) -> None:
        """Offer pictures by name. Runs in the worker's thread."""
        if self._pictures is None:
            self._pictures = PicturesPanel(self.server)
        self._pictures.offer(pictures)

    def show_steps(self, labels: Sequence[str], choose: Callable[[int], None]) -> None:
        """Offer a slider through steps. Runs in the worker's thread."""
        if self._steps is None:
            self._steps = StepsPanel(self.server)
        self._steps.offer(labels, choose)

    def update_run(self) -> None:
        """Show the state of the run. Runs in the worker's thread."""
        if self._run_panel is None:
            self._run_panel = RunPanel(self.server, self._run)
        self._run_panel.update()

    def finish(self, text: str) -> None:
        """Show that the run is over. Runs in the worker's thread."""
        if self._run_panel is not None:
            self._run_panel.finish(text)

    def close(self) -> None:
        """End the page."""
        stop_server(self.server)

    def _follow(self) -> None:
        """List the meshes, and draw them by our renderer if that is switched on."""
        self.display.list_meshes()
        self.display.faces.update()
        self.renderer.update()
