"""Photographs of different exposure and white balance."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.fit import MeshFit, Views
from neural_renderer.apps.fit.colors.exposure import estimate_exposure, match_gains, without_vignetting


def painted() -> nr.Mesh:
    """Make a torus coloured by position."""
    vertices, faces = nr.torus(0.7, 0.28, 32, 16)
    cubes = (vertices[faces.long()].mean(1) * 0.3 + 0.45)[:, None, None, None].expand(-1, 2, 2, 2, -1)
    return nr.Mesh(vertices, faces, cubes)


def shape_of(mesh: nr.Mesh) -> tuple[Tensor, Tensor, Tensor]:
    return mesh.vertices.detach(), mesh.faces.long(), mesh.textures.detach()


@pytest.fixture(scope="module")
def even() -> Views:
    elevation = torch.tensor([75.0, 15.0, -40.0, 45.0]).repeat(3)
    eyes = nr.get_points_from_angles(3.2, elevation, torch.arange(12) * 30.0)
    return Views.of(painted(), nr.Camera.look_at(eyes, viewing_angle=22.0), 64)


@pytest.fixture(scope="module")
def gains() -> Tensor:
    """Make gains of half to double, with the geometric mean 1 in each channel."""
    values = 0.25 * torch.randn(12, 3, generator=torch.Generator().manual_seed(0))
    return (values - values.mean(0)).exp()


@pytest.fixture(scope="module")
def uneven(even: Views, gains: Tensor) -> Views:
    return replace(even, photos=(even.photos * gains[:, :, None, None]).clamp(max=1))


def test_gains_of_a_known_shape(even: Views, uneven: Views, gains: Tensor) -> None:
    vertices, faces, _ = shape_of(painted())
    # Views show different parts of a patch, whose colours differ by a fiftieth of their range.
    assert (estimate_exposure(uneven, vertices, faces)[0] / gains).log().abs().max() < 0.02
    assert estimate_exposure(even, vertices, faces)[0].log().abs().max() < 0.02
    # Highlights in single views are outliers.
    shiny = uneven.photos.clone()
    shiny[::3, :, 24:30, 20:44] = 0.9 * uneven.masks[::3, None, 24:30, 20:44]
    assert (estimate_exposure(replace(uneven, photos=shiny), vertices, faces)[0] / gains).log().abs().max() < 0.05


def test_vignetting(uneven: Views, gains: Tensor) -> None:
    """Corners of half the brightness are found beside gains, and undone."""
    vertices, faces, _ = shape_of(painted())
    assert abs(estimate_exposure(uneven, vertices, faces)[1]) < 0.02
    place = (torch.arange(64) - 31.5) / 32
    falloff = 0.5 ** ((place.square() + place[:, None].square()) / 2)
    dark = replace(uneven, photos=uneven.photos * falloff)  # type: ignore[operator]
    found, vignetting = estimate_exposure(dark, vertices, faces)
    assert abs(vignetting - math.log(0.5)) < 0.05
    assert (found / gains).log().abs().max() < 0.03
    flat = without_vignetting(dark, math.log(0.5)).photos
    torch.testing.assert_close(flat, uneven.photos, rtol=1e-5, atol=1e-6)


def test_gauge_and_views_that_share_nothing(even: Views, uneven: Views) -> None:
    """Gains have the geometric mean 1; views from opposite sides of a ball tell nothing about each other."""
    vertices, faces, _ = shape_of(painted())
    for factor in (1.0, 0.5):
        found = estimate_exposure(replace(uneven, photos=factor * uneven.photos), vertices, faces)[0]  # type: ignore[operator]
        torch.testing.assert_close(found.log().mean(0), torch.zeros(3), rtol=0, atol=1e-5)
    ball = nr.Mesh.icosphere(3)
    eyes = torch.tensor([[0.0, 0.0, -3.0], [0.0, 0.0, 3.0]])
    apart = Views.of(ball, nr.Camera.look_at(eyes, viewing_angle=22.0), 32)
    found, vignetting = estimate_exposure(apart, ball.vertices.detach(), ball.faces)
    assert torch.equal(found, torch.ones(2, 3)) and vignetting == 0


def test_views_with_gains_draw_with_them(even: Views, uneven: Views, gains: Tensor) -> None:
    shape = shape_of(painted())
    exposed = replace(uneven, gains=gains)
    plain = even.draw(shape, ("rgb", "normal"))
    drawn = exposed[2:4].draw(shape, ("rgb", "normal"))
    torch.testing.assert_close(drawn.rgb, plain.rgb[2:4] * gains[2:4, :, None, None])
    assert torch.equal(drawn.normal, plain.normal[2:4])
    assert exposed.normalized(torch.zeros(3), 2.0).gains is gains
    # Photos that are cut off at 1 are darker than their gains say.
    unclipped = replace(even, photos=even.photos * gains[:, :, None, None])  # type: ignore[operator]
    torch.testing.assert_close(match_gains(unclipped, shape).gains, gains, rtol=1e-4, atol=0)
    with pytest.raises(ValueError, match=r"gains: expected shape \[12, 3\]"):
        replace(even, gains=gains[:3])


def test_fit_with_exposure(uneven: Views, gains: Tensor) -> None:
    """Gains are found again, the texture is not blotchy, and a resumed fit goes on in the same way."""
    options = {"steps": 10, "texture_steps": 6, "cells": 20, "texture_size": 3}
    fits = [MeshFit(uneven, exposure=exposure, **options) for exposure in (False, True)]  # type: ignore[arg-type]
    for fit in fits:
        while not fit.done:
            if fit.phase == "texture" and fit.step == 4:
                state = copy.deepcopy(fit.state_dict())
            fit.advance()
    plain, exposed = fits
    assert plain.views.gains is None and exposed.views.gains is not None
    assert (exposed.views.gains / gains).log().abs().mean() < 0.05
    plain_psnr, psnr = (fit.views.quality(fit.shape)["psnr"].mean() for fit in fits)
    assert psnr > plain_psnr + 1
    again = MeshFit(uneven, exposure=True, **options)  # type: ignore[arg-type]
    again.load_state_dict(state)
    while not again.done:
        again.advance()
    assert torch.equal(again.shape[2], exposed.shape[2])
    with pytest.raises(ValueError, match="exposure: expected False for views without photos"):
        MeshFit(replace(uneven, photos=None), exposure=True)
    colored = MeshFit(uneven, exposure=True, color_from=0.5, cells=16, steps=2)
    assert colored.views.gains is not None
    colored.advance()
    colored.advance()
