"""Phong and Blinn-Phong, held to published formulas."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import normalize

import neural_renderer as nr


def surface(count=40, dtype=torch.float64):
    draw = torch.Generator().manual_seed(0)
    points, normals, views = torch.randn(3, 2, 5, count, 3, generator=draw, dtype=dtype).unbind(0)
    ones = torch.ones(2, 5, count, 1, dtype=dtype)
    return nr.VisibleSurface(points, normalize(normals, dim=-1), normalize(views, dim=-1), ones)


def published(points, normals, eye, texels, light, ambient, diffuse, specular, shininess):
    """Phong shading as PyTorch3D documents it: (ambient + diffuse) · texels + specular, one point at a time.

    Diffuse: color · relu(n · l). Specular: with r = −l + 2 (n · l) n and v towards the camera, color ·
    relu(v · r)^shininess where n · l > 0. Its point lights do not weaken with distance.
    """
    colors = torch.empty_like(points)
    for index in torch.cartesian_prod(*map(torch.arange, points.shape[:-1])).tolist():
        p, n, t = (value[tuple(index)] for value in (points, normals, texels))
        towards = (light - p) / (light - p).norm()
        view = (eye - p) / (eye - p).norm()
        cosine = n @ towards
        reflected = 2 * cosine * n - towards
        strength = max(float(view @ reflected), 0.0) ** shininess if cosine > 0 else 0.0
        colors[tuple(index)] = (ambient + diffuse * max(float(cosine), 0.0)) * t + specular * strength
    return colors


@pytest.mark.parametrize("shininess", [1.0, 10.0, 64.0])
def test_it_is_that_of_pytorch3d(shininess):
    place, eye = torch.tensor([0.5, 1.5, -2.0]).double(), torch.tensor([0.0, 0.3, -3.0]).double()
    plain = surface()
    seen = nr.VisibleSurface(plain.points, plain.normals, normalize(eye - plain.points, dim=-1), plain.sides)
    texels = torch.rand(plain.points.shape, dtype=torch.float64)
    ambient, diffuse, specular = (
        torch.tensor(rgb).double() for rgb in ((0.1, 0.2, 0.3), (0.5, 0.4, 0.3), (0.2, 0.1, 0.3))
    )
    lights = [nr.Light(1.0, 0.0, ambient_color=ambient), nr.PointLight(place, 1.0, diffuse, falloff=0)]
    found = nr.shade_phong(seen, texels, lights, specular / diffuse, shininess)
    wanted = published(plain.points, plain.normals, eye, texels, place, ambient, diffuse, specular, shininess)
    torch.testing.assert_close(found, wanted)


def test_blinn_uses_the_halfway_vector():
    seen, light = surface(), nr.PointLight((0.5, 1.5, -2.0), 3.0)
    towards, rgb = light.beam(seen.points)
    halfway = (towards + seen.views) / (towards + seen.views).norm(dim=-1, keepdim=True)
    lit = (seen.normals * towards).sum(-1, keepdim=True) > 0
    shine = (seen.normals * halfway).sum(-1, keepdim=True).clamp(min=0) ** 20 * lit
    white = torch.ones_like(seen.points)
    found = nr.shade_phong(seen, white, [light], 0.4, 20.0, halfway=True) - nr.shade_diffuse(seen, white, [light])
    torch.testing.assert_close(found, 0.4 * rgb * shine)


@pytest.mark.parametrize("halfway", [False, True])
def test_gradients(halfway):
    seen = surface(3)
    albedo = torch.rand(seen.points.shape, dtype=torch.float64, requires_grad=True)
    specular = torch.rand(3, dtype=torch.float64, requires_grad=True)
    shininess = torch.tensor(8.0, dtype=torch.float64, requires_grad=True)
    normals = seen.normals.clone().requires_grad_()

    def shaded(albedo, specular, shininess, normals):
        here = nr.VisibleSurface(seen.points, normals, seen.views, seen.sides)
        return nr.Phong(specular, shininess, halfway).shade(here, albedo, [nr.PointLight((0.5, 1.5, -2.0))])

    assert torch.autograd.gradcheck(shaded, (albedo, specular, shininess, normals))


def test_each_image_has_its_own_gloss():
    seen, white = surface(), torch.ones(2, 5, 40, 3, dtype=torch.float64)
    light = [nr.PointLight((0.5, 1.5, -2.0))]
    specular, shininess = torch.rand(2, 3).double(), torch.tensor([5.0, 30.0]).double()
    both = nr.Phong(specular, shininess).shade(seen, white, light)
    for number in range(2):
        one = nr.Phong(specular[number], shininess[number]).shade(seen, white, light)
        torch.testing.assert_close(both[number], one[number])
    with pytest.raises(ValueError, match="shininess: expected a batch of 1 or 2 like the images, got 3"):
        nr.Phong(shininess=torch.ones(3)).shade(seen, white, light)
