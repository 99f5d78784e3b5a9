"""`Viewer`, which `view` opens: meshes in the browser while a program changes them, and a record of them."""

from __future__ import annotations

import atexit
import math
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import TracebackType
from typing import TYPE_CHECKING, Any

from ...base import validate
from ...camera import Camera
from ...io.files import existing
from ..common.observer import Knob, Observer, goes_on
from ..common.options import WatchOptions
from .drawing.snapshot import Snapshot
from .frusta import photographs
from .layout import Up
from .newest import Newest
from .panels.run import Run
from .records.recorder import Recorder
from .worker import Worker

if TYPE_CHECKING:
    from .page import Page

UP = ("+x", "-x", "+y", "-y", "+z", "-z")
_WORKER_SHARE = 0.02  # share of one core that the worker may use during a run (mesh copies excluded)
_FLUSH = 20.0  # seconds that the end waits for the newest mesh
_POLL = 0.1  # seconds
_RATE = 10.0  # updates a second
_TITLE = "neural-renderer"


class Viewer(Observer):
    """Shows meshes in the browser while a program changes them. `view` makes one.

    The program never waits for a browser. A mesh is copied at some of the calls only, so that copies take at most 1 %
    of the time; another thread does the rest in at most 2 % of one core, and only the newest mesh counts. All methods
    may be called from any thread.

    Args:
        host, port, rate, record, record_limit, browser, title: As in `view`.

    Attributes:
        url: Address of the page, or None without one.

    Raises:
        TypeError, ValueError, ModuleNotFoundError, OSError: As `view`.

    Example:
        >>> viewer = nr.view(browser=False, record="run.html")
        >>> rate = viewer.knob("rate", 0.1, most=1.0)
        >>> for step in range(3):
        ...     if viewer.proceed():
        ...         viewer.show(mesh, name="sphere")
        ...         viewer.log(step, loss=1 / (step + rate()))
        >>> viewer.show_cameras(camera)
        >>> viewer.set_up("+z")
        >>> viewer.arrange(equal_size=True)
        >>> viewer.show_curves({"IoU": [(1, 0.5), (2, 0.7)]})
        >>> viewer.show_steps(["first", "last"], choose=print)
        >>> nr.save_image("plan.png", torch.rand(8, 8, 3))
        >>> viewer.show_pictures({"plan": "plan.png"})
        >>> viewer.observe("fit", 1, 100, {"loss": 0.5}, lambda: mesh)  # what tasks call
        >>> viewer.offer([])
        >>> viewer.changes()
        {}
        >>> viewer.finish("done")
        >>> viewer.wait(for_browser=True)  # nobody looks
        >>> viewer.flush()
        >>> sentence = viewer.save_record("now.html")
        >>> viewer.remove("sphere")
        >>> sentence = viewer.close()
    """

    url: str | None

    def __init__(
        self,
        *,
        host: str = WatchOptions.host,
        port: int = WatchOptions.port,
        rate: float = _RATE,
        record: str | os.PathLike[str] | None = None,
        record_limit: float = WatchOptions.record_limit,
        browser: bool = True,
        title: str = _TITLE,
    ) -> None:
        if not isinstance(host, str):
            raise TypeError(f"host: expected a name or an address, got {type(host).__name__}")
        if validate.whole("port", port, 0) > 65535:
            raise ValueError(f"port: expected at most 65535, got {port}")
        rate = validate.positive("rate", rate)
        if validate.positive("record_limit", record_limit) < 1:
            raise ValueError(f"record_limit: expected at least 1 MiB, got {record_limit}")
        browser = validate.flag("browser", browser)
        self._recorder = None if record is None else Recorder(record, record_limit)
        self._run = Run()
        self._lock = threading.RLock()
        self._is_closed = False
        self._worker = Worker(rate)
        self._newest = Newest(rate, self._put, self._is_watched, self._postpone)
        self._page: Page | None = None
        self.url = None
        if browser:
            self._open_page(host, port, title)
        atexit.register(self.close)  # a program that ends writes its record

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def paused(self) -> bool:
        """Whether somebody has pressed "Pause"."""
        return self._run.paused

    @property
    def stopped(self) -> bool:
        """Whether somebody has pressed "Stop and keep"."""
        return self._run.stopped

    @property
    def clients(self) -> int:
        """Number of browsers that show the page."""
        return 0 if self._page is None else self._page.clients

    def show(self, mesh: Any, name: str = "mesh") -> None:
        """Show a mesh, in place of the one of the same name.

        The mesh is copied immediately, or, shortly after another copy, a moment later unless a newer one arrives.

        Args:
            mesh: A `Mesh`, a `UVMesh`, or (vertices, faces) or (vertices, faces, textures) as in `render`; one mesh, on
                any device. Vertices that are not finite are left out, with their faces.
            name: Name of the mesh.

        Raises:
            TypeError, ValueError: The mesh is none of these, or the name is empty.
            RuntimeError: The viewer is closed.
        """
        self._check_open()
        if not isinstance(name, str) or not name:
            raise ValueError(f"name: expected some text, got {name!r}")
        if name in self._newest:
            self._spare()
        self._newest.show(mesh, name)

    def remove(self, name: str) -> None:
        """Take a mesh away.

        Args:
            name: Its name.

        Raises:
            ValueError: There is no mesh of this name.
        """
        self._newest.remove(name)
        if self._page is not None:
            self._page.scene.remove(name)

    def show_cameras(self, camera: Camera, photos: Any = None, masks: Any = None, *, name: str = "cameras") -> None:
        """Show cameras as frusta, with their photographs; a click on one takes the browser there.

        A photograph can be the target of a loss whose gradient is shown.

        Args:
            camera: N cameras, in the coordinates of the meshes.
            photos: [N, 3, H, W] floating, RGB in [0, 1], multiplied by the masks if there are any; or None.
            masks: [N, H, W] floating in [0, 1], or None.
            name: Name of the cameras. Others are replaced.

        Raises:
            TypeError, ValueError: An argument does not fit.
        """
        taken = photographs(camera, photos, masks)
        self._on_page("cameras", lambda page: page.show_cameras(name, taken))

    def show_pictures(self, pictures: Mapping[str, str | os.PathLike[str]]) -> None:
        """Offer pictures, such as those that a program has written, in a panel of their own.

        Args:
            pictures: Image files by name.

        Raises:
            FileNotFoundError: A file does not exist.
        """
        files = {name: existing(path) for name, path in pictures.items()}
        self._on_page("pictures", lambda page: page.show_pictures(files))

    def show_curves(self, numbers: Mapping[str, Sequence[tuple[float, float]]]) -> None:
        """Draw curves, such as those of a run that is over.

        Args:
            numbers: Points (step, value) of each curve, by name.

        Raises:
            ValueError: A point is not a pair of numbers.
        """
        for name, points in numbers.items():
            if any(len(point) != 2 for point in points):
                raise ValueError(f"numbers: expected pairs (step, value), got others for {name}")
        self._run.numbers = {name: [(float(x), float(y)) for x, y in points] for name, points in numbers.items()}
        self._update_run()
        self.finish("")

    def set_up(self, axis: str | Sequence[float]) -> None:
        """Choose the axis or the direction that is up in the browser.

        Args:
            axis: "+x", "-x", "+y", "-y", "+z" or "-z", or a direction (x, y, z) of any length; "+y" at first.

        Raises:
            TypeError, ValueError: It is none of these.
        """
        if isinstance(axis, str) and axis not in UP:
            raise ValueError(f"axis: expected one of {', '.join(UP)}, or a direction, got {axis!r}")
        up: Up = axis if isinstance(axis, str) else _direction(axis)
        self._on_page("up", lambda page: page.display.set_up(up))

    def arrange(self, *, side_by_side: bool = True, equal_size: bool = False) -> None:
        """Choose where several meshes stand in the browser, and how large they are there.

        Args:
            side_by_side: Arrange in a row; otherwise at their coordinates.
            equal_size: Scale all to the size of the first; otherwise unscaled.

        Raises:
            TypeError: An argument is neither True nor False.
        """
        row, equal = validate.flag("side_by_side", side_by_side), validate.flag("equal_size", equal_size)
        self._on_page("places", lambda page: page.display.arrange(row, equal))

    def show_steps(self, labels: Sequence[str], choose: Callable[[int], None]) -> None:
        """Add a slider through steps.

        Args:
            labels: What each step is.
            choose: Called in another thread with the number of the step, from 0, that was chosen.

        Raises:
            ValueError: There are no steps.
        """
        labels = list(labels)
        if not labels:
            raise ValueError("labels: expected at least one step, got none")
        self._on_page("steps", lambda page: page.show_steps(labels, choose))

    def log(self, step: int, **numbers: float) -> None:
        """Add numbers, such as losses, to curves.

        Args:
            step: Number of the step.
            **numbers: A number for each curve, by name.

        Raises:
            TypeError, ValueError: ``step`` is not a whole number ≥ 0, or a value is not a number.
        """
        validate.whole("step", step, 0)
        for name, value in numbers.items():
            if isinstance(value, (str, bytes)):
                raise TypeError(f"{name}: expected a number, got {type(value).__name__}")
        self._log(f"step {step}", step, {name: float(value) for name, value in numbers.items()})

    def knob(self, name: str, value: float, *, least: float = 0.0, most: float = 1e9) -> Callable[[], float]:
        """Add a field for a number that may change while the program runs.

        A field of this name that is there already keeps what was typed. A number counts once nobody has typed for a
        moment.

        Args:
            name: Its name.
            value: Its value at first.
            least, most: Its limits.

        Returns:
            A function that returns the present value.

        Raises:
            TypeError, ValueError: The numbers are not finite, or the value is outside of its limits.
        """
        low, first, high = (validate.number(name, number) for number in (least, value, most))
        if not low <= first <= high:
            raise ValueError(f"{name}: expected a value from {least} to {most}, got {value}")
        knobs = {**self._run.knobs, name: Knob(name, first, low, high)}
        self._run.offer([replace(knob, value=self._run.present(knob.name, knob.value)) for knob in knobs.values()])
        self._update_run()
        return lambda: float(self._run.present(name, first))

    def proceed(self) -> bool:
        """Wait while a user has paused; return whether the program should continue.

        Returns:
            False after "Stop and keep".
        """
        self._use_run()
        if self.paused:
            self._newest.catch_up()
        return goes_on(self)

    # Methods that tasks call; `Observer` documents them.

    def observe(self, phase: str, step: int, steps: int, numbers: Mapping[str, float], mesh: Callable[[], Any]) -> None:
        self._check_open()
        self._use_run()
        text = f"{phase} {step} of {steps}" if steps else f"{phase} {step}"
        values = "  \n".join(f"{name} {value:.4g}" for name, value in list(numbers.items())[:4])
        self._log(f"**{text}**  \n{values}", step, numbers)

        def meshes() -> Mapping[str, Any]:
            found = mesh()
            return found if isinstance(found, Mapping) else {"mesh": found}

        self._newest.observe((step, phase), meshes, always=0 < steps <= step)

    def offer(self, knobs: Sequence[Knob]) -> None:
        self._run.offer(knobs)
        self._update_run()

    def changes(self) -> dict[str, float | str]:
        return self._run.changes()

    def finish(self, text: str = "done") -> None:
        """Announce the end of the work to browsers. Meshes can still be shown, and may then use all cores.

        Args:
            text: Message for the page.
        """
        self._worker.set_share(1.0)
        self._newest.finish()
        self._on_page("finish", lambda page: page.finish(text))

    def wait(self, for_browser: bool = False) -> None:
        """Wait until Ctrl-C, which raises KeyboardInterrupt.

        Args:
            for_browser: Wait only while a browser shows the page.

        Raises:
            KeyboardInterrupt: Ctrl-C.
        """
        while not self._is_closed and (self.clients or not for_browser):
            time.sleep(_POLL)

    def flush(self) -> None:
        """Show the newest meshes now, and wait until they are sent to the browsers or recorded."""
        self._worker.set_share(1.0)
        self._newest.catch_up()
        self._worker.wait(_FLUSH)
        if self._run.is_used:
            self._spare()

    def close(self) -> str | None:
        """End the page and write the record. Nothing happens if the viewer is closed already.

        Returns:
            A sentence about the record, or None without one.
        """
        with self._lock:
            if self._is_closed:
                return None
            self._is_closed = True
        atexit.unregister(self.close)
        self.flush()
        self._worker.close()
        if self._page is not None:
            self._page.close()
        if self._recorder is None:
            return None
        (step, label), meshes = self._newest.all()
        if meshes:
            self._recorder.add(step, meshes, label, always=True)
        return self._recorder.write()

    def save_record(self, path: str | os.PathLike[str], *, limit: float = WatchOptions.record_limit) -> str:
        """Write what is shown now as an HTML file that any browser opens.

        Args:
            path: Name that ends in ``.html``.
            limit: Size of the file in MiB at most.

        Returns:
            A sentence about the file.

        Raises:
            ValueError: The name does not end in ``.html``.
            OSError: The file cannot be written.
        """
        self._newest.catch_up()
        recorder = Recorder(path, limit)
        (step, label), meshes = self._newest.all()
        recorder.add(step, meshes, label, always=True)
        return recorder.write()

    def _repr_html_(self) -> str:
        from .notebook import frame_of

        return frame_of(self.url)

    def _open_page(self, host: str, port: int, title: str) -> None:
        from .page import Page  # needs viser only when it is used

        try:
            self._page = Page(host, port, title, self._worker, self._run)
        except BaseException:
            self._worker.close()
            raise
        self.url = self._page.url

    def _check_open(self) -> None:
        if self._is_closed:
            raise RuntimeError("viewer: expected an open viewer, got a closed one")

    def _put(self, name: str, copy: Snapshot) -> None:
        """Show and record a new copy of a mesh."""
        if self._page is not None:
            self._page.scene.put(name, copy)
        if self._recorder is not None:
            self._worker.post("record", self._record)

    def _is_watched(self) -> bool:
        """Return whether a browser shows the meshes, or a record keeps them."""
        return self._recorder is not None or self.clients > 0

    def _postpone(self) -> None:
        """Copy meshes that came too early, in the worker's thread."""
        self._worker.post("early", self._newest.catch_up)

    def _record(self) -> None:
        """Add the newest meshes to the record. Runs in the worker's thread."""
        (step, label), meshes = self._newest.all()
        if self._recorder is not None:
            self._recorder.add(step, meshes, label)

    def _log(self, text: str, step: int, numbers: Mapping[str, float]) -> None:
        """Keep numbers for the curves, here and in the record."""
        self._use_run()
        self._run.log(text, numbers)
        if self._recorder is not None:
            self._recorder.log(step, numbers)
        self._update_run()

    def _use_run(self) -> None:
        """Show the controls of a run."""
        if not self._run.is_used:
            self._run.is_used = True
            self._spare()
            self._update_run()

    def _spare(self) -> None:
        """Leave the cores to the work, unless it is over."""
        self._worker.set_share(1.0 if self._newest.is_hurried else _WORKER_SHARE)

    def _update_run(self) -> None:
        self._on_page("run", lambda page: page.update_run())

    def _on_page(self, name: str, job: Callable[[Page], None]) -> None:
        """Change the page soon, in the worker's thread, if there is one; a later change of this name replaces it."""
        page = self._page
        if page is not None:
            self._worker.post(name, lambda: job(page))


