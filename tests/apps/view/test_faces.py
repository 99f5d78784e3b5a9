"""What a click on a mesh tells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import neural_renderer as nr
from neural_renderer.apps.common.views.views import Views
from neural_renderer.apps.view.viewer import Viewer


def test_a_click_tells_where_the_first_photograph_shows_it(open_viewer: Callable[..., Viewer]) -> None:
    """In shares of width and height, as `fit --object` takes them."""
    ball, viewer = nr.Mesh.icosphere(2), open_viewer()
    views = Views.of(ball, nr.Camera.look_at([[0.0, 0.0, -3.0], [3.0, 0.0, 0.0]], viewing_angle=30), (40, 80))
    viewer.show(ball, "ball")
    viewer.show_cameras(views.camera, views.photos, views.masks)
    viewer.flush()
    page = viewer._page
    assert page is not None
    faces = page.display.faces
    up = np.array([0.0, 0.3, 1.0]) / np.hypot(0.3, 1.0)
    for direction in (np.array([0.0, 0.0, 1.0]), up):
        faces._show(np.array([0.0, 0.0, -3.0]), direction)
        across = 0.5
        down = 0.5 - direction[1] / direction[2] / np.tan(np.radians(30)) / 2
        place = f"{across:.3f} {down:.3f}"
        assert faces._text.content.startswith("**ball: face ")
        assert faces._text.content.endswith(f"; photo 1 shows it at {place}")
    faces._show(np.array([0.0, 0.0, -3.0]), np.array([0.0, 0.0, -1.0]))
    assert faces._text.content == "*No face there.*"
    assert page.frusta.seen_in(np.array([0.0, 0.0, -9.0])) == ""
    aside = page.frusta.seen_in(np.array([0.0, 0.0, -3.2]))  # behind the first one
    assert aside.startswith("; photo 2 shows it at ")
