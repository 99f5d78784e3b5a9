"""`view`: opens a viewer in the browser."""

from __future__ import annotations

import os

from .records.recorder import DEFAULT_LIMIT
from .viewer import DEFAULT_HOST, DEFAULT_PORT, Viewer


def view(
    *,
    host: str = DEFAULT_HOST,
    port: int = DEFAULT_PORT,
    rate: float = 10.0,
    record: str | os.PathLike[str] | None = None,
    record_limit: float = DEFAULT_LIMIT,
    browser: bool = True,
    title: str = "neural-renderer",
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
        ModuleNotFoundError: viser is not installed (``pip install 'neural-renderer[view]'``).
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