def _direction(values: Sequence[float]) -> tuple[float, float, float]:
    """Check a direction; return its unit vector."""
    numbers = [validate.number("axis", value) for value in values]
    length = math.hypot(*numbers)
    if len(numbers) != 3 or not 0 < length < math.inf:
        raise ValueError(f"axis: expected a direction (x, y, z), got {tuple(values)}")
    x, y, z = (number / length for number in numbers)
    return x, y, z


def view(
    *,
    host: str = WatchOptions.host,
    port: int = WatchOptions.port,
    rate: float = _RATE,
    record: str | os.PathLike[str] | None = None,
    record_limit: float = WatchOptions.record_limit,
    browser: bool = True,
    title: str = _TITLE,
) -> Viewer:
    """Open a viewer in the browser, to show meshes while a program changes them.

    The address is printed; in a notebook the page appears in the output. The viewer is a context that closes the page
    at its end; without ``with``, `Viewer.close` or the end of the program does.

    Args:
        host: Name or address of this machine to listen on. Everybody who reaches another address than 127.0.0.1 sees
            the meshes and can stop the program; a warning says so.
        port: First port to try, 1 to 65535; the next free one is taken, with a warning. 0 takes any.
        rate: Updates a second at most, > 0.
        record: Name of an HTML file that keeps the frames and needs neither Python nor a network; None for none.
        record_limit: Size of that file in MiB at most, ≥ 1.
        browser: Open a port for browsers. Without it, only the record is made, and viser is not needed.
        title: Title of the page.

    Returns:
        The viewer.

    Raises:
        TypeError, ValueError: An argument is out of range.
        ModuleNotFoundError: viser is not installed (extra "view").
        OSError: The host is unknown, no port is free, or the record cannot be written.

    Example:
        >>> with nr.view(browser=False, record="run.html") as viewer:
        ...     for step in range(3):
        ...         viewer.show(mesh, name="sphere")
        ...         viewer.log(step, loss=1 / (step + 1))
    """
    viewer = Viewer(
        host=host, port=port, rate=rate, record=record, record_limit=record_limit, browser=browser, title=title
    )
    if viewer.url is not None:
        from .notebook import announce

        announce(viewer.url)
    return viewer
