"""Light: the formula, its side, unchanged arguments, gradients, small and degenerate faces."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

import neural_renderer as nr
from neural_renderer.compat.first_packages.lighting import lighting
from neural_renderer.meshes.normals import face_normals
from neural_renderer.shading.lights import Light
from tests.rounding import EPS, rounding


def corners(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, 3, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def face_light(faces: torch.Tensor, *light, **named) -> torch.Tensor:
    """The light on each face, as `lighting` multiplies a white texture by it."""
    return lighting(faces, faces.new_ones(*faces.shape[:2], 1, 1, 1, 3), *light, **named)[:, :, 0, 0, 0]


def test_formula_on_random_faces():
    """Batch 3 and, with one face, B·F = 3: where a cross product without a named dimension goes wrong."""
    for faces in (corners(3, 1), corners(3, 4)):
        ambient, directional = torch.tensor([0.1, 0.2, 0.3]), 0.7
        color, direction = (0.9, 0.5, 0.1), corners(1, seed=5)[0]
        found = face_light(faces, ambient, directional, color, (1, 0.5, 0.25), direction)
        for b in range(3):
            for f in range(faces.shape[1]):
                v0, v1, v2 = faces[b, f].numpy()
                n = np.cross(v0 - v1, v2 - v1)
                lit = max(n @ direction[b].numpy() / np.linalg.norm(n), 0)
                expected = ambient[b].item() * np.array(color) + directional * lit * np.array((1, 0.5, 0.25))
                # Numbers of Python are in float64, but for those that come as tensors of float32.
                np.testing.assert_allclose(found[b, f], expected, rtol=16 * EPS)


def test_lighting_multiplies_into_new_textures():
    """The published PyTorch port darkened the caller's textures at every call."""
    faces, textures = corners(2, 3).float(), torch.rand(2, 3, 2, 2, 2, 3, requires_grad=True)
    before = textures.detach().clone()
    lit = lighting(faces, textures)
    torch.testing.assert_close(lit, before * face_light(faces)[:, :, None, None, None, :])
    assert torch.equal(textures, before) and lit.shape == textures.shape
    assert torch.equal(lighting(faces, textures, 1, 0), before)


@pytest.mark.parametrize("mirrored", [False, True])
def test_two_sides(mirrored):
    # Seen from above (+y) in a right-handed world the corners run counter-clockwise; the light comes from above.
    face = torch.tensor([[[[0.0, 0, 0], [0, 0, 1.0], [1.0, 0, 0]]]])
    light = Light(0.25, 0.5, directional_color=(1, 1, 0)).two_sided(face, mirrored)
    assert light.shape == (1, 2, 1, 3)
    top, bottom = [0.75, 0.75, 0.25], [0.25, 0.25, 0.25]
    assert light[0, :, 0].tolist() == ([bottom, top] if mirrored else [top, bottom])


def test_two_sides_are_the_old_light_of_a_face_and_of_its_reverse():
    faces = corners(2, 5)
    light = Light(0.3, 0.6, (1, 0, 1), (0, 1, 1), (0.6, 0.8, 0.0))
    old = [face_light(f, 0.3, 0.6, (1, 0, 1), (0, 1, 1), (0.6, 0.8, 0.0)) for f in (faces, faces.flip(2))]
    torch.testing.assert_close(light.two_sided(faces, mirrored=True), torch.stack(old, dim=1))


def test_small_faces_are_as_bright_as_large_ones():
    face = corners(1, 4)
    # Two arms of a face, rounded before they are crossed: a few roundings, unless a face is a sliver.
    torch.testing.assert_close(face_light((face * 1e-4).float()), face_light(face.float()), **rounding(64))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_degenerate_faces_are_finite(dtype):
    flat = torch.zeros(1, 3, 3, 3, dtype=dtype)
    flat[0, 1] = torch.tensor([[0, 0, 0], [1, 1, 1], [2, 2, 2]])
    flat[0, 2] = torch.tensor([[0, 0, 0], [1e-20, 0, 0], [0, 1e-20, 0]])
    flat.requires_grad_()
    light = face_light(flat)
    light.sum().backward()
    assert light.isfinite().all() and flat.grad.isfinite().all()
    assert (face_normals(flat).norm(dim=-1) <= 1.001).all()


def test_gradients_are_right():
    inputs = [
        corners(2, 3),
        torch.rand(2, 3, 2, 2, 2, 3, dtype=torch.float64),
        torch.tensor(0.4, dtype=torch.float64),
        torch.tensor([0.5, 0.6], dtype=torch.float64),
        torch.tensor([0.5, 0.6, 0.7], dtype=torch.float64),
        torch.rand(2, 3, dtype=torch.float64),
        torch.tensor([0.1, 0.9, 0.2], dtype=torch.float64),
    ]
    assert gradcheck(lighting, [v.requires_grad_() for v in inputs])


