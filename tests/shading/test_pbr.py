"""Physically based reflection, held to Mitsuba's numbers and to sums over directions."""

from __future__ import annotations

import math

import pytest
import torch
from torch.nn.functional import normalize

import neural_renderer as nr

# Reflection of the BSDF "principled" of Mitsuba 3.9.1, specular 0.5: metallic, roughness, base colour, direction to the
# eye, direction to the light, value · cosine.
MITSUBA = [
    (1.0, 0.2, (0.9, 0.6, 0.3), (-0.4347, -0.0316, 0.9000), (0.6183, 0.0900, 0.7807), (0.601027, 0.400704, 0.200381)),
    (1.0, 0.2, (0.9, 0.6, 0.3), (-0.3023, 0.7407, 0.6000), (0.3260, -0.7250, 0.6067), (41.1614, 27.5902, 14.0189)),
    (1.0, 0.2, (0.9, 0.6, 0.3), (-0.9085, -0.2909, 0.3000), (0.8920, 0.2764, 0.3577), (52.3236, 37.4785, 22.6335)),
    (1.0, 0.5, (0.9, 0.6, 0.3), (-0.2089, 0.3825, 0.9000), (0.1670, -0.4117, 0.8959), (1.23365, 0.822441, 0.411228)),
    (1.0, 0.5, (0.9, 0.6, 0.3), (0.5329, 0.5967, 0.6000), (-0.5361, -0.6636, 0.5218), (1.61442, 1.08591, 0.557408)),
    (1.0, 0.5, (0.9, 0.6, 0.3), (-0.0001, -0.9539, 0.3000), (-0.0334, 0.9302, 0.3654), (2.78849, 1.99302, 1.19755)),
    (1.0, 0.9, (0.9, 0.6, 0.3), (0.4230, -0.1053, 0.9000), (-0.6434, 0.0720, 0.7621), (0.103723, 0.0691532, 0.0345829)),
    (1.0, 0.9, (0.9, 0.6, 0.3), (0.4262, 0.6770, 0.6000), (-0.5731, -0.5232, 0.6307), (0.118537, 0.0793525, 0.0401676)),
    (1.0, 0.9, (0.9, 0.6, 0.3), (0.1569, -0.9410, 0.3000), (0.1333, 0.9249, 0.3560), (0.099089, 0.0699913, 0.0408935)),
    (0.0, 0.3, (0, 0, 0), (-0.4290, -0.0772, 0.9000), (0.1934, 0.1088, 0.9751), (0.0508655, 0.0508655, 0.0508655)),
    (0.0, 0.3, (0, 0, 0), (0.4791, -0.6407, 0.6000), (-0.5983, 0.6479, 0.4714), (0.201305, 0.201305, 0.201305)),
    (0.0, 0.3, (0, 0, 0), (-0.9523, -0.0553, 0.3000), (0.9724, 0.0610, 0.2254), (5.40788, 5.40788, 5.40788)),
    (0.0, 0.7, (0, 0, 0), (0.1836, -0.3953, 0.9000), (-0.0557, 0.4948, 0.8672), (0.0138772, 0.0138772, 0.0138772)),
    (0.0, 0.7, (0, 0, 0), (0.2566, -0.7577, 0.6000), (-0.3171, 0.8504, 0.4199), (0.0324625, 0.0324625, 0.0324625)),
    (0.0, 0.7, (0, 0, 0), (0.6120, -0.7318, 0.3000), (-0.7156, 0.6335, 0.2943), (0.0791887, 0.0791887, 0.0791887)),
]


class Beams:
    """Light from given directions, of strength 1."""

    def __init__(self, directions):
        self.directions = directions

    def beam(self, points):
        return self.directions, torch.ones(3, dtype=points.dtype)


def seen_from(views):
    """A surface that faces +z, seen from directions [1, H, W, 3]."""
    up = torch.tensor([0.0, 0.0, 1.0], dtype=views.dtype, device=views.device).expand(views.shape)
    return nr.VisibleSurface(torch.zeros_like(views), up, views, torch.ones_like(views[..., :1]))


@pytest.mark.parametrize("row", MITSUBA)
def test_it_is_that_of_mitsuba(row):
    metallic, roughness, base, eye, light, value = row
    eye, light = (normalize(torch.tensor(way, dtype=torch.float64), dim=0).view(1, 1, 1, 3) for way in (eye, light))
    base, value = (torch.tensor(rgb, dtype=torch.float64) for rgb in (base, value))
    found = nr.shade_pbr(seen_from(eye), base, metallic, roughness, [Beams(light)])[0, 0, 0] / math.pi
    if not metallic:
        # Mitsuba computes Fresnel's equations for index of refraction 1.5 where glTF has Schlick's formula.
        cosine = (eye * normalize(eye + light, dim=-1)).sum()
        other = (1.5**2 - 1 + cosine**2).sqrt()
        both = ((other - cosine) / (other + cosine)) ** 2
        turned = (cosine * (other + cosine) - 1) / (cosine * (other - cosine) + 1)
        value = value * (0.04 + 0.96 * (1 - cosine) ** 5) / (both * (1 + turned**2) / 2)
    torch.testing.assert_close(found, value, rtol=2e-5, atol=0)  # Mitsuba computes in float32 and prints 6 digits


def hemisphere(count=20000):
    """Directions about +z with density cosine / π."""
    k = torch.arange(count, dtype=torch.float64) + 0.5
    cosine, turn = (1 - k / count).sqrt(), k * math.pi * (1 + 5**0.5)
    sine = (1 - cosine**2).sqrt()
    return torch.stack((sine * turn.cos(), sine * turn.sin(), cosine), -1)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.35, 0.6, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.25])
