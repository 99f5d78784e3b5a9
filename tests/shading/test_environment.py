"""Light from an environment image, held to sums over its pixels."""

from __future__ import annotations

import dataclasses
import math
import pickle

import pytest
import torch
from torch.nn.functional import normalize

import neural_renderer as nr
from neural_renderer.shading.environments.equirectangular import direction_uv, directions_of, solid_angles
from neural_renderer.shading.environments.prefilter import LEVELS


def clouds(height=32, width=64):
    """Smooth light: random harmonics of low order and a broad sun."""
    ways = directions_of(height, width, torch.zeros(()))
    sun = torch.exp(6 * (ways @ normalize(torch.tensor([0.3, 0.8, -0.5]), dim=0) - 1))
    return (0.5 + 0.2 * torch.sin(3 * ways) + sun[..., None] * torch.tensor([3.0, 2.0, 1.0])).clamp(min=0)


def some_directions(count=64):
    return normalize(torch.randn(1, 8, count // 8, 3, generator=torch.Generator().manual_seed(0)), dim=-1)


def test_directions_are_where_the_documentation_says():
    """Up is row 0, the middle is −z, to its right +x; the left and right borders are +z."""
    ways = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    expected = torch.tensor([[0.5, 1.0], [0.5, 0.5], [0.75, 0.5], [0.25, 0.5], [0.5, 0.0]])
    torch.testing.assert_close(direction_uv(ways), expected, rtol=0, atol=1e-6)
    u = direction_uv(torch.tensor([[1e-3, 0.0, 1.0], [-1e-3, 0.0, 1.0]]))[:, 0]
    assert u[0] > 0.999 and u[1] < 0.001
    pixels = direction_uv(directions_of(4, 8, torch.zeros(())))
    torch.testing.assert_close(pixels[1, 6], torch.tensor([6.5 / 8, 1 - 1.5 / 4]))
    assert abs(float(solid_angles(7, 5, torch.zeros(())).sum()) * 5 - 4 * math.pi) < 1e-5


def test_radiance_is_the_pixel_of_each_direction():
    image = torch.rand(6, 10, 3)
    light = nr.EnvironmentLight(image, intensity=2.0)
    found = light.radiance(3 * directions_of(6, 10, image)[None])[0]
    torch.testing.assert_close(found, 2 * image, rtol=0, atol=1e-5)


def test_matt_surfaces_get_the_sum_over_all_pixels():
    """Order 2 keeps all but 1 % of the mean light; of this one less, which is smooth."""
    image, normals = clouds(), some_directions()
    ways = directions_of(32, 64, image)
    weights = (normals[..., None, None, :] * ways).sum(-1).clamp(min=0) * solid_angles(32, 64, image)[:, None] / math.pi
    summed = (weights[..., None] * image).sum((-3, -2))
    found = nr.EnvironmentLight(image).ambience(normals)
    torch.testing.assert_close(found, summed, rtol=0, atol=0.01 * float(image.max()))


@pytest.mark.parametrize("level", [1, 2, 3, 4, 6, 8])
def test_blurred_reflections_are_sums_over_the_lobe(level):
    """The lobe of GGX, D · cosine, over all pixels of a finer image."""
    image, ways = clouds(), some_directions()
    fine = directions_of(128, 256, image)
    light = nr.EnvironmentLight(image).radiance(fine[None])[0]
    alpha = (level / LEVELS) ** 2
    cosine = (ways[..., None, None, :] * fine).sum(-1)
    lobe = cosine.clamp(min=0) / ((1 + cosine) / 2 * (alpha**2 - 1) + 1) ** 2 * solid_angles(128, 256, image)[:, None]
    summed = (lobe[..., None] * light).sum((-3, -2)) / lobe.sum((-2, -1))[..., None]
    rough = torch.full((1, 8, 8, 1), level / LEVELS)
    found = nr.EnvironmentLight(image).ambience(ways, rough)
    # Texels about as wide as the lobe, interpolated: 3 % of the range of the light.
    torch.testing.assert_close(found, summed, rtol=0, atol=0.03 * float(image.max()))


def test_a_mirror_shows_the_image_and_levels_join():
    image, ways = clouds(), some_directions()
    light = nr.EnvironmentLight(image)
    torch.testing.assert_close(light.ambience(ways, torch.zeros(1, 8, 8, 1)), light.radiance(ways))
    for level in range(1, LEVELS):
        both = [light.ambience(ways, torch.full((1, 8, 8, 1), level / LEVELS + step)) for step in (-1e-4, 1e-4)]
        torch.testing.assert_close(*both, rtol=0, atol=2e-3 * float(image.max()))


def test_even_light_is_even():
    light, ways = nr.EnvironmentLight(torch.full((17, 30, 3), 0.5)), some_directions()
    for roughness in (None, 0.0, 0.1, 0.55, 1.0):
        rough = None if roughness is None else torch.full((1, 8, 8, 1), roughness)
        torch.testing.assert_close(light.ambience(ways, rough), torch.full((1, 8, 8, 3), 0.5), rtol=2e-3, atol=0)


def test_gradients_are_the_transpose(device):
    """All of it is linear in the image, so that ⟨f(image), w⟩ = ⟨image, gradient⟩."""
    image = torch.rand(8, 16, 3, device=device).requires_grad_()
    light, ways = nr.EnvironmentLight(image), some_directions().to(device)
    rough = torch.linspace(0, 1, 64, device=device).view(1, 8, 8, 1)
    result = light.ambience(ways, rough) + light.ambience(ways)
    weights = torch.rand_like(result)
    (gradient,) = torch.autograd.grad((result * weights).sum(), image)
    torch.testing.assert_close((gradient * image).sum(), (result * weights).sum())


def test_an_image_changed_in_place_is_seen():
    image, ways = clouds(8, 16), some_directions()
    light, rough = nr.EnvironmentLight(image), torch.full((1, 8, 8, 1), 0.4)
    before = light.ambience(ways, rough), light.ambience(ways)
    image *= 2
    torch.testing.assert_close(light.ambience(ways, rough), 2 * before[0])
    torch.testing.assert_close(light.ambience(ways), 2 * before[1])


def test_images_of_inference_mode():
    """Changes of these are not counted, so nothing is kept."""
    with torch.inference_mode():
        image, ways = clouds(8, 16), some_directions()
        light = nr.EnvironmentLight(image)
        before = light.ambience(ways)
        image *= 2
        torch.testing.assert_close(light.ambience(ways), 2 * before)


def test_each_image_has_its_own_environment():
    images, intensity = torch.rand(2, 8, 16, 3), torch.tensor([1.0, 3.0])
    ways, rough = some_directions().expand(2, -1, -1, -1), torch.full((2, 8, 8, 1), 0.3)
    both = nr.EnvironmentLight(images, intensity)
    for number in range(2):
        one = nr.EnvironmentLight(images[number], float(intensity[number]))
        torch.testing.assert_close(both.ambience(ways, rough)[number], one.ambience(ways[:1], rough[:1])[0])
        torch.testing.assert_close(both.ambience(ways)[number], one.ambience(ways[:1])[0])
    with pytest.raises(ValueError, match="image: expected a batch of 1 or 3 like directions, got 2"):
        both.ambience(torch.zeros(3, 8, 8, 3))


@pytest.mark.parametrize("size", [16, (10, 20)])
def test_the_background_is_what_a_mirror_behind_would_show(size):
    """A large square across the view that emits the environment: its pixels are those of the background."""
    light = nr.EnvironmentLight(clouds())
    camera = nr.Camera.look_at((0.5, 0.3, -1.0), at=(0.0, 0.2, 0.0), viewing_angle=30)
    corners = camera.unproject(torch.tensor([[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]]), torch.ones(4), 1)[0]
    fragments = nr.fragments((corners, torch.tensor([[0, 1, 2], [0, 2, 3]])), camera, size, anti_aliasing=False)
    assert bool(fragments.mask.all())
    ways = fragments.interpolate(corners) - camera.origin[:, None, None]
    seen = nr.linear_to_srgb(light.radiance(ways)).movedim(-1, 1)
    torch.testing.assert_close(light.background(camera, size), seen, rtol=0, atol=1e-4)


def test_flat_light_is_that_of_its_harmonics():
    light, corners = nr.EnvironmentLight(clouds(), 0.5), torch.randn(2, 5, 3, 3)
    wanted = nr.SphericalHarmonicLight(0.5 * light.coefficients()).two_sided(corners, True)
    torch.testing.assert_close(light.two_sided(corners, True), wanted)


def test_messages():
    with pytest.raises(ValueError, match=r"image: expected shape \[H, W, 3\], got \[4, 4, 1\]"):
        nr.EnvironmentLight(torch.zeros(4, 4, 1))
    with pytest.raises(ValueError, match="image: expected at least one pixel"):
        nr.EnvironmentLight(torch.zeros(0, 4, 3))
    with pytest.raises(ValueError, match="camera: expected one with perspective, got an orthographic one"):
        nr.EnvironmentLight(torch.ones(4, 8, 3)).background(nr.Camera.look_at((0, 0, 3), orthographic=True), 8)


# Directions, and what Mitsuba 3.9.1 sees there in `waves`, its plug-in "envmap". The first four are on the horizon.
WAYS = torch.tensor(
    [[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1], [0.6, 0.5, -0.3], [0.2, -0.4, 0.9], [-0.7, 0.3, 0.1], [-2, -8, -5]]
)
SEEN_BY_MITSUBA = [
    *([0.0796, 0.9985, 0.5], [0.5712, 0.9985, 0.5], [0.9202, 0.0053, 0.5], [0.9202, 0.0053, 0.5]),
    *([0.2851, 0.4491, 0.9617], [0.7827, 0.0008, 0.1472], [0.655, 0.9987, 0.8475], [0.9945, 0.8588, 0.0013]),
]


def waves() -> torch.Tensor:
    x, y, z = directions_of(64, 128, torch.zeros(())).unbind(-1)
    return 0.5 + 0.5 * torch.stack(((2 * x + 1).sin(), (3 * z + y).cos(), (2 * y).sin()), -1)


def test_an_image_lies_as_in_mitsuba():
    """On the horizon to all digits; elsewhere Mitsuba's rows are those of corners, and ours those of centres."""
    found = nr.EnvironmentLight(waves(), convention="mitsuba").radiance(normalize(WAYS, dim=-1)[None, None])[0, 0]
    torch.testing.assert_close(found[:4], torch.tensor(SEEN_BY_MITSUBA[:4]), rtol=0, atol=1e-4)
    torch.testing.assert_close(found, torch.tensor(SEEN_BY_MITSUBA), rtol=0, atol=0.02)


@pytest.mark.slow
def test_mitsuba_sees_what_is_stored():
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    light = mitsuba.load_dict({"type": "envmap", "bitmap": mitsuba.Bitmap(waves().numpy())})
    scene = mitsuba.load_dict({"type": "scene", "emitter": light})
    found, point = [], mitsuba.SurfaceInteraction3f()
    for way in normalize(WAYS, dim=-1).tolist():
        point.wi = mitsuba.Vector3f(*(-number for number in way))
        found.append(list(map(float, light.eval(point))))
    torch.testing.assert_close(torch.tensor(found), torch.tensor(SEEN_BY_MITSUBA), rtol=0, atol=1e-4)
    assert len(scene.emitters()) == 1


@pytest.mark.parametrize("program", ["gltf", "blender"])
def test_an_image_lies_as_in_viewers(program):
    """three.js and Khronos' viewer: u = 1/2 + atan2(z, x) / 2π. Blender: u = 1/2 − atan2(y, x) / 2π, with z up."""
    image, (x, y, z) = waves(), normalize(WAYS, dim=-1).T
    turn = torch.atan2(z, x) if program == "gltf" else -torch.atan2(-z, x)  # its export writes (x, z, −y)
    up = y  # the z of Blender
    column, row = (0.5 + turn / (2 * math.pi)) * 128, (0.5 - up.asin() / math.pi) * 64
    nearest = image[row.long().clamp(max=63), column.long() % 128]
    light = nr.EnvironmentLight(image, convention=program)
    found = light.radiance(normalize(WAYS, dim=-1)[None, None])[0, 0]
    torch.testing.assert_close(found, nearest, rtol=0, atol=0.12)  # half a pixel of the fastest wave


def test_conventions_are_applied_once():
    image = torch.rand(4, 8, 3)
    light = nr.EnvironmentLight(image, convention="mitsuba")
    assert torch.equal(light.image, image.roll(4, 1))
    assert torch.equal(dataclasses.replace(light, intensity=2.0).image, light.image)
    assert torch.equal(pickle.loads(pickle.dumps(light)).image, light.image)
    with pytest.raises(ValueError, match="expected one of neural_renderer, mitsuba, blender, gltf, got 'mi'"):
        nr.EnvironmentLight(image, convention="mi")
    with pytest.raises(ValueError, match="a width that 4 divides for convention 'gltf', got 6 columns"):
        nr.EnvironmentLight(torch.rand(3, 6, 3), convention="gltf")
