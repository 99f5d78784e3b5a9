"""Light in spherical harmonics, held to sums over directions."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer as nr
from neural_renderer.shading.spherical_harmonics import harmonics


def directions(count=20000):
    """Evenly spread over the sphere."""
    k = torch.arange(count, dtype=torch.float64) + 0.5
    z, turn = 1 - 2 * k / count, k * math.pi * (1 + 5**0.5)
    return torch.stack(((1 - z * z).sqrt() * turn.cos(), (1 - z * z).sqrt() * turn.sin(), z), -1)


def test_harmonics_are_orthonormal():
    """Up to the error of the sum over 20,000 directions."""
    values = torch.stack(harmonics(directions()), -1)
    torch.testing.assert_close(
        4 * math.pi * values.T @ values / len(values),
        torch.eye(9, dtype=torch.float64),
        rtol=0,
        atol=1e-3,
    )


def test_light_is_what_falls_on_a_matt_surface():
    """A broad lamp: radiance that varies as a polynomial of degree 2 is kept exactly."""
    way = directions()
    radiance = (1 + 0.5 * way[:, :1] - 0.3 * way[:, 2:] + 0.4 * way[:, 1:2] * way[:, 2:]) * torch.tensor([1.0, 0.5, 0])
    coefficients = 4 * math.pi * torch.stack(harmonics(way)) @ radiance / len(way)
    normals = directions(50)[None]
    falls = (normals[0] @ way.T).clamp(min=0) @ radiance * 4 / len(way)  # the mean over the sphere, times 4π / π
    found = nr.SphericalHarmonicLight(coefficients).on(normals)[0]
    torch.testing.assert_close(found, falls, rtol=0, atol=2e-3)


def test_even_light_draws_the_colours_themselves(device):
    mesh = nr.Mesh.icosphere(3).to(device)
    even = torch.zeros(9, 3, device=device)
    even[0] = math.sqrt(4 * math.pi)
    camera = nr.Camera.look_at((0.0, 1.0, -2.7))
    plain = nr.render(mesh, camera, 32, light=None).rgb
    torch.testing.assert_close(nr.render(mesh, camera, 32, light=nr.SphericalHarmonicLight(even)).rgb, plain)
    half = nr.Light(ambient=0.25, directional=0.0)
    torch.testing.assert_close(nr.render(mesh, camera, 32, light=[half, half]).rgb, plain / 2)


def test_the_lit_side_agrees_with_a_lamp():
    """Light from above in both forms: bright and dark on the same sides of the same faces."""
    corners = torch.randn(2, 7, 3, 3, generator=torch.Generator().manual_seed(0))
    coefficients = torch.zeros(9, 3)
    coefficients[0], coefficients[1] = 1.0, 1.5
    for mirrored in (False, True):
        soft = nr.SphericalHarmonicLight(coefficients).two_sided(corners, mirrored)
        lamp = nr.Light(0.0, 1.0).two_sided(corners, mirrored) - nr.Light(0.0, 1.0).two_sided(corners.flip(2), mirrored)
        assert ((soft[:, 0] - soft[:, 1]) * lamp[:, 0] >= 0).all() and (soft >= 0).all()


def test_coefficients_are_found_from_an_image():
    mesh, camera = nr.Mesh.icosphere(3), nr.Camera.look_at((0.0, 1.0, -2.7))
    truth = torch.rand(9, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([2.0] + [0.3] * 8)[:, None]
    target = nr.render(mesh, camera, 64, light=nr.SphericalHarmonicLight(truth)).rgb.detach()
    guess = torch.tensor([1.0] + [0.0] * 8)[:, None].repeat(1, 3).requires_grad_()
    optimizer = torch.optim.Adam([guess], lr=0.1)
    losses = []
    for _ in range(80):
        loss = (nr.render(mesh, camera, 64, light=nr.SphericalHarmonicLight(guess)).rgb - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss))
    assert losses[-1] < losses[0] / 40  # half of the sphere is seen, so not all of it is told apart


def test_what_does_not_fit():
    mesh, camera = nr.Mesh.icosphere(1), nr.Camera.look_at((0.0, 0.0, -2.7))
    with pytest.raises(ValueError, match=r"coefficients: expected shape \[9, 3\] or \[B, 9, 3\]"):
        nr.render(mesh, camera, 16, light=nr.SphericalHarmonicLight(torch.zeros(4, 3)))
    with pytest.raises(TypeError, match="light: expected a Light, PointLight, …, a list of them or None, got str"):
        nr.render(mesh, camera, 16, light=[nr.Light(), "lamp"])
    with pytest.raises(ValueError, match="light: expected at least one"):
        nr.render(mesh, camera, 16, light=[])