def test_even_light_is_the_sum_of_lamps_all_around(metallic, roughness, cosine):
    """Split sum: the light of 20,000 lamps, whose weights are 1 / cosine, against ambient light of strength 1."""
    base = torch.tensor([0.9, 0.5, 0.1])
    eye = torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine]).view(1, 1, 1, 3)
    ways = hemisphere().view(1, 1, -1, 3)
    lamps = nr.shade_pbr(
        seen_from(eye.double().expand(1, 1, ways.shape[2], 3)), base.double(), metallic, roughness, [Beams(ways)]
    )
    summed = (lamps / ways[..., 2:]).mean(2)[0, 0]
    ambient = nr.shade_pbr(seen_from(eye), base, metallic, roughness, [nr.Light(1.0, 0.0)])[0, 0, 0]
    torch.testing.assert_close(ambient.double(), summed, rtol=0, atol=3e-3)  # bilinear in a table of 32 entries


def test_no_metal_reflects_more_light_than_arrives():
    cosine = torch.linspace(0, 1, 21)
    views = torch.stack(((1 - cosine**2).sqrt(), torch.zeros(21), cosine), -1).expand(1, 21, 21, 3)
    roughness = torch.linspace(0, 1, 21).view(1, 21, 1, 1)
    light = nr.shade_pbr(seen_from(views), torch.ones(3), 1.0, roughness, [nr.Light(1.0, 0.0)])
    assert (light <= 1.001).all() and (light > 0.3).all()
    # A mirror of a perfect metal keeps all of it but for masking.
    assert (nr.shade_pbr(seen_from(views[:, :1, 5:]), torch.ones(3), 1.0, 0.0, [nr.Light(1.0, 0.0)]) > 0.98).all()


def test_gradients_reach_all_inputs():
    draw = torch.Generator().manual_seed(0)
    n, v = (normalize(torch.randn(1, 2, 3, 3, generator=draw, dtype=torch.float64), dim=-1) for _ in range(2))
    n = torch.where((n * v).sum(-1, keepdim=True) < 0, -n, n)
    base = torch.rand(1, 2, 3, 3, generator=draw, dtype=torch.float64)
    metallic, roughness = torch.rand(2, 1, 2, 3, 1, generator=draw, dtype=torch.float64).clamp(0.2, 0.9).unbind(0)
    emissive = torch.rand(3, generator=draw, dtype=torch.float64)
    place = torch.tensor([0.4, 1.0, 2.0], dtype=torch.float64)
    inputs = [part.clone().requires_grad_() for part in (n, v, base, metallic, roughness, emissive, place)]

    def shaded(n, v, base, metallic, roughness, emissive, place):
        here = nr.VisibleSurface(0.1 * v, n, v, torch.ones_like(metallic))
        return nr.shade_pbr(here, base, metallic, roughness, [nr.PointLight(place, 3.0)], emissive=emissive)

    assert torch.autograd.gradcheck(shaded, inputs)


def test_extremes_are_finite(device):
    """Mirrors, grazing views, normals of the background, with gradients; they do not disturb a pixel beside them."""
    views = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.6, 0.8]], device=device)
    views = views.view(1, 1, 4, 3).requires_grad_()
    image = torch.rand(8, 16, 3, device=device).requires_grad_()
    lights = [nr.Light(0.2, 0.8, direction=(0.0, 0.0, 1.0)), nr.PointLight((0.0, 0.0, 0.0)), nr.EnvironmentLight(image)]
    for roughness in (0.0, 1.0):
        for metallic in (0.0, 1.0):
            rough = torch.tensor(roughness, device=device).requires_grad_()
            plain = seen_from(views)
            empty = nr.VisibleSurface(plain.points, torch.zeros_like(plain.normals), views, plain.sides)
            for here in (plain, empty):
                light = nr.shade_pbr(here, torch.ones(3, device=device), metallic, rough, lights)
                grads = torch.autograd.grad(light.sum(), (views, rough, image), allow_unused=True)
                assert light.isfinite().all() and all(part is None or part.isfinite().all() for part in grads)
                assert (light >= 0).all()
            ordinary = views[:, :, 3:].detach().requires_grad_()
            alone = nr.shade_pbr(seen_from(ordinary), torch.ones(3, device=device), metallic, rough, lights)
            together = nr.shade_pbr(plain, torch.ones(3, device=device), metallic, rough, lights)
            torch.testing.assert_close(together[:, :, 3:], alone, rtol=1e-5, atol=1e-6)
            (beside,) = torch.autograd.grad(together[:, :, 3:].sum(), views)
            (expected,) = torch.autograd.grad(alone.sum(), ordinary)
            torch.testing.assert_close(beside[:, :, 3:], expected, rtol=1e-4, atol=1e-5)
            assert not beside[:, :, :3].any()


def test_occlusion_holds_back_ambient_light_alone():
    here, base = seen_from(torch.tensor([0.0, 0.6, 0.8]).view(1, 1, 1, 3)), torch.tensor([0.5, 0.4, 0.3])
    ambient, lamp = nr.Light(0.5, 0.0), nr.Light(0.0, 0.8, direction=(0.0, 0.0, 1.0))
    together = nr.shade_pbr(here, base, 0.3, 0.5, [ambient, lamp], occlusion=0.25)
    alone = [nr.shade_pbr(here, base, 0.3, 0.5, [light]) for light in (ambient, lamp)]
    torch.testing.assert_close(together, 0.25 * alone[0] + alone[1])
