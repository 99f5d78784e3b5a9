"""Shadows: where geometry says they are, how soft, and what gets gradients."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer as nr

RADIUS, HEIGHT = 0.5, 1.5


def ball_over_ground() -> nr.Mesh:
    vertices, faces = nr.icosphere(4, RADIUS)
    ground = torch.tensor([[-4.0, 0.0, -4.0], [4.0, 0.0, -4.0], [4.0, 0.0, 4.0], [-4.0, 0.0, 4.0]])
    corners = torch.tensor([[0, 1, 2], [0, 2, 3]])
    points = torch.cat((vertices + torch.tensor([0.0, HEIGHT, 0.0]), ground))
    return nr.Mesh(points, torch.cat((faces, corners + len(vertices))))


def ground(count: int = 400) -> torch.Tensor:
    """Random points of the ground."""
    at = torch.rand(1, count, 2, generator=torch.Generator().manual_seed(0)) * 5 - 2.5
    return torch.stack((at[..., 0], torch.zeros(1, count), at[..., 1]), -1)


@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (0.6, 1.0, -0.3)])
def test_a_directional_light_throws_the_outline_of_a_ball(device, direction) -> None:
    """A point is dark if its ray to the light passes the ball's centre within the radius."""
    lamp = nr.ShadowedLight(nr.Light(direction=direction), ball_over_ground().to(device), size=512, softness=1.0)
    towards = torch.nn.functional.normalize(torch.tensor(direction), dim=0)
    arm = torch.tensor([0.0, HEIGHT, 0.0]) - ground()
    distance = (arm - (arm @ towards)[..., None] * towards).norm(dim=-1)
    found = lamp.visibility(ground().to(device)).cpu()[..., 0]
    # Soft within a pixel of the map, 0.025 units wide, and as much for its position and the ball's facets.
    edge = (distance - RADIUS).abs() < 0.06
    torch.testing.assert_close(found[~edge], (distance > RADIUS).float()[~edge])
    assert ((found > 0) & (found < 1)).any()


def test_a_spot_light_throws_a_cone(device) -> None:
    eye = torch.tensor([0.5, 4.0, 0.0])
    light = nr.SpotLight(eye.tolist(), 9.0, direction=(-0.1, -1.0, 0.0), inner=20.0, outer=35.0)
    lamp = nr.ShadowedLight(light, ball_over_ground().to(device), size=512, softness=1.0)
    way = torch.nn.functional.normalize(eye - ground(), dim=-1)
    arm = torch.tensor([0.0, HEIGHT, 0.0]) - ground()
    distance = (arm - (arm * way).sum(-1, keepdim=True) * way).norm(dim=-1)
    towards, rgb = lamp.beam(ground().to(device))
    plain = light.beam(ground().to(device))
    torch.testing.assert_close(towards, plain[0])
    share = (rgb / plain[1].clamp(min=1e-9)).cpu()[..., 0]
    edge = ((distance - RADIUS).abs() < 0.06) | (plain[1].cpu()[..., 0] < 1e-6)
    torch.testing.assert_close(share[~edge], (distance > RADIUS).float()[~edge])


@pytest.mark.parametrize("softness", [0.5, 2.0, 6.0])
def test_softness_is_half_the_width_of_an_edge(device, softness) -> None:
    """Across the shadow's edge of a pane, visibility rises linearly over two times ``softness`` pixels."""
    pane = torch.tensor([[-2.0, 1.0, -2.0], [0.013, 1.0, -2.0], [0.013, 1.0, 2.0], [-2.0, 1.0, 2.0]])
    below = pane * torch.tensor([1.0, 0.0, 1.0]) * 1.2 + torch.tensor([0.5, 0.0, 0.0])
    mesh = nr.Mesh(torch.cat((pane, below)), torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])).to(device)
    lamp = nr.ShadowedLight(nr.Light(direction=(0.0, 1.0, 0.0)), mesh, size=512, softness=softness)
    low, high = torch.aminmax(mesh.vertices, dim=0)
    pixel = float((high - low).norm()) / 512
    x = torch.linspace(-1.5, 1.5, 301) * 2 * softness * pixel
    points = torch.stack((0.013 + x, torch.zeros(301), torch.zeros(301)), -1)[None]
    found = lamp.visibility(points.to(device))[0, :, 0].cpu()
    expected = (0.5 + x / (2 * softness * pixel)).clamp(0, 1)
    # The edge lies at a border of pixels of the map, up to half a pixel away.
    assert (found - expected).abs().max() <= 0.5 / (2 * softness) + 1e-4
    assert (found[1:] >= found[:-1] - 1e-6).all()


