"""Masks and cameras that disagree are named, with what mends them; up is told from the cameras; regions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

import neural_renderer as nr
from neural_renderer.apps.common.views.load import outline_of_box, region_of_points
from neural_renderer.apps.fit import MeshFit, Views, check_agreement, object_bounds
from neural_renderer.apps.fit.agreement import hull_coverage
from neural_renderer.apps.fit.fit_pictures import up_of_cameras
from tests.apps.fit.bent_bar import (
    bent_bar,
    calibrated,
    inverted,
    mirrored,
    scaled,
    upside_down,
    with_axes,
    with_one_turned,
)

NAMES = [f"{row}.png" for row in range(10)]


@pytest.fixture(scope="module")
def views() -> Views:
    return bent_bar()


def test_views_that_agree(views: Views) -> None:
    """The hull of true silhouettes fills each of them; two views always agree."""
    assert float(hull_coverage(views).min()) > 0.97
    check_agreement(views, NAMES)
    check_agreement(with_one_turned(views)[[0, 3]], NAMES[:2])


@pytest.fixture(scope="module")
def ellipsoid() -> Views:
    vertices, faces = nr.icosphere(2)
    eyes = nr.get_points_from_angles(3.0, torch.tensor([70.0, 10, -35, 20, 40, -5]), torch.arange(6) * 60.0)
    mesh = nr.Mesh(vertices * torch.tensor([0.9, 0.5, 0.7]), faces)
    return replace(Views.of(mesh, nr.Camera.look_at(eyes, viewing_angle=22), 48), photos=None)


def test_result_of_a_good_fit(ellipsoid: Views) -> None:
    fit = MeshFit(ellipsoid[[0, 1, 2, 3, 5]], cells=20, steps=4)
    result = fit.run(held_out=ellipsoid[[4]])
    assert fit.done and (result.verdict, result.advice) == ("match", ())
    assert result.agreement == float(result.fitted["iou"].mean()) > 0.9
    assert result.held_out is not None and result.held_out["iou"].shape == (1,)
    assert result.held_out_located is None and result.held_out_exposed is None


def test_result_of_a_fit_that_fails(ellipsoid: Views, views: Views) -> None:
    short = MeshFit(ellipsoid, "sphere", steps=1).run()  # masks and cameras agree
    assert short.verdict == "mismatch" and short.agreement < 0.8 and short.held_out is None
    assert len(short.advice) == 1 and "expected an IoU of at least 0.8, got 0." in short.advice[0]
    wrong = MeshFit(Views(views.camera, views.masks.rot90(2, (1, 2))), "sphere", steps=1)
    assert len(wrong.result().advice) == 1  # the cause is sought when the fit is done
    result = wrong.run()
    assert result.verdict == "mismatch" and "turning the images by 180° mends them" in result.advice[1]


def turned(views: Views) -> Views:
    return Views(replace(views.camera, orig_size=(64.0, 48.0)), views.masks.rot90(1, (1, 2)))


@pytest.mark.parametrize(
    ("spoil", "advice"),
    [
        (turned, "turning the images by 90° clockwise mends them"),
        (upside_down, "turning the images by 180° mends them"),
        (mirrored, "mirroring the images left to right mends them"),
        (with_axes, r"exchanging OpenCV's camera axes .* mends them"),
        (inverted, "exchanging camera-to-world and world-to-camera matrices mends them"),
        (lambda v: scaled(v, [[0.75] * 3, [4 / 3] * 3, [1] * 3]), "exchanging width and height in the intrinsics"),
        (lambda v: scaled(v, [[2] * 3, [2] * 3, [1] * 3]), "scaling the intrinsics by 0.5 mends them"),
        (lambda v: scaled(v, [[1, 1, 2], [1, 1, 2], [1] * 3]), "scaling the principal point by 0.5 mends them"),
    ],
)
def test_usual_mistakes_are_named(views: Views, spoil: Callable[[Views], Views], advice: str) -> None:
    with pytest.raises(ValueError, match=f"expected masks and cameras that agree, got 5 views that do not: .*{advice}"):
        check_agreement(spoil(views[::2]), NAMES[::2])


def test_one_view_that_disagrees_is_named(views: Views) -> None:
    with pytest.raises(ValueError, match=r"got 1 of 10 views \(3\.png\) that do not.*turning the images by 180° mends"):
        check_agreement(with_one_turned(views), NAMES)


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.4, 1.0, 0.2)])
@pytest.mark.parametrize("on_side", [False, True])
def test_up_is_told_from_the_cameras(up: tuple[float, float, float], on_side: bool) -> None:
    direction = F.normalize(torch.tensor(up), dim=0)
    eyes = nr.get_points_from_angles(3.0, torch.tensor([10.0, 40.0, 25.0, 30.0]).repeat(2), torch.arange(8) * 45.0)
    across = F.normalize(torch.linalg.cross(direction, torch.tensor([0.3, 0.1, 0.9])), dim=0)
    axes = torch.stack((across, direction, torch.linalg.cross(across, direction)))  # y of the eyes becomes up
    camera = calibrated(nr.Camera.look_at(eyes @ axes, up=direction))
    if on_side:
        quarter = torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        camera = replace(camera, rotation=quarter @ camera.rotation, translation=camera.translation @ quarter.t())
    found = up_of_cameras(Views(camera, torch.ones(8, 48, 64)))
    assert (found - direction).abs().max() < 1e-3


def test_region_of_points_and_box(views: Views) -> None:
    generator = torch.Generator().manual_seed(0)
    own = (torch.rand(200, 3, generator=generator) - 0.5) * torch.tensor([1.2, 0.3, 0.4])
    others = F.normalize(torch.randn(300, 3, generator=generator), dim=1) * 2.5  # on walls
    region = region_of_points(views, torch.cat((own, others)))
    assert region is not None and region[0].abs().max() < 0.2 and 0.5 < region[1] < 1.2
    plain, known = object_bounds(views), object_bounds(replace(views, region=region))
    assert (plain[0] - known[0]).abs().max() < 0.1 and abs(plain[1] - known[1]) < 0.1
    # A region of a part grows until it holds the object.
    part = object_bounds(replace(views, region=(torch.tensor([0.3, 0.0, 0.0]), 0.2)))
    assert (plain[0] - part[0]).abs().max() < 0.1 and abs(plain[1] - part[1]) < 0.1
    outlines, _ = outline_of_box(views.camera, (-0.8, -0.5, -0.4, 0.8, 1.1, 1.1), views.size)
    assert (views.masks > outlines + 0.01).float().mean() < 0.002 and outlines.mean() < 0.5
    with pytest.raises(ValueError, match="box: expected opposite corners"):
        outline_of_box(views.camera, (0, 0, 0, 0, 1, 1), views.size)
