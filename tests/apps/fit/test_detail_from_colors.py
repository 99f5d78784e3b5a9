"""Details from colours: albedo and light are fitted along."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

import neural_renderer as nr
from neural_renderer.apps.fit import DetailFit, DetailWeights, MeshFit, Views
from neural_renderer.apps.fit.detail.color_model import ColorModel, LightFit
from neural_renderer.apps.fit.detail.consistency import mismatch
from neural_renderer.apps.fit.detail.detail_fit import fewer
from tests.apps.fit.test_detail import cameras, dented, distance


@pytest.fixture(scope="module")
def views() -> Views:
    light = nr.Light(ambient=0.5, directional=0.5, direction=(0.4, 0.4, -0.8))
    return Views.of(nr.Mesh(*dented()), cameras(10), 64, light=light)


def test_light_of_known_normals() -> None:
    """Nine factors a channel come back, also with outliers and with an albedo that varies."""
    random = torch.Generator().manual_seed(0)
    normals = normalize(torch.randn(3000, 3, generator=random), dim=1)
    albedo = 0.3 + 0.7 * torch.rand(3000, 3, generator=random)
    truth = LightFit(normals)
    truth.factors = 0.3 * torch.randn(9, 3, generator=random) + truth.factors
    colors = albedo * truth.on(normals)
    colors[::10] = 1.0  # highlights
    light = LightFit(normals)
    for _ in range(20):
        light.add(normals, albedo, colors)
    # The outliers, a tenth of the pixels, and the ridge pull the light a little.
    assert (light.on(normals) - truth.on(normals)).abs().max() < 0.03
    again = LightFit(normals)
    again.load_state_dict(light.state_dict())
    again.add(normals, albedo, colors)
    light.add(normals, albedo, colors)
    assert torch.equal(again.factors, light.factors)


def test_light_has_the_bands_of_the_renderer() -> None:
    """The factors are the coefficients of a `SphericalHarmonicLight`, times 1, 2/3 and 1/4 of their bands."""
    coefficients = torch.randn(9, 3, generator=torch.Generator().manual_seed(0))
    coefficients[0] = 8.0  # bright enough everywhere
    bands = torch.tensor([1.0] + [2 / 3] * 3 + [1 / 4] * 5)
    light, normals = LightFit(coefficients), normalize(torch.randn(1, 50, 3), dim=2)
    light.factors = coefficients * bands[:, None]
    torch.testing.assert_close(light.on(normals), nr.SphericalHarmonicLight(coefficients).on(normals))


@pytest.mark.parametrize("light", ["fitted", "none"])
def test_hollow_that_outlines_do_not_show(views: Views, light: Any) -> None:
    """From a ball without the dent, which no outline shows: it appears, and a resumed fit goes on in the same way."""
    start = nr.icosphere(3, radius=0.88)
    fit = DetailFit(views, *start, steps=40, light=light)
    state: Any = None
    while not fit.done:
        if fit.step == 38:
            state = copy.deepcopy(fit.state_dict())
        numbers = fit.advance()
    assert set(numbers) == {"loss", "iou", "silhouette", "photometric", "albedo"}
    assert numbers["iou"] > 0.97
    assert distance(fit.shape, dented()) < 0.5 * distance(start, dented())
    again = DetailFit(views, *start, steps=40, light=light)
    again.load_state_dict(state)
    while not again.done:
        again.advance()
    assert torch.equal(again.shape[0], fit.shape[0]) and torch.equal(again.shape[1], fit.shape[1])


def test_more_views_have_smaller_faces() -> None:
    """As many pixels show each face, from 24 views on: edges shrink with the root, down to 1.2 pixels instead of 2."""
    assert fewer(3) == fewer(24) == 1
    assert fewer(48) == pytest.approx(0.5**0.5)
    assert fewer(66) == fewer(400) == pytest.approx(0.6, abs=0.01)


def test_faces_stay_while_many_views_settle() -> None:
    """With more than 24 views, faces are fixed in the last three tenths of the steps, and the error falls further."""
    views = Views.of(nr.Mesh.icosphere(3), cameras(26), 32)
    fit = DetailFit(views, *nr.icosphere(2, radius=0.9), steps=20, light="none")
    for _ in range(14):
        fit.advance()
    vertices, faces = fit.shape
    before = views.quality((vertices, faces))["iou"].mean()
    while not fit.done:
        fit.advance()
    assert torch.equal(fit.shape[1], faces) and not torch.equal(fit.shape[0], vertices)
    assert views.quality(fit.shape)["iou"].mean() > before


@pytest.mark.parametrize(("count", "first"), [(10, 12), (26, 9)])
def test_full_size_comes_before_faces_stay(count: int, first: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Full size begins after 0.6 of the steps that change faces: all 20, or 14 of many views.

    Before that, the shading of many views moves no vertices.
    """
    steps: list[tuple[int, bool]] = []
    draw = ColorModel.draw

    def record(model: ColorModel, views: Views, *rest: Any) -> Tensor:
        steps.append((max(views.size), rest[2].requires_grad))
        return draw(model, views, *rest)

    monkeypatch.setattr(ColorModel, "draw", record)
    fit = DetailFit(Views.of(nr.Mesh.icosphere(3), cameras(count), 192), *nr.icosphere(1), steps=20, light="fitted")
    while not fit.done:
        fit.advance()
    assert steps == [(96, count == 10)] * first + [(192, True)] * (20 - first)


