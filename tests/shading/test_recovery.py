"""A mesh, its material and its light from renders of it, by gradient descent."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr

SPHERE, FACES = nr.icosphere(2)
BENT = SPHERE * torch.tensor([1.0, 0.8, 0.9]) * (1 + 0.12 * torch.sin(3 * SPHERE[:, :1] + 2 * SPHERE[:, 1:2]))
METAL = [[0.3, 0.5, 0.9], 0.8, 0.3, [-1.5, 2.0, -2.0], 6.0, 0.2]
PLASTIC = [[0.8, 0.35, 0.2], 0.2, 0.45, [1.5, 2.5, -2.0], 9.0, 0.3]


def cameras(count: int) -> nr.Camera:
    elevation = torch.tensor([20.0, -20.0, 30.0, 0.0, 50.0, -40.0])[:count]
    eye = nr.get_points_from_angles(3.0, elevation, torch.arange(count) * (360.0 / count))
    return nr.Camera.look_at(eye, viewing_angle=25)


class Guess:
    """Base colour, metallic, roughness, position and strength of a lamp, and ambient light, far from any truth here."""

    def __init__(self) -> None:
        start = [0.0] * 3, 0.0, 0.4, [0.5, 2.5, -0.5], 1.6, -1.0
        self.raw = [torch.tensor(value, requires_grad=True) for value in start]

    def __call__(self) -> list[torch.Tensor]:
        base, metallic, roughness, place, strength, ambient = self.raw
        return [base.sigmoid(), metallic.sigmoid(), roughness.sigmoid(), place, strength.exp(), ambient.exp()]

    def errors(self, truth: list) -> list[float]:
        """The largest errors of the parameters; of strengths and of the position, in parts of them."""
        pairs = [(found.detach(), torch.tensor(true)) for found, true in zip(self(), truth, strict=True)]
        sizes = [1.0, 1.0, 1.0] + [float(true.norm()) for _, true in pairs[3:]]
        return [float((found - true).abs().max()) / size for (found, true), size in zip(pairs, sizes, strict=True)]


def drawn(camera, vertices, base, metallic, roughness, place, strength, ambient, size=32):
    material = nr.Material(base_color=base, metallic=metallic, roughness=roughness)
    mesh = nr.UVMesh(vertices, FACES, torch.zeros(len(FACES), 3, 2), torch.ones(1, 1, 3), materials=(material,))
    light = [nr.PointLight(place, strength), nr.Light(ambient, 0.0)]
    return nr.render(mesh, camera, size, light=light, shading="pbr", outputs=("rgb",)).rgb


@pytest.mark.parametrize("truth", [pytest.param(METAL, marks=pytest.mark.slow), PLASTIC])
def test_material_and_light_of_a_known_shape_are_recovered_exactly(truth):
    """Highlights tell metal from light, since dielectrics reflect a known share: all parameters are identifiable.

    Rounding moves each of 9216 numbers by some 1e-7, all together by 1e-5, and parameters by 1e-4 at most, since the
    smallest singular value of the Jacobian is above 0.1. Descent may end a little before.
    """
    camera, guess = cameras(3), Guess()
    target = drawn(camera, BENT, *map(torch.tensor, truth))
    assert min(guess.errors(truth)) > 0.04 and max(guess.errors(truth)) > 0.3
    options = {"history_size": 12, "tolerance_grad": 1e-9, "tolerance_change": 1e-14, "line_search_fn": "strong_wolfe"}
    optimizer = torch.optim.LBFGS(guess.raw, max_iter=200, **options)

    def loss():
        optimizer.zero_grad()
        error = 100 * (drawn(camera, BENT, *guess()) - target).square().mean()
        error.backward()
        return error

    optimizer.step(loss)
    assert max(guess.errors(truth)) < 1e-3


@pytest.mark.slow
def test_shape_material_and_light_are_recovered_closely():
    """With a shape that is only near the truth, colour and gloss are right to some hundredths, the lamp to a quarter.

    Images are sampled at pixel centres, and gradients are those of images averaged over pixels, so that the shape stays
    some hundredths away.
    """
    camera, guess, steps = cameras(6), Guess(), 160
    target = drawn(camera, BENT, *map(torch.tensor, PLASTIC), size=40)
    surface = nr.sample_points((BENT, FACES), 10000).points
    moved = torch.zeros_like(SPHERE).requires_grad_()
    rates = {0.01: [moved], 0.06: guess.raw[:3], 0.08: guess.raw[3:4], 0.05: guess.raw[4:]}
    groups = [{"params": params, "lr": rate} for rate, params in rates.items()]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.95))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps, eta_min=2e-4)
    for step in range(steps):
        vertices = SPHERE + moved
        loss = (drawn(camera, vertices, *guess(), size=40) - target).square().mean()
        optimizer.zero_grad()
        weight = 1e-3 * (1 - step / steps)
        (loss + weight * nr.losses.laplacian(vertices, FACES)).backward()
        optimizer.step()
        schedule.step()
    assert float(torch.cdist(SPHERE + moved.detach(), surface).min(1)[0].mean()) < 0.05
    color, metallic, roughness, place, strength, ambient = guess.errors(PLASTIC)
    assert color < 0.08 and metallic < 0.1 and roughness < 0.06
    assert place < 0.15 and strength < 0.35 and ambient < 0.15


@pytest.mark.slow
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