def test_surfaces_do_not_shadow_themselves(device) -> None:
    """A ball alone, and a ground alone under light that grazes it."""
    vertices, faces = nr.icosphere(4)
    direction = torch.tensor([0.3, 1.0, 0.5])
    lamp = nr.ShadowedLight(nr.Light(direction=direction), nr.Mesh(vertices, faces).to(device), size=512)
    facing = vertices @ torch.nn.functional.normalize(direction, dim=0)
    assert (lamp.visibility(vertices[facing > 0.2][None].to(device)) > 0.99999).all()
    assert (lamp.visibility(vertices[facing < -0.2][None].to(device)) < 1e-5).all()
    flat = nr.Mesh(ball_over_ground().vertices[-4:], torch.tensor([[0, 1, 2], [0, 2, 3]]))
    low = nr.ShadowedLight(nr.Light(direction=(1.0, 0.2, 0.0)), flat.to(device), size=512)
    assert (low.visibility(ground().to(device)) > 0.99999).all()


SUN, LAMP = nr.Light(direction=(0.5, 0.7, 0.6)), nr.SpotLight((5.0, 7.0, 6.0), direction=(-5.0, -7.0, -6.0), outer=15)


@pytest.mark.parametrize("light", [SUN, LAMP])
@pytest.mark.parametrize("softness", [0.5, 1.5, 4.0])
def test_edges_of_bodies_do_not_shadow_themselves(device, light, softness) -> None:
    """Up to the edges of a cube that the light just sees, its lit sides have no dark lines."""
    vertices, faces = nr.cube()
    vertices = vertices / vertices.abs().max()
    lamp = nr.ShadowedLight(light, nr.Mesh(vertices, faces).to(device), size=512, softness=softness)
    across = torch.linspace(-1, 1, 201)
    lit = torch.stack(torch.broadcast_tensors(across[:, None], torch.tensor(1.0), across), -1).reshape(-1, 3)
    sides = torch.stack([lit.roll(shift, 1) for shift in range(3)])
    assert (lamp.visibility(sides.reshape(1, -1, 3).to(device)) > 0.9999).all()


def test_gradients_reach_light_and_surface_but_not_the_shadow() -> None:
    intensity = torch.tensor(0.7, requires_grad=True)
    mesh = ball_over_ground()
    lamp = nr.ShadowedLight(nr.Light(0.2, intensity, direction=(0.3, 1.0, 0.0)), mesh, size=128)
    camera = nr.Camera.look_at((0.0, 4.0, -4.0), viewing_angle=35)
    images = nr.render(mesh, camera, 32, light=lamp, shading="smooth")
    lit = nr.render(mesh, camera, 32, light=lamp.light, shading="smooth")
    assert (images.rgb <= lit.rgb + 1e-6).all() and (images.rgb < lit.rgb - 0.1).any()
    images.rgb.sum().backward()
    assert float(intensity.grad) > 0
    points = ground().requires_grad_()
    assert not lamp.visibility(points).requires_grad


def test_flat_shading_has_the_shadow_of_each_face() -> None:
    lamp = nr.ShadowedLight(nr.Light(0.25, 0.5), ball_over_ground(), size=128)
    small = torch.tensor([[[-0.1, 0.0, -0.1], [0.1, 0.0, -0.1], [0.0, 0.0, 0.1]]])
    light = lamp.two_sided(torch.stack((small, small + torch.tensor([2.0, 0.0, 0.0])), 1))
    torch.testing.assert_close(light[0, :, 0], torch.full((2, 3), 0.25))
    torch.testing.assert_close(light[0, :, 1].amax(0), torch.full((3,), 0.75))


def test_lights_of_a_batch_have_maps_of_their_own() -> None:
    directions = torch.tensor([[0.0, 1.0, 0.0], [0.6, 1.0, -0.3]])
    mesh, points = ball_over_ground(), ground()
    both = nr.ShadowedLight(nr.Light(direction=directions), mesh, size=64).visibility(points.expand(2, -1, -1))
    for one, direction in zip(both, directions, strict=True):
        alone = nr.ShadowedLight(nr.Light(direction=direction), mesh, size=64).visibility(points)
        torch.testing.assert_close(one, alone[0], rtol=0, atol=2e-2)


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("light: expected a Light or a SpotLight, got PointLight", {"light": nr.PointLight()}),
        ("light: expected an outer angle of at most 85 degrees", {"light": nr.SpotLight(outer=120.0)}),
        ("size: expected", {"size": 0}),
        ("softness: expected at least 0.5", {"softness": 0.1}),
        ("bias: expected", {"bias": -1.0}),
        ("mesh: expected", {"mesh": "ball"}),
    ],
)
def test_what_does_not_fit(message, arguments) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        nr.ShadowedLight(**{"light": nr.Light(), "mesh": ball_over_ground(), "size": 16, **arguments})
    assert math.isfinite(float(nr.ShadowedLight(nr.Light(), ball_over_ground(), 16).visibility(ground()).sum()))
