"""Narrow holes and gaps: a hull on a finer grid opens them where silhouettes show them."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.fit import MeshFit, Views, carve
from neural_renderer.apps.fit.hull import carve_levels, covered_background
from neural_renderer.meshes.topology import Topology

LEVELS = (20, 40)  # for images of 80 pixels, which have the same cells as 64 and 128 in images of 256


def euler(faces: Tensor) -> int:
    topology = Topology.of(faces)
    return topology.vertices - len(topology.edges) + len(faces)


def views_of(vertices: Tensor, faces: Tensor, elevation: float = 75.0) -> Views:
    eyes = nr.get_points_from_angles(3.2, elevation, torch.arange(8) * 45.0)
    camera = nr.Camera.look_at(eyes, viewing_angle=22)
    around = nr.get_points_from_angles(3.2, torch.tensor([89.0, 10, 10, 10]), torch.arange(4) * 90.0)
    side = nr.Camera.look_at(around, viewing_angle=22)
    views = Views.of(nr.Mesh(vertices, faces), nr.Camera.cat([camera, side]), 80)
    return Views(views.camera, views.masks)


@pytest.fixture(scope="module")
def ring() -> Views:
    """Views of a torus with a hole as wide as a cell of the coarse grid."""
    vertices, faces = nr.torus(0.5, 0.41, 48, 24)
    return views_of(vertices + torch.tensor([0.05, 0.0, 0.05]), faces)  # between the points of the coarse grid


def test_a_finer_level_opens_a_hole(ring: Views) -> None:
    coarse, fine = carve(ring, LEVELS[0]), carve_levels(ring, LEVELS)
    assert euler(coarse[1]) > 0  # no hole; perhaps a cavity in its place
    assert euler(fine[1]) == 0  # open, as the torus
    before, after = (covered_background(ring, shape, 2) for shape in (coarse, fine))
    assert after.sum() < before.sum() / 4
    iou = [ring.quality(shape)["iou"].mean() for shape in (coarse, fine)]
    assert iou[1] > iou[0]


def test_without_holes_the_coarse_level_stays() -> None:
    ball = views_of(*nr.icosphere(3, 0.95), elevation=40.0)
    assert covered_background(ball, carve(ball, LEVELS[0]), 2).sum() == 0
    assert torch.equal(carve_levels(ball, LEVELS)[0], carve(ball, LEVELS[0])[0])


def test_a_single_view_opens_nothing(ring: Views) -> None:
    ball = views_of(*nr.icosphere(3, 0.95), elevation=40.0)
    masks = ball.masks.clone()
    masks[2, 38:41, 38:41] = 0  # a highlight, for example
    spoiled = Views(ball.camera, masks)
    assert (covered_background(spoiled, carve(spoiled, LEVELS[0]), 2) > 0).tolist() == [i == 2 for i in range(12)]
    assert euler(carve_levels(spoiled, LEVELS)[1]) == 2


def test_cells_of_a_fit(ring: Views) -> None:
    ring = ring[[0, 2, 5, 8, 9]]
    fit = MeshFit(ring, cells=LEVELS[0], steps=1)
    assert torch.equal(fit.shape[1], carve(fit.views, LEVELS[0])[1])
    assert torch.equal(MeshFit(ring, steps=1).shape[1], carve(fit.views, 64)[1])  # which opens the hole
    with pytest.raises(ValueError, match="cells: expected"):
        MeshFit(ring, cells=4)
