"""A browser, where one is installed, and a viewer for each test."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from neural_renderer.apps.view.viewer import Viewer
from tests.apps.view.browser import Browser, find_browser, wait_until


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A page of a headless browser."""
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium is installed (apt-get install chromium)")
    with Browser(program) as page:
        yield page


@pytest.fixture
def open_viewer(request: pytest.FixtureRequest) -> Iterator[Callable[..., Viewer]]:
    """Opens viewers on any free port, and closes them."""
    pytest.importorskip("viser", reason="viser is not installed (the extra view)")
    opened = []

    def open_one(**options: Any) -> Viewer:
        opened.append(Viewer(**{"port": 0, **options}))
        return opened[-1]

    yield open_one
    if "browser" in request.fixturenames:
        request.getfixturevalue("browser").open("about:blank")  # the end of a viewer waits for an open page
        wait_until(lambda: not any(viewer.clients for viewer in opened), "a page that is left")
    for viewer in opened:
        viewer.close()
