"""Fields of the settings that may change while a run goes on."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from ...tasks.observer import Knob

if TYPE_CHECKING:
    import viser

SETTLED = 0.8  # seconds after the last keystroke: 1e-4 does not set 1 on the way
_LAST = 1e9  # order of the settings, below the curves


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
        """Add the field of a setting."""
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
    """Tell what is wrong with the text of a setting; None if nothing is."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if knob.least <= value <= knob.most:
        return None
    return f"{knob.name.replace('_', ' ')}: expected a number from {knob.least:g} to {knob.most:g}, got {text!r}"
