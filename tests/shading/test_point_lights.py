"""Point and spot lights, held to their formulas."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer as nr
from neural_renderer.meshes.normals import face_normals

PLACES = torch.randn(2, 5, 7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def test_point_light_falls_with_the_square_of_the_distance():
    light = nr.PointLight((1.0, 2.0, 3.0), 4.0, (1.0, 0.5, 0.25))
    towards, rgb = light.beam(PLACES)
    between = torch.tensor([1.0, 2.0, 3.0]) - PLACES
    distance = between.norm(dim=-1, keepdim=True)
    torch.testing.assert_close(towards, between / distance)
    torch.testing.assert_close(rgb, 4 * torch.tensor([1.0, 0.5, 0.25], dtype=torch.float64) / distance**2)
    steady = nr.PointLight((1.0, 2.0, 3.0), 4.0, falloff=0).beam(PLACES)[1]
    torch.testing.assert_close(steady, torch.full_like(PLACES, 4.0))


@pytest.mark.parametrize(("inner", "outer"), [(0.0, 45.0), (20.0, 30.0), (10.0, 180.0)])
def test_spot_light_is_that_of_gltf(inner, outer):
    """The formula of KHR_lights_punctual, with its two numbers of a light."""
    axis = torch.tensor([0.3, -1.0, 0.2], dtype=torch.float64)
    light = nr.SpotLight((0.0, 2.0, 0.0), 3.0, direction=axis * 7, inner=inner, outer=outer)
    scale = 1 / max(0.001, math.cos(math.radians(inner)) - math.cos(math.radians(outer)))
    offset = -math.cos(math.radians(outer)) * scale
    towards, plain = nr.PointLight((0.0, 2.0, 0.0), 3.0).beam(PLACES)
    cosine = -(towards * axis / axis.norm()).sum(-1, keepdim=True)
    torch.testing.assert_close(light.beam(PLACES)[1], plain * (cosine * scale + offset).clamp(0, 1) ** 2)


def test_each_image_has_its_own_light():
    positions, intensities = torch.randn(2, 3).double(), torch.tensor([1.0, 2.0]).double()
    outer = torch.tensor([30.0, 60.0]).double()
    both = nr.SpotLight(positions, intensities, outer=outer).beam(PLACES)
    for number in range(2):
        light = nr.SpotLight(positions[number], float(intensities[number]), outer=outer[number])
        for all_images, one in zip(both, light.beam(PLACES[number : number + 1]), strict=True):
            torch.testing.assert_close(all_images[number], one[0])


def test_flat_light_is_that_at_the_centres_of_faces():
    corners = PLACES[:, :, :3].contiguous()
    light = nr.PointLight((0.5, 1.0, -1.0), 2.0)
    towards, rgb = light.beam(corners.mean(2))
    cosine = (-face_normals(corners) * towards).sum(-1, keepdim=True)  # `face_normals` points to the other side
    factors = light.two_sided(corners)
    torch.testing.assert_close(factors[:, 0], cosine.clamp(min=0) * rgb)
    torch.testing.assert_close(factors[:, 1], (-cosine).clamp(min=0) * rgb)
    torch.testing.assert_close(light.two_sided(corners, mirrored=True), factors.flip(1))


def test_gradients_reach_all_parameters():
    parameters = [
        torch.tensor(values, dtype=torch.float64, requires_grad=True)
        for values in ([0.2, 2.0, 0.1], 3.0, [0.2, 0.5, 1.0], [0.1, -1.0, 0.2], 20.0, 50.0)
    ]
    points = (0.3 * PLACES[:1, :2]).requires_grad_()

    def lit(points, position, intensity, color, direction, inner, outer):
        return nr.SpotLight(position, intensity, color, 2.0, direction, inner, outer).beam(points)

    assert torch.autograd.gradcheck(lit, (points, *parameters))


def test_a_light_on_a_point_is_finite():
    points = torch.zeros(1, 1, 1, 3, requires_grad=True)
    towards, rgb = nr.PointLight((0.0, 0.0, 0.0)).beam(points)
    (towards.sum() + rgb.sum()).backward()
    assert towards.isfinite().all() and rgb.isfinite().all() and points.grad.isfinite().all()


@pytest.mark.parametrize(
    ("light", "message"),
    [
        (nr.PointLight((0.0, 1.0)), r"position: expected shape \[3\] or \[B, 3\], got \[2\]"),
        (nr.PointLight(color=torch.ones(3, 3)), "color: expected a batch of 1 or 2 like points, got 3"),
        (nr.PointLight(intensity=torch.ones(3)), "intensity: expected a batch of 1 or 2 like points, got 3"),
        (nr.SpotLight(inner=30, outer=20), "outer: expected an angle above inner, at most 180, got 20 and 30"),
    ],
)
def test_messages(light, message):
    with pytest.raises(ValueError, match=message):
        light.beam(PLACES)


@pytest.mark.parametrize(
    ("lamp", "message"),
    [
        (nr.SpotLight(direction=(0.0, 0.0, 0.0)), "direction: expected a vector of positive length"),
        (nr.SpotLight(outer=200.0), "outer: expected an angle above inner, at most 180"),
        (nr.SpotLight(inner=-5.0), "outer: expected an angle above inner"),
    ],
)
def test_cones_that_are_none(lamp, message):
    with pytest.raises(ValueError, match=message):
        lamp.beam(torch.zeros(1, 3))
