"""Colours of the background behind an object: a table that ends before walls with a pattern."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.fit.photos.masks.background import Background, predict_background
from neural_renderer.apps.fit.photos.place import Place

_SIDE, _WALL, _FLOOR, _TABLE = 64, 5.0, -0.6, 1.2


def room() -> tuple[np.ndarray, nr.Camera, Place, np.ndarray]:
    """Draw a table between four walls, seen by twelve cameras; returns where it is, too."""
    rng = torch.Generator().manual_seed(0)
    eyes = nr.get_points_from_angles(3.0, torch.tensor([20.0, 30.0] * 6), torch.arange(12) * 30.0)
    camera = nr.Camera.look_at(eyes, viewing_angle=25.0)
    corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
    flat = torch.tensor([[_TABLE * x, _FLOOR, _TABLE * z] for x, z in corners])
    walls = [torch.tensor([[_WALL * x, _WALL * y, _WALL] for x, y in corners])]
    for _ in range(3):
        walls.append(torch.stack((walls[-1][:, 2], walls[-1][:, 1], -walls[-1][:, 0]), -1))
    uv = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]])
    images = torch.zeros(12, 3, _SIDE, _SIDE)
    for quad in (*walls, flat):
        drawn = nr.render(nr.UVMesh(quad, faces, uv, torch.rand(10, 10, 3, generator=rng)), camera, _SIDE, light=None)
        images = drawn.rgb + images * (1 - drawn.alpha[:, None])
    on_table = drawn.alpha.numpy() > 0.5
    share = torch.rand(400, 2, generator=rng)
    points = torch.cat([w[0] + share[:, :1] * (w[3] - w[0]) + share[:, 1:] * (w[1] - w[0]) for w in walls])
    ground = np.array([0.0, 1.0, 0.0, _FLOOR])
    place = Place(np.zeros(3), 0.6, ground, np.zeros((0, 3)), points.double().numpy())
    return images.permute(0, 2, 3, 1).numpy(), camera, place, on_table


def test_walls_behind_a_table_that_ends_are_predicted() -> None:
    images, camera, place, on_table = room()
    hidden = np.zeros(images.shape[:3], bool)
    hidden[:, 24:40, 24:40] = True
    shown = np.where(hidden[..., None], np.float32(1.0), images)
    found = predict_background(shown, camera, place, hidden)
    wrong = np.abs(found - images).max(-1)
    for part in (on_table, ~on_table):
        assert np.isfinite(wrong[part]).mean() > 0.8
        assert np.nanmedian(wrong[part]) < 0.05
        assert np.nanmedian(wrong[part & hidden]) < 0.1, "what hides the background does not count"


def test_without_points_around_a_plane_is_all_that_is_known() -> None:
    images, camera, place, on_table = room()
    only = Place(place.center, place.half, place.ground, place.points, place.around[:0])
    colours, points = Background(images, camera, only).predict(np.zeros(images.shape[:3], bool))
    known = np.isfinite(points[..., 0])
    np.testing.assert_allclose(points[known][:, 1], _FLOOR, atol=1e-4)
    assert np.nanmedian(np.abs(colours - images).max(-1)[on_table]) < 0.05
    nothing = Place(place.center, place.half, None, place.points, place.around[:0])
    assert np.isnan(predict_background(images, camera, nothing, np.zeros(images.shape[:3], bool))).all()


@pytest.mark.slow  # like the test of walls behind a table
def test_walls_are_predicted_without_a_table() -> None:
    images, camera, place, on_table = room()
    nothing = Place(place.center, place.half, None, place.points, place.around)
    found = predict_background(images, camera, nothing, on_table)
    assert np.nanmedian(np.abs(found - images).max(-1)[~on_table]) == pytest.approx(0.0, abs=0.05)