def test_gains_scale_what_is_drawn(views: Views) -> None:
    """Photos that are twice as dark, with gains of a half: all differences of colours are half as large."""
    dark = replace(views, photos=views.photos / 2, gains=torch.full((10, 3), 0.5))  # type: ignore[operator]
    start, weights = nr.icosphere(3, radius=0.88), DetailWeights(albedo=0.0)
    plain, halved = (DetailFit(each, *start, steps=40, light="none", weights=weights) for each in (views, dark))
    plain._descent.surface.values[:, 8:11] = halved._descent.surface.values[:, 8:11] = 0.5
    assert halved.advance()["photometric"] == pytest.approx(plain.advance()["photometric"] / 2, rel=1e-5)


def test_views_of_a_pattern_match_on_the_true_surface() -> None:
    vertices, faces = nr.icosphere(4)
    colors = 0.5 + 0.4 * torch.sin(9 * vertices)
    views = Views.of(nr.Mesh(vertices, faces, vertex_colors=colors), cameras(16), 64)
    rows = [4, 12]
    true, inner, outer = (mismatch(views, rows, scale * vertices, faces) for scale in (1.0, 0.9, 1.1))
    assert 0 <= true < min(inner, outer) - 0.1  # what the other views do not show counts, too
    fit = MeshFit(views, cells=16, steps=1, detail_steps=4, texture_steps=1, light="none")
    fit.advance()
    fit.advance()
    assert fit.phase == "detail" and fit._test_rows() == rows
    assert len(fit.views) == 16 and fit._fit._count == 14  # type: ignore[union-attr]


def test_details_that_spoil_outlines_are_dropped(views: Views, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("neural_renderer.apps.fit.mesh._WORSE", -1.0)  # all are worse
    fit = MeshFit(views, cells=16, steps=1, detail_steps=3, texture_steps=1, light="none")
    fit.advance()
    outlines = fit.shape
    for _ in range(2):
        fit.advance()
    again = MeshFit(views, cells=16, steps=1, detail_steps=3, texture_steps=1, light="none")
    again.load_state_dict(fit.state_dict())
    for each in (fit, again):
        each.advance()
        assert each.phase == "detail" and each.shape[1].shape != outlines[1].shape
        with pytest.warns(UserWarning, match="match as well as before, got a mean IoU"):
            each.advance()
        assert torch.equal(each.shape[0], outlines[0]) and torch.equal(each.shape[1], outlines[1])


def test_phases_and_arguments(views: Views) -> None:
    fit = MeshFit(views, cells=16, steps=1, detail_steps=2, texture_steps=1, light="fitted", exposure=True)
    phases = []
    while not fit.done:
        fit.advance()
        phases.append(fit.phase)
    assert phases == ["shape", "detail", "detail", "texture"] and fit.views.gains is not None
    outlines = replace(views, photos=None)
    with pytest.raises(ValueError, match="light: expected None for views without photos, got 'fitted'"):
        MeshFit(outlines, light="fitted")
    with pytest.raises(ValueError, match="light: expected None for views without photos"):
        DetailFit(outlines, *nr.icosphere(1), light="none")
    with pytest.raises(ValueError, match='light: expected "fitted", "none" or None, got \'sun\''):
        DetailFit(views, *nr.icosphere(1), light="sun")  # type: ignore[arg-type]
