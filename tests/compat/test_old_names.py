"""Names and keywords of version 2.1 that work for one release, with a warning."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.adjustable import Adjustable
from neural_renderer.apps.fit import FitWeights, Views
from neural_renderer.apps.pose import camera_fit
from neural_renderer.apps.pose.find import ObjectPose

CASES: dict[str, tuple[Callable[[], Any], Callable[[], Any]]] = {
    "FitWeights: edge_length has no effect": (
        lambda: FitWeights(laplacian=2.0, edge_length=1.0),  # type: ignore[call-arg]
        lambda: FitWeights(laplacian=2.0),
    ),
    "FitWeights: smoothness has no effect": (
        lambda: FitWeights(smoothness=1.0),  # type: ignore[call-arg]
        lambda: FitWeights(),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_an_old_keyword_works_with_a_warning(name: str) -> None:
    old, new = CASES[name]
    with pytest.warns(DeprecationWarning, match=f"^{name} since version 2.2$") as caught:
        found = old()
    assert found == new() and caught[0].filename == __file__


def test_camera_fit_is_find_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cameras draw the image in the world of the mesh, and its state is that of a run."""
    eyes = torch.tensor([[1.5, 1.0, -2.5], [-2.0, 0.5, 2.0]])
    cameras = nr.Camera.look_at(eyes, at=(0.1, 0.0, 0.2), viewing_angle=25.0)
    known = cameras.with_K(24)
    vertices, faces = nr.torus(0.7, 0.28, 16, 8)
    masks = nr.render(nr.Mesh(vertices, faces), cameras, 24).alpha.detach()
    matrices = torch.eye(4).repeat(2, 1, 1)
    matrices[:, :3] = torch.cat((known.rotation, known.translation[..., None]), -1)
    asked: dict[str, Any] = {}

    def find_pose(mesh: nr.Mesh, photo: None, mask: torch.Tensor, **options: Any) -> ObjectPose:
        asked.update(mask=mask, photo=photo, **options)
        figures: Any = (torch.eye(6), 0.99, "ambiguous", (), 0.1, matrices[1:], torch.tensor([0.3]))
        return ObjectPose(matrices[0], known[0], 25.0, *figures)

    monkeypatch.setattr(camera_fit, "find_pose", find_pose)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of the module, at its first import
        from neural_renderer.tasks.fit import CameraFit
    with pytest.warns(DeprecationWarning, match="^CameraFit is neural_renderer.find_pose since version 2.2$"):
        fit = CameraFit((vertices, faces), masks[0], viewing_angle=25.0, starts=16, steps=80)
    assert (fit.phase, fit.done, [knob.name for knob in fit.knobs()]) == ("camera", False, ["rate"])
    assert fit.advance() == {"loss": pytest.approx(0.1)} and fit.done
    assert asked["photo"] is None and torch.equal(asked["mask"], masks[0]) and asked["viewing_angle"] == 25.0
    torch.testing.assert_close(fit.cameras().origin, eyes)
    torch.testing.assert_close(fit.cameras().rotation, cameras.rotation)
    torch.testing.assert_close(fit.best().origin, eyes[:1])
    torch.testing.assert_close(fit.losses(), torch.tensor([0.1, 0.3]))
    expected = torch.cat([nr.metrics.silhouette_iou(each[None], masks[:1]) for each in masks])
    torch.testing.assert_close(fit.iou(), expected)
    assert fit.iou()[0] > 0.999
    with pytest.warns(DeprecationWarning):
        other = CameraFit((vertices, faces), masks[0])
    other.load_state_dict(fit.state_dict())
    assert other.done and torch.equal(other.losses(), fit.losses())
    with (
        pytest.warns(DeprecationWarning),
        pytest.raises(TypeError, match=r"CameraFit: expected settings .*, got step$"),
    ):
        CameraFit((vertices, faces), masks[0], step=1)
    with pytest.warns(DeprecationWarning), pytest.raises(ValueError, match="mask: expected an object, got an empty"):
        CameraFit((vertices, faces), torch.zeros(8, 8))


def test_turn_is_adjust() -> None:
    class Fit(Adjustable):
        _rate = 0.5

    fit = Fit()
    with pytest.warns(DeprecationWarning, match="^turn is adjust since version 2.2$") as caught:
        fit.turn("rate", 0.25)
    assert [knob.value for knob in fit.knobs()] == [0.25] and caught[0].filename == __file__


@pytest.mark.slow
def test_camera_fit_finds_the_camera_of_a_photo() -> None:
    vertices, faces = nr.icosphere(2)
    cubes = (vertices[faces.long()].mean(1) * 0.5 + 0.5)[:, None, None, None].expand(-1, 2, 2, 2, -1)
    mesh = nr.Mesh(vertices * torch.tensor([1.0, 0.6, 0.4]) + 3, faces, cubes)
    camera = nr.Camera.look_at(torch.tensor([[1.2, 1.5, -2.5]]) + 3, at=(3.1, 3.0, 2.9), viewing_angle=25.0)
    view = Views.of(mesh, camera, 64)
    assert view.photos is not None
    with pytest.warns(DeprecationWarning):
        fit = camera_fit.CameraFit(
            (mesh.vertices, mesh.faces, mesh.textures), view.masks[0], view.photos[0], viewing_angle=25.0, starts=10
        )
    while not fit.done:
        fit.advance()
    trace = float((fit.best().rotation[0] * camera.rotation[0]).sum())
    assert math.degrees(math.acos(min((trace - 1) / 2, 1.0))) < 2
    assert (fit.best().origin - camera.origin).norm() < 0.1
