"""Faces that are nearly edge on, tiny, or collapsed: images and gradients are finite wherever they are drawn."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer as nr
from tests.paths import DATA

ALL = pytest.mark.parametrize(
    ("gradient", "anti_aliasing", "orthographic"),
    [(g, a, o) for g in ("nmr", "edge") for a in (False, True) for o in (False, True)],
)


def assert_finite(vertices, faces, eye, size, gradient, anti_aliasing, orthographic):
    """Images and all gradients, of faces of random colours under light; returns the images."""
    camera = nr.Camera.look_at(eye, up=(0, 1, 0) if eye[1] == 0 else (0, 0, 1), orthographic=orthographic)
    random = torch.Generator().manual_seed(0)
    vertices = vertices.clone().requires_grad_()
    textures = torch.rand(len(faces), 2, 2, 2, 3, generator=random).to(vertices.device).requires_grad_()
    options = {"anti_aliasing": anti_aliasing, "gradient": gradient}
    images = nr.render((vertices, faces, textures), camera, size, near=0.1, far=100.0, **options)
    pulls = [torch.randn(image.shape, generator=random).to(image.device) for image in images]
    sum((image * pull).sum() for image, pull in zip(images, pulls, strict=True)).backward()
    assert all(image.isfinite().all() for image in images)
    assert images.depth.min() >= 0.1 and images.depth.max() <= 100
    assert vertices.grad.isfinite().all() and textures.grad.isfinite().all()
    return images


def globe(rows: int, columns: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A sphere of latitudes and longitudes, whose faces at the poles have no area, or nearly none."""
    t, p = torch.linspace(0, math.pi, rows + 1)[:, None], torch.linspace(0, 2 * math.pi, columns + 1)[:-1]
    vertices = torch.stack((t.sin() * p.cos(), t.cos() + 0 * p, t.sin() * p.sin()), -1).reshape(-1, 3)
    i, j = torch.arange(rows)[:, None] * columns, torch.arange(columns)
    a, b = (i + j).reshape(-1), (i + (j + 1) % columns).reshape(-1)
    faces = (torch.stack((a, a + columns, b), 1), torch.stack((b, a + columns, b + columns), 1))
    return vertices, torch.cat(faces)


@ALL
@pytest.mark.parametrize("pole", [-2.7, 2.7])
def test_a_globe_from_its_poles(device, pole, gradient, anti_aliasing, orthographic):
    vertices, faces = (t.to(device) for t in globe(15, 16))
    for size in (33, 65):
        images = assert_finite(vertices, faces, (0, pole, 0), size, gradient, anti_aliasing, orthographic)
        assert images.alpha[0, size // 2, size // 2] == 1


@ALL
@pytest.mark.parametrize("size", [1e-3, 1e-5, 1e-8, 1e-15, 1e-30, 0.0])
def test_a_mesh_that_has_collapsed(device, size, gradient, anti_aliasing, orthographic):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    for side in (1, 33):
        assert_finite(size * vertices, faces, (0, 0, -2.7), side, gradient, anti_aliasing, orthographic)


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_a_car_from_its_end(device, gradient):
    """Its sides are planes that are seen edge on."""
    mesh = nr.Mesh.load(DATA / "kenney" / "sedan.obj")
    vertices, faces = mesh.vertices.detach().to(device), mesh.faces.to(device)
    low, high = vertices.amin(0), vertices.amax(0)
    vertices = (vertices - (low + high) / 2) / ((high - low).max() / 2)
    assert_finite(vertices, faces, (0, 0, 2.7), 255, gradient, False, True)