def test_mistakes_are_named():
    with pytest.raises(ValueError, match="textures: expected shape"):
        lighting(corners(2, 3), torch.rand(2, 4, 2, 2, 2, 3))
    for size in ((0, 0, 0), (2, 3, 2)):
        with pytest.raises(ValueError, match=r"textures: expected cubes .* T at least 1"):
            lighting(corners(2, 3), torch.rand(2, 3, *size, 3))
    with pytest.raises(ValueError, match="faces: expected finite numbers, got 1 "):
        lighting(torch.tensor([1.0] * 8 + [np.nan]).view(1, 1, 3, 3), torch.rand(1, 1, 2, 2, 2, 3))
    with pytest.raises(ValueError, match="textures: expected finite numbers"):
        lighting(corners(2, 3), torch.full((2, 3, 2, 2, 2, 3), np.inf))
    with pytest.raises(ValueError, match="ambient: expected a finite number, got nan"):
        lighting(corners(2, 3), torch.rand(2, 3, 2, 2, 2, 3), np.nan)
    with pytest.raises(ValueError, match="direction: expected a batch of 1 or 2"):
        face_light(corners(2, 3), direction=torch.ones(3, 3))
    with pytest.raises(ValueError, match=r"ambient_color: expected shape \[3\] or \[B, 3\]"):
        Light(ambient_color=(1, 1)).two_sided(corners(2, 3))


def test_it_compiles_in_one_graph():
    def shade(faces):
        return face_light(faces, direction=[0, 0.6, 0.8]), Light(0.2, torch.tensor([0.5, 0.6])).two_sided(faces)

    compiled = torch.compile(shade, fullgraph=True, backend="eager")
    torch.testing.assert_close(compiled(corners(2, 3)), shade(corners(2, 3)))


def test_an_object_with_the_method_is_a_light(device):
    class Twice:
        def two_sided(self, corners, mirrored=False):
            return 2 * nr.Light().two_sided(corners, mirrored)

    vertices, faces = (part.to(device) for part in nr.icosphere(1))
    textures = torch.rand(len(faces), 1, 1, 1, 3, generator=torch.Generator().manual_seed(0)).to(device)
    camera = nr.Camera.look_at((0.0, 0.0, -2.7))
    once = nr.render((vertices, faces, textures), camera, 16, outputs="rgb", light=nr.Light()).rgb
    twice = nr.render((vertices, faces, textures), camera, 16, outputs="rgb", light=Twice()).rgb
    torch.testing.assert_close(twice, 2 * once)
    with pytest.raises(TypeError, match="light: expected a Light, PointLight, …, a list of them or None, got type"):
        nr.render((vertices, faces, textures), camera, 16, light=Twice)


@pytest.mark.parametrize("shading", ["flat", "smooth"])
def test_lights_of_each_image_beside_lights_of_all(shading):
    mesh = nr.Mesh.icosphere(2)
    camera = nr.Camera.look_at([[0.4, 0.8, -2.5], [2.0, -0.5, 1.5]], viewing_angle=25)
    places, strength = torch.tensor([[1.0, 2.0, -2.0], [2.0, 0.0, 1.0]]), torch.tensor([0.2, 0.5])
    shared = [nr.EnvironmentLight(torch.rand(4, 8, 3)), nr.PointLight((-1.0, 2.0, 0.0))]
    lights = [shared[0], nr.Light(strength), nr.PointLight(places), shared[1]]
    together = nr.render(mesh, camera, 24, light=lights, shading=shading).rgb
    for b in range(2):
        own = [shared[0], nr.Light(float(strength[b])), nr.PointLight(places[b]), shared[1]]
        alone = nr.render(mesh, camera[b], 24, light=own, shading=shading).rgb
        torch.testing.assert_close(together[b], alone[0], **rounding(64, 4))


def test_lights_per_image(device):
    """Every parameter may have a batch: image b is that of the light b alone."""
    mesh = nr.Mesh.icosphere(2).to(device)
    camera = nr.Camera.look_at([[0.4, 0.8, -2.5], [2.0, -0.5, 1.5]], viewing_angle=25).to(device)
    given = {
        "ambient": [0.2, 0.5],
        "directional": [0.8, 0.3],
        "ambient_color": [[1.0, 0.5, 0.2], [0.3, 1.0, 1.0]],
        "directional_color": [[0.9, 1.0, 0.2], [0.3, 0.1, 1.0]],
        "direction": [[0.0, 1.0, -1.0], [1.0, 1.0, 0.0]],
    }
    leaves = {name: torch.tensor(values, device=device, requires_grad=True) for name, values in given.items()}
    together = nr.render(mesh, camera, 24, light=nr.Light(**leaves))
    for b in range(2):
        own = nr.Light(**{name: values[b] for name, values in given.items()})
        alone = nr.render(mesh, camera[b], 24, light=own)
        torch.testing.assert_close(together.rgb[b], alone.rgb[0], **rounding(64, 1))
    together.rgb[0].sum().backward()
    assert all(leaf.grad[0].any() and not leaf.grad[1].any() for leaf in leaves.values())
    with pytest.raises(ValueError, match=r"expected .* 2 .*, got 3"):
        nr.render(mesh, camera, 24, light=nr.Light(direction=torch.rand(3, 3)))
    harmonics = torch.rand(2, 9, 3, device=device)
    both = nr.render(mesh, camera, 24, light=nr.SphericalHarmonicLight(harmonics)).rgb
    one = nr.render(mesh, camera[1], 24, light=nr.SphericalHarmonicLight(harmonics[1])).rgb
    torch.testing.assert_close(both[1], one[0], **rounding(64, 1))


