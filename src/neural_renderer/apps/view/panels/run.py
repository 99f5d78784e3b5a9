"""The part of the page's panel that follows a run: its state, curves, pause and stop, and settings that may change."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...common.observer import Knob

if TYPE_CHECKING:
    import viser

_MOST_POINTS = 400  # most points of a curve
_MOST_CURVES = 4
_CURVE_HEIGHT = 120  # pixels
_CURVES_PAUSE = 0.5  # seconds
_COLOR = "#2b5a8c"
SETTLED = 0.8  # seconds after the last keystroke: 1e-4 does not set 1 on the way
_LAST = 1e9  # order of the settings, below the curves


class Run:
    """State of a run that the browser may change. Any thread may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.paused = self.stopped = False  # the user asks the task to wait; to end and keep its result
        self.is_used = False  # a task has read changes or logged numbers
        self.text = ""
        self.numbers: dict[str, list[tuple[float, float]]] = {}
        self._steps = 0
        self._changes: dict[str, float | str] = {}
        self._values: dict[str, float | str] = {}
        self.knobs: dict[str, Knob] = {}

    def log(self, text: str, numbers: Mapping[str, float]) -> None:
        """Keep the numbers of a step."""
        with self._lock:
            self.text = text
            self._steps += 1
            for name, value in numbers.items():
                points = self.numbers.setdefault(name, [])
                points.append((self._steps, float(value)))
                if len(points) > 2 * _MOST_POINTS:
                    del points[1:-1:2]

    def curves(self) -> dict[str, np.ndarray]:
        """Return the finite points of the curves, [N, 2] each."""
        with self._lock:
            arrays = {name: np.array(points, np.float64) for name, points in self.numbers.items()}
        return {name: points[np.isfinite(points).all(1)] for name, points in arrays.items()}

    def offer(self, knobs: Sequence[Knob]) -> None:
        """Replace the settings that may change."""
        with self._lock:
            self.knobs = {knob.name: knob for knob in knobs}

    def change(self, name: str, value: float | str) -> None:
        """Ask for a change."""
        with self._lock:
            self._changes[name] = self._values[name] = value

    def present(self, name: str, value: float | str) -> float | str:
        """Return the last change of a setting, or ``value`` without one."""
        with self._lock:
            return self._values.get(name, value)

    def changes(self) -> dict[str, float | str]:
        """Return the changes since the last call."""
        with self._lock:
            changes, self._changes = self._changes, {}
        return changes


