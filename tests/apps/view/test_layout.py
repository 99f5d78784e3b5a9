"""Places of meshes in the scene, and the first view of a browser."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.view.layout import FIELD, axes_of, clip_distances, first_view, places_in_row
from neural_renderer.apps.view.server import _make_room
from neural_renderer.apps.view.viewer import UP, Viewer

BOXES = [
    (np.array([-1.0, -2.0, 0.0]), np.array([1.0, 3.0, 1.0])),
    (np.array([4.0, 5.0, 6.0]), np.array([5.0, 7.0, 9.0])),
    (np.array([0.0, 0.0, 0.0]), np.array([0.5, 0.25, 0.125])),
]


def corners(box: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.stack(np.meshgrid(*np.stack(box, 1)), -1).reshape(-1, 3)


def test_axes_for_a_direction_are_a_rotation() -> None:
    for up in ((0.2, -1.0, 0.4), (0.1, 0.1, 0.99), (0.0, 0.0, -2.0)):
        axes = axes_of(up)
        assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) == pytest.approx(1)
        assert np.allclose(axes[1], np.array(up) / np.linalg.norm(up))


def test_a_direction_is_offered_in_the_list(open_viewer: Callable[..., Viewer]) -> None:
    viewer = open_viewer()
    viewer.set_up((0.6, 0.0, 0.8))
    viewer.flush()
    display = viewer._page.display
    assert display._up.value == "of the cameras" and np.allclose(viewer._page.scene._axes[1], (0.6, 0.0, 0.8))
    viewer.set_up("-z")
    viewer.flush()
    assert display._up.value == "−z" and np.allclose(viewer._page.scene._axes[1], (0, 0, -1))


@pytest.mark.parametrize("up", UP)
class TestUp:
    def test_axes_are_a_rotation(self, up: str) -> None:
        axes = axes_of(up)
        assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) == pytest.approx(1)
        assert axes[1]["xyz".index(up[1])] == (1 if up[0] == "+" else -1)

    def test_meshes_stand_on_one_ground(self, up: str) -> None:
        axes = axes_of(up)
        moved = [
            (place + low, place + high) for place, (low, high) in zip(places_in_row(BOXES, axes), BOXES, strict=True)
        ]
        turned = [np.sort(np.stack((axes @ low, axes @ high)), 0) for low, high in moved]
        assert np.ptp([box[0, 1] for box in turned]) < 1e-12  # the ground
        assert np.ptp([box[:, 2].mean() for box in turned]) < 1e-12
        assert all(one[1, 0] < other[0, 0] for one, other in pairwise(turned))

    def test_the_first_view_shows_everything(self, up: str) -> None:
        axes = axes_of(up)
        position, center = first_view(BOXES, axes)
        forward = (center - position) / np.linalg.norm(center - position)
        assert (position - center) @ axes[1] > 0  # from above
        right = np.cross(forward, axes[1])
        right /= np.linalg.norm(right)
        for corner in np.concatenate(
            [np.stack(np.meshgrid(*zip(*box, strict=True)), -1).reshape(-1, 3) for box in BOXES]
        ):
            depth = (corner - position) @ forward
            assert depth > 0
            assert abs((corner - position) @ np.cross(right, forward)) < depth * np.tan(FIELD / 2)
            assert abs((corner - position) @ right) < 0.9 * depth * np.tan(FIELD / 2)


def test_without_meshes_there_is_a_view() -> None:
    position, center = first_view([], axes_of("+y"))
    assert np.isfinite(position).all() and not center.any()


@pytest.mark.parametrize("radius", [1e-6, 1e-2, 1.0, 999.0, 2e3, 1e4])
def test_the_background_is_between_the_planes(radius: float) -> None:
    """viser draws it at distance 1."""
    near, far = clip_distances(radius)
    assert near < 1.0 < far and near <= 1e-3 * radius and far >= 1e2 * radius


def test_the_near_plane_is_never_too_near() -> None:
    assert all(clip_distances(radius)[0] >= 4e-5 * radius for radius in (1e-6, 1.0, 1e5, 1e6, 1e9))


def test_the_first_view_shows_cameras_too(open_viewer: Callable[..., Viewer]) -> None:
    """One that is far away does not count, nor do hidden ones."""
    viewer = open_viewer()
    viewer.show(nr.Mesh.icosphere(1))
    eye = nr.get_points_from_angles(5.0, 0.0, torch.arange(8) * 45.0)
    eye[3] *= 100
    viewer.show_cameras(nr.Camera.look_at(eye, viewing_angle=30))
    viewer.flush()
    camera, page = viewer._page.server.initial_camera, viewer._page
    assert 12 < np.linalg.norm(camera.position) < 30
    low, high = page.frusta.bounds()[0]
    assert np.allclose(high, [5, 0, 5], atol=1e-5) and np.allclose(low, [-5, 0, -5], atol=1e-5)
    page.frusta._box.value = False
    viewer.show(nr.Mesh.icosphere(0), "other")
    viewer.flush()
    assert np.linalg.norm(camera.position) < 12


def test_names_need_not_differ_in_letters(open_viewer: Callable[..., Viewer]) -> None:
    viewer = open_viewer()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ("a/b", "a_b", "猫", "犬", "a/b"):
            viewer.show(nr.Mesh.icosphere(0), name)
            viewer.flush()
        viewer.remove("a_b")
        viewer.flush()
    shown = viewer._page.scene.meshes
    assert list(shown) == ["a/b", "猫", "犬"] and len({one.frame.name for one in shown.values()}) == 3
    viewer.set_up("+z")
    viewer.flush()
    # They stand in a row along x, on the same z.
    assert np.ptp([one.place[2] for one in shown.values()]) == 0
    assert np.ptp([one.place[0] for one in shown.values()]) > 2


def test_a_small_mesh_beside_a_large_one(open_viewer: Callable[..., Viewer]) -> None:
    """With equal sizes all are as large as the first, also those that change or come later; and back."""
    viewer = open_viewer()
    viewer.arrange(equal_size=True)
    vertices, faces = nr.icosphere(1)
    cow = nr.UVMesh(100 * vertices, faces, torch.zeros(len(vertices), 2), torch.rand(4, 4, 3))
    for name, mesh in (("ball", (vertices, faces)), ("small", (vertices / 1000, faces)), ("cow", cow)):
        viewer.show(mesh, name)
    viewer.show((vertices / 10, faces), "small")
    viewer.flush()
    shown = viewer._page.scene.meshes
    for one in shown.values():
        assert torch.allclose(one.snapshot.vertices, vertices, atol=1e-6)
    assert torch.equal(shown["cow"].snapshot.uv_mesh.vertices, shown["cow"].snapshot.vertices)
    assert "small: 42 vertices, 80 faces, shown 10 times as large" in viewer._page.display._info.content
    viewer.arrange()
    viewer.flush()
    assert torch.equal(shown["small"].snapshot.vertices, vertices / 10) and shown["cow"].scale == 1


def test_names_are_no_markdown(open_viewer: Callable[..., Viewer]) -> None:
    viewer = open_viewer()
    viewer.show(nr.Mesh.icosphere(0), "<b>*a*_猫")
    viewer.flush()
    assert viewer._page.display._info.content.startswith(r"\<b\>\*a\*\_猫: 12 vertices")


def test_the_first_view_follows_a_mesh_that_grows(open_viewer: Callable[..., Viewer]) -> None:
    viewer = open_viewer()
    vertices, faces = nr.icosphere(1)
    distances = []
    for size in (1.0, 1.2, 3.0, 0.5):
        viewer.show((size * vertices, faces))
        viewer.flush()
        camera = viewer._page.server.initial_camera
        distances.append(float(np.linalg.norm(np.subtract(camera.position, camera.look_at))))
    assert distances[0] == distances[1]
    assert distances[2] == pytest.approx(3 * distances[0], rel=1e-5)
    assert distances[3] == pytest.approx(0.5 * distances[0], rel=1e-5)


@pytest.mark.parametrize("width, folds", [(390, True), (1280, False)])
def test_panels_of_a_narrow_window_fold(width: int, folds: bool) -> None:
    folded: list[bool] = []
    panel = SimpleNamespace(minimize=lambda: folded.append(True))
    client = SimpleNamespace(camera=SimpleNamespace(image_width=width), gui=SimpleNamespace(main_panel=panel))
    _make_room(client)  # type: ignore[arg-type]
    assert bool(folded) == folds