class Rim:
    def beam(self, points):
        towards = torch.tensor([0.0, 0.6, -0.8], device=points.device)
        return towards.expand_as(points), torch.full_like(points, 0.7)


class Glow:
    def ambience(self, directions, roughness=None):
        return torch.full_like(directions, 0.4)


@pytest.mark.parametrize("shading", ["smooth", "phong", "pbr"])
def test_a_light_of_one_method(shading):
    mesh, camera = nr.Mesh.icosphere(2), nr.Camera.look_at((0.0, 0.0, -2.7))
    beam = nr.Light(0.0, 0.7, direction=(0.0, 0.6, -0.8))
    for own, same in ((Rim(), beam), (Glow(), nr.Light(0.4, 0.0)), ([Rim(), Glow()], [beam, nr.Light(0.4, 0.0)])):
        found, want = (nr.render(mesh, camera, 24, light=light, shading=shading).rgb for light in (own, same))
        torch.testing.assert_close(found, want)
    with pytest.raises(TypeError, match='light: expected a method two_sided for shading="flat", got Rim'):
        nr.render(mesh, camera, 24, light=Rim())
    with pytest.raises(TypeError, match="got object, without a method beam, ambience or two_sided"):
        nr.render(mesh, camera, 24, light=object(), shading=shading)


@pytest.mark.parametrize("shading", ["flat", "smooth"])
def test_the_default_light_goes_with_each_camera(shading):
    """A ball looks the same from everywhere: within the rounding of its facets, which smooth normals hide."""
    mesh = nr.Mesh.icosphere(4)
    eyes = nr.get_points_from_angles(2.7, torch.tensor([0.0, 50.0, -70.0]), torch.tensor([0.0, 120.0, 260.0]))
    camera = nr.Camera.look_at(eyes)
    images = nr.render(mesh, camera, 48, shading=shading)
    inside = (images.alpha > 0.99).all(0)
    spread = (images.rgb - images.rgb[:1]).abs().amax((0, 1))[inside]
    assert spread.max() < 0.05
    assert images.rgb[:, 0][:, inside].min() > 0.4 - 1e-6  # no visible face is darker than the ambient light
    left, right = images.rgb[:, 0, :, :24][:, 8:24].mean(), images.rgb[:, 0, 8:24, 24:].mean()
    assert left > right + 0.02 and images.rgb[:, 0, 8:24].mean() > images.rgb[:, 0, 24:40].mean() + 0.02
    for number, one in enumerate(camera):
        alone = nr.render(mesh, one, 48, light=nr.CameraLight().at(one), shading=shading).rgb[0]
        torch.testing.assert_close(alone, images.rgb[number], atol=1e-5, rtol=0)


def test_a_camera_light_of_each_image_and_its_gradient():
    mesh = nr.Mesh.icosphere(2)
    camera = nr.Camera.look_at([[0.0, 0.0, -2.7], [2.7, 0.0, 0.0]])
    direction = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], requires_grad=True)
    images = nr.render(mesh, camera, 24, light=[nr.CameraLight(0.2, 0.5, direction)])
    world = nr.Light(0.2, 0.5, direction=torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))
    torch.testing.assert_close(images.rgb, nr.render(mesh, camera, 24, light=world).rgb)
    images.rgb.sum().backward()
    assert direction.grad.abs().sum(1).min() > 0
    with pytest.raises(ValueError, match="camera: expected a batch of 1 or 3"):
        nr.render(mesh, camera, 24, light=nr.CameraLight(direction=torch.eye(3)))


@pytest.mark.parametrize("kind", [nr.CameraLight, nr.Light])
def test_what_is_kept_of_a_light_follows_its_tensors(kind):
    """Seen without gradients, changed in place, then with gradients, it lights as a new light; a list may change."""
    mesh, camera = nr.icosphere(1), nr.Camera.look_at((0.3, 0.5, -2.7))

    def draw(direction):
        light = lights.setdefault(id(direction), kind(direction=direction))
        return nr.render(mesh, camera, 16, light=light).rgb

    lights: dict[int, nr.Light | nr.CameraLight] = {}
    towards, listed = torch.tensor([0.2, 0.5, 0.7]), [0.2, 0.5, 0.7]
    with torch.inference_mode():
        draw(towards)
    before = draw(towards)
    assert torch.equal(before, draw(listed))
    towards.neg_()
    listed[:] = towards.tolist()
    after = draw(towards)
    assert not torch.equal(after, before) and torch.equal(after, draw(listed))
    assert torch.autograd.grad(draw(towards.requires_grad_()).sum(), towards)[0].any()
    towards = torch.tensor([0.2, torch.nan, 0.7])
    nr.check_values(False)
    try:
        draw(towards)
    finally:
        nr.check_values(True)
    with pytest.raises(ValueError, match="direction: expected finite numbers"):
        draw(towards)
