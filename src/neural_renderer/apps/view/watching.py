"""`--view` and `--record` of a command: a viewer that follows its run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..common.command import say
from ..common.options import WatchOptions

if TYPE_CHECKING:
    from .viewer import Viewer


@contextmanager
def watching(options: WatchOptions) -> Iterator[Viewer | None]:
    """Open a viewer if the options request one; close it at the end, with a message about the record."""
    if not options.view and options.record is None:
        yield None
        return
    from .viewer import Viewer

    viewer = Viewer(
        host=options.host,
        port=options.port,
        browser=options.view,
        record=options.record,
        record_limit=options.record_limit,
    )
    if viewer.url is not None:
        say(f"open {viewer.url} in a browser to follow the run")
    try:
        yield viewer
    finally:
        text = viewer.close()
        if text is not None:
            say(text)


def stay(viewer: Viewer | None, wanted: bool) -> None:
    """Keep a viewer open after the run, while a browser shows its page, until Ctrl-C; not after Ctrl-C in the run."""
    if viewer is None:
        return
    viewer.finish("**done**" if wanted else "**interrupted**")
    if wanted and viewer.clients:
        say("the viewer stays open until its page is closed; Ctrl-C ends it")
        try:
            viewer.wait(for_browser=True)
        except KeyboardInterrupt:
            say("the viewer has ended")
