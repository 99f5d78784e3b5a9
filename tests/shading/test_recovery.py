"""A mesh, its material and its light from renders of it, by gradient descent."""

from __future__ import annotations

import torch

import neural_renderer as nr


def test_shape_material_and_light_are_recovered():
    """From six views of a bent ellipsoid, beginning with a grey sphere under a lamp elsewhere.

    Metal and lamp share the colour of the highlight, so that the last digits come slowly: errors are asked to fall by
    half or more. Rounding moves them by a few per cent between machines.
    """
    eye = nr.get_points_from_angles(
        3.0, torch.tensor([20.0, -20.0, 30.0, 0.0, 50.0, -40.0]), torch.arange(0.0, 360.0, 60.0)
    )
    camera = nr.Camera.look_at(eye, viewing_angle=25)
    sphere, faces = nr.icosphere(2)
    bent = sphere * torch.tensor([1.0, 0.8, 0.9]) * (1 + 0.12 * torch.sin(3 * sphere[:, :1] + 2 * sphere[:, 1:2]))
    surface = nr.sample_points((bent, faces), 10000).points.reshape(-1, 3)
    ambient = torch.zeros(9, 3)
    ambient[0], ambient[1], ambient[3] = torch.tensor([0.9, 1.1, 1.4]), 0.4, 0.3

    def drawn(vertices, base, metallic, roughness, place, strength, harmonics):
        material = nr.Material(base_color=base, metallic=metallic, roughness=roughness)
        mesh = nr.UVMesh(vertices, faces, torch.zeros(len(faces), 3, 2), torch.ones(1, 1, 3), materials=(material,))
        light = [nr.PointLight(place, strength), nr.SphericalHarmonicLight(harmonics)]
        return nr.render(mesh, camera, 40, light=light, shading="pbr", outputs=("rgb",)).rgb

    truth = [torch.tensor(value) for value in ([0.8, 0.35, 0.2], 0.2, 0.45, [1.5, 2.5, -2.0], 9.0)]
    target = drawn(bent, *truth, ambient)

    def leaf(value):
        return torch.tensor(value, requires_grad=True)

    moved, base, metallic, roughness = torch.zeros_like(sphere).requires_grad_(), leaf([0.0] * 3), leaf(0.0), leaf(0.8)
    place, strength = leaf([0.5, 2.5, -0.5]), leaf(1.6)
    harmonics = torch.zeros(9, 3).index_fill(0, torch.tensor([0]), 1.0).requires_grad_()
    rates = {0.01: [moved], 0.06: [base, metallic, roughness], 0.08: [place], 0.05: [strength, harmonics]}
    optimizer = torch.optim.Adam([{"params": params, "lr": rate} for rate, params in rates.items()])

    def guess():
        return base.sigmoid(), metallic.sigmoid(), roughness.sigmoid(), place, strength.exp()

    def errors():
        with torch.no_grad():
            apart = torch.cdist(sphere + moved, surface).min(1)[0].mean()
            return [apart, *((found - true).abs().mean() for found, true in zip(guess(), truth, strict=True))]

    before, losses = errors(), []
    for _ in range(80):
        vertices = sphere + moved
        loss = (drawn(vertices, *guess(), harmonics) - target).square().mean()
        optimizer.zero_grad()
        (loss + 1e-3 * nr.losses.laplacian(vertices, faces)).backward()
        optimizer.step()
        losses.append(loss.item())
    after = errors()
    assert losses[-1] < losses[0] / 25
    shape, color, _, rough, lamp, _ = (float(b / a) for a, b in zip(before, after, strict=True))
    assert shape < 0.5 and color < 0.7 and rough < 0.7 and lamp < 0.5