class RunPanel:
    """Controls of a run. The methods are called in the worker's thread."""

    def __init__(self, server: viser.ViserServer, run: Run) -> None:
        self._server, self._run = server, run
        gui = server.gui
        self._folder = gui.add_folder("Run", order=-2)
        with self._folder:
            self._status = gui.add_markdown("")
            # Icons are left out: viser takes a fifth of a second to find one.
            self._pause = gui.add_button("Pause")
            hint = "End after this step, and keep the result"
            self._stop = gui.add_button("Stop and keep", color="red", hint=hint)
        self._curves: dict[str, Any] = {}
        self._next_curves = 0.0  # time of the next curves
        self._settings = SettingsPanel(server, run.change)
        self._offered: dict[str, Knob] = {}

        def pause(_: Any) -> None:
            run.paused = not run.paused
            self._pause.label = "Go on" if run.paused else "Pause"
            self.update(curves=True)

        def stop(_: Any) -> None:
            run.stopped = True
            self._pause.disabled = self._stop.disabled = True
            self.update(curves=True)

        self._pause.on_click(pause)
        self._stop.on_click(stop)

    def update(self, curves: bool = False) -> None:
        """Show the state of the run; its curves twice a second at most, or now."""
        run = self._run
        state = "stopping" if run.stopped else "paused" if run.paused else ""
        text = f"**{state}** · {run.text}" if state and run.text else f"**{state}**" if state else run.text
        if self._status.content != text:
            self._status.content = text
        now = time.monotonic()
        if curves or now >= self._next_curves:
            self._next_curves = now + _CURVES_PAUSE
            for name, points in list(run.curves().items())[:_MOST_CURVES]:
                if len(points):
                    self._show_curve(name, points)
        if run.knobs != self._offered:
            self._offered = dict(run.knobs)
            with self._folder:
                self._settings.show(self._offered)

    def finish(self, text: str) -> None:
        """Show that the run is over."""
        self._pause.visible = self._stop.visible = False
        self._run.text, self._run.paused, self._run.stopped = text, False, False
        self._run.knobs = {}
        self.update(curves=True)

    def _show_curve(self, name: str, points: np.ndarray) -> None:
        import viser

        thin = points[:: -(-len(points) // _MOST_POINTS)]
        x, y = np.ascontiguousarray(thin[:, 0]), np.ascontiguousarray(thin[:, 1])
        # viser's page, when it is slow, loses its place in curves whose axis follows them.
        axis = {"x": viser.uplot.Scale(time=False, range=(0.0, round_up(float(x.max()))))}
        if name in self._curves:
            curve = self._curves[name]
            curve.data = (x, y)
            if curve.scales != axis:
                curve.scales = axis
            return
        with self._folder:
            self._curves[name] = self._server.gui.add_uplot(
                (x, y),
                (viser.uplot.Series(label="step"), viser.uplot.Series(label=name, stroke=_COLOR, width=2)),
                title=name,
                scales=axis,
                legend=viser.uplot.Legend(show=False),
                height=_CURVE_HEIGHT,
            )


def round_up(value: float) -> float:
    """Return the least of 10, 20, 50, 100, 200, 500, … that is at least ``value``."""
    power = 10.0 ** max(math.floor(math.log10(max(value, 1.0))), 1)
    return next(factor * power for factor in (1, 2, 5, 10) if value <= factor * power)


class SettingsPanel:
    """A folder with a field for each setting. Another thread calls ``change`` with the name and value of one."""

    def __init__(self, server: viser.ViserServer, change: Callable[[str, float | str], None]) -> None:
        self._server, self._change = server, change
        self._folder: Any = None
        self._timers: dict[str, threading.Timer] = {}

    def show(self, knobs: Mapping[str, Knob]) -> None:
        """Show these settings in place of the others; remove the folder if there are none."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers = {}
        if self._folder is not None:
            self._folder.remove()
            self._folder = None
        if not knobs:
            return
        self._folder = self._server.gui.add_folder("Settings", order=_LAST)
        with self._folder:
            for knob in knobs.values():
                self._add_field(knob)
            self._note: Any = self._server.gui.add_markdown("", visible=False)

    def _add_field(self, knob: Knob) -> None:
        gui, label = self._server.gui, knob.name.replace("_", " ")
        if knob.choices:
            choice = gui.add_dropdown(label, knob.choices, initial_value=str(knob.value))
            choice.on_update(lambda _: self._change(knob.name, choice.value))
            return
        # A field for numbers would round to the digits of the first value, and knows no 1e-4.
        field = gui.add_text(label, f"{float(knob.value):.6g}")

        def wait(_: Any) -> None:
            if knob.name in self._timers:
                self._timers[knob.name].cancel()
            timer = self._timers[knob.name] = threading.Timer(SETTLED, self._take, (knob, field))
            timer.daemon = True
            timer.start()

        field.on_update(wait)

    def _take(self, knob: Knob, field: Any) -> None:
        """Take the number of a field, or say what is wrong with it."""
        problem = problem_of(knob, field.value)
        if problem is None:
            self._change(knob.name, float(field.value))
        self._note.content, self._note.visible = problem or "", problem is not None


def problem_of(knob: Knob, text: str) -> str | None:
    """Describe the error in the text of a setting; None if it is valid."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if knob.least <= value <= knob.most:
        return None
    return f"{knob.name.replace('_', ' ')}: expected a number from {knob.least:g} to {knob.most:g}, got {text!r}"
