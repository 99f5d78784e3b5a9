"""Forward mode of each operator: the transpose of its backward pass, <w, J v> = <transposed J w, v>, to rounding."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.autograd import forward_ad
from torch.func import jacfwd, jvp, vjp, vmap

import neural_renderer as nr
from neural_renderer.raster.clip.texture_levels import BOUNDARIES, FILTERS, sample_levels
from neural_renderer.raster.colors.composite import composite
from neural_renderer.raster.colors.downsample import halve
from neural_renderer.raster.colors.edge_hashes import texture_edge_hashes
from neural_renderer.raster.colors.interpolate import interpolate
from neural_renderer.raster.colors.light_pixels import light_pixels
from neural_renderer.raster.colors.mipmaps import pyramid, sample_mipmaps
from neural_renderer.raster.colors.texture_cubes import sample_textures
from neural_renderer.raster.ops.barycentrics import barycentrics
from neural_renderer.raster.ops.corners import gather_corners
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.ops.flat_light import flat_light
from neural_renderer.raster.ops.peel import peel
from neural_renderer.raster.ops.project_corners import project_corners
from neural_renderer.raster.reference.operators import barycentrics_reference
from neural_renderer.raster.visibility.edge import EdgeOptions, edge_gradient, edge_gradient_forward
from neural_renderer.raster.visibility.nmr import nmr_gradient
from neural_renderer.raster.warp import launch
from tests.raster.scenes import FAR, NEAR, Scene, examples, scenes
from tests.rounding import EPS

# Faces of less than a thousandth of a pixel have slopes beyond float32's range.
KINDS = ("plain", "tiny", "huge", "outside", "point", "line", "copy", "flat", "crossing", "behind", "nan")


def several(output):
    return output if isinstance(output, tuple) else (output,)


def is_transpose(function, inputs, noise, operations=64):
    """Assert the equation for random w and v, and that both kinds of forward mode give the same.

    Both sides are sums of the same products. A product is off by at most ``operations`` roundings of its size, which is
    at most that of w, J and v without their signs.
    """
    along = [noise(*each.shape).to(each.device) for each in inputs]
    output, change = jvp(function, tuple(inputs), tuple(along))
    pulls = [noise(*each.shape).to(each.device) for each in several(output)]
    leaves = [each.clone().requires_grad_() for each in inputs]
    grads = torch.autograd.grad(several(function(*leaves)), leaves, pulls)
    forward = sum((w.double() * each.double()).sum() for w, each in zip(pulls, several(change), strict=True))
    backward = sum((each.double() * v.double()).sum() for each, v in zip(grads, along, strict=True))
    size = 0.0
    for n in range(len(inputs)):
        columns = jacfwd(function, argnums=n)(*inputs)
        for w, column in zip(pulls, several(columns), strict=True):
            own = column.flatten(w.dim()).abs().double() @ along[n].flatten().abs().double()
            size += float((own * w.abs()).sum())
    assert abs(float(forward - backward)) <= operations * EPS * size, (forward, backward, size)
    with forward_ad.dual_level():
        duals = [forward_ad.make_dual(each, v) for each, v in zip(inputs, along, strict=True)]
        parts = [forward_ad.unpack_dual(each) for each in several(function(*duals))]
    for part, value, each in zip(parts, several(output), several(change), strict=True):
        assert torch.equal(part.primal, value)
        torch.testing.assert_close(part.tangent, each, rtol=0, atol=0 if part.tangent.device.type == "cpu" else 1e-5)


def drawn(scene, device):
    faces = scene.faces.to(device)
    options = (NEAR, FAR, scene.two_sided, scene.perspective)
    return faces, coverage(faces, scene.height, scene.width, *options)


SMALL = {"most_faces": 6, "side": 24, "empty": False}


@examples(25)
@given(scene=scenes(KINDS, **SMALL))
def test_points(device, scene):
    faces, index = drawn(scene, device)
    is_transpose(lambda f: barycentrics(f, index, NEAR, FAR, scene.perspective), [faces], Noise(scene))


@examples(25)
@given(scene=scenes(KINDS, **SMALL), channels=st.integers(1, 4), shared=st.booleans())
def test_attributes(device, scene, channels, shared):
    faces, index = drawn(scene, device)
    noise = Noise(scene)
    attributes = noise(1 if shared else scene.batch, scene.count, 3, channels).to(device)
    is_transpose(lambda a, f: interpolate(a, f, index, scene.perspective), [attributes, faces], noise)


@examples(25)
@given(scene=scenes(KINDS, **SMALL), size=st.integers(1, 3))
def test_cubes(device, scene, size):
    faces, index = drawn(scene, device)
    noise, batch, count = Noise(scene), scene.batch, scene.count
    parts = noise(1, count, size, size, size, 3), noise(batch, 2, count, 3), noise(batch, 3, *index.shape[1:])
    parts = [part.to(device) for part in parts]
    is_transpose(lambda *p: sample_textures(*p, index, 1e-3, scene.perspective), [*parts, faces], noise)


@examples(15)
@given(scene=scenes(KINDS, **SMALL), mipmaps=st.booleans(), repeats=st.booleans())
def test_mipmaps(device, scene, mipmaps, repeats):
    index = drawn(scene, device)[1]
    noise = Noise(scene)
    levels = 3 if mipmaps else 1  # of 5 x 4 texels
    texels, uv = pyramid(noise(1, 3, 5, 4), levels).to(device), noise(*index.shape, 2).to(device)
    is_transpose(lambda t, p: sample_mipmaps(t, 5, 4, p, index, levels, repeats, False), [texels, uv], noise)


@examples(15)
@given(scene=scenes(KINDS, **SMALL), cube=st.booleans(), filtering=st.sampled_from(list(FILTERS)))
def test_footprints(device, scene, cube, filtering):
    """The derivative of a cube map's sample by its direction, and of a level by the footprint, are not linear."""
    noise = Noise(scene)
    count = (6 if cube else 1) * (16 + 4 + 1)
    texels, places = noise(1, count, 2), noise(1, 3, 4, 3 if cube else 2)
    parts = [texels, places, 0.2 * noise(1, 3, 4, 2 * places.shape[3]), noise(1, 3, 4)]
    boundary = [BOUNDARIES["cube" if cube else "wrap"]] * 2
    options = [4, 4, 3], FILTERS[filtering], boundary
    is_transpose(lambda *p: sample_levels(*p, *options), [part.to(device) for part in parts], noise)


@examples(15)
@given(scene=scenes(KINDS, **SMALL))
def test_linear_operators(device, scene):
    faces, index = drawn(scene, device)
    noise = Noise(scene)
    image, behind = (noise(scene.batch, 3, *index.shape[1:]).to(device) for _ in range(2))
    light, colors = noise(1, 2, scene.count, 3).to(device), image.movedim(1, 3).contiguous()
    lit = [colors, behind, light]
    is_transpose(lambda c, b, a: light_pixels(c, b, a, faces, index, scene.perspective), lit, noise)
    is_transpose(lambda c, b: composite(c, b, index), [colors, behind], noise)
    is_transpose(halve, [noise(2, 3, 4, 6).to(device)], noise)
    rows = torch.randint(7, (1, scene.count, 3), generator=noise.random, dtype=torch.int32).to(device)
    is_transpose(lambda v: gather_corners(v, rows), [noise(scene.batch, 7, 3).to(device)], noise)


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("shared", [False, True])
def test_projection_and_light(device, perspective, shared):
    noise = Noise(Scene(3, 2, 6, 4, 4, True, perspective, ("plain",)))
    batch, count = (1, 6) if shared else (2, 6)
    vertices, rows = noise(batch, 5, 3), torch.randint(5, (1, count, 3), generator=noise.random, dtype=torch.int32)
    camera = [noise(2, 3, 3), 4 * noise(batch, 3), noise(1).abs() + 0.5]
    inputs = [part.to(device) for part in (vertices, *camera)]
    options = (1.5, perspective)
    is_transpose(lambda v, *c: project_corners(v, rows.to(device), *c, *options), inputs, noise, 200)
    light = [part.to(device) for part in (vertices, noise(1, 3), noise(2, 3), noise(batch, 3))]
    for mirrored in (False, True):
        is_transpose(lambda v, *o, m=mirrored: flat_light(v, rows.to(device), *o, m), light, noise, 200)


@examples(25)
@given(
    scene=scenes(KINDS, **SMALL),
    seams=st.booleans(),
    halved=st.booleans(),
    silhouette=st.booleans(),
    known=st.integers(0, 2),
)
def test_visibility(device, scene, seams, halved, silhouette, known):
    """Outlines, seams and, as random faces intersect, their lines of equal depth."""
    scene = Scene(**{**vars(scene), "height": 2 * scene.height, "width": 2 * scene.width} if halved else vars(scene))
    faces, index = drawn(scene, device)
    noise = Noise(scene)
    options = EdgeOptions(scene.two_sided, scene.perspective, seams and not silhouette, halved)
    cubes = noise(1, scene.count, 2, 2, 2, 3).to(device)
    hashes = texture_edge_hashes(cubes, torch.ones(1, 2, scene.count, 3, device=device)) if seams else None
    if silhouette:
        is_transpose(lambda f: edge_gradient(None, f, index, options), [faces], noise)
    else:
        image = noise(scene.batch, 2, *index.shape[1:]).to(device)
        values = noise(1, scene.count, 3, known).to(device) if known else None
        rest = (index, options, hashes, *[None] * 5, values)
        is_transpose(lambda i, f: edge_gradient(i, f, *rest), [image, faces], noise)


@examples(10)
@given(scene=scenes(KINDS, **SMALL), seams=st.booleans())
def test_layers(device, scene, seams):
    faces, noise = scene.faces.to(device), Noise(scene)
    shown = peel(faces, scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective, 3)
    maps = noise(4, scene.batch, 2, scene.height, scene.width).to(device)
    options = (shown, EdgeOptions(scene.two_sided, scene.perspective, seams), *[None] * 5, maps[1:])
    is_transpose(lambda i, f: edge_gradient(i, f, *options), [maps[0], faces], noise)


class Noise:
    """Random numbers of a scene, from one sequence."""

    def __init__(self, scene):
        self.random = scene.generator

    def __call__(self, *shape):
        return torch.randn(*shape, generator=self.random)


def test_points_against_float64(device):
    """The weights' and the depth's change is that of the reference; sums of a few products of numbers up to 20."""
    scene = Scene(5, 2, 12, 30, 34, True, True, ("plain", "flat", "outside"))
    faces, index = drawn(scene, device)
    along = scene.noise(*faces.shape).to(device)
    found = jvp(lambda f: barycentrics(f, index, NEAR, FAR, True), (faces,), (along,))[1]
    expected = jvp(lambda f: barycentrics_reference(f, index, NEAR, FAR, True), (faces.double(),), (along.double(),))[1]
    for own, other in zip(found, expected, strict=True):
        torch.testing.assert_close(own.double(), other, rtol=1e-4, atol=1e-4)


def test_directions_together(device):
    """Ten directions at once, more than a kernel takes at a time, are ten alone."""
    scene = Scene(7, 1, 8, 24, 26, True, True, ("plain", "tiny"))
    faces, index = drawn(scene, device)
    image, motion = scene.noise(1, 2, 24, 26).to(device), scene.noise(10, *faces.shape).to(device)
    options = (image, faces, index, EdgeOptions(True, True, True))
    together = edge_gradient_forward(None, motion, *options)
    for n, own in enumerate(motion):
        alone = edge_gradient_forward(None, own[None], *options)[0]
        torch.testing.assert_close(together[n], alone, rtol=0, atol=1e-5 * float(alone.abs().max()))

    def draw(faces):
        return edge_gradient(image, faces, *options[2:])

    pushed = vmap(lambda v: jvp(draw, (faces,), (v,))[1])(motion)
    torch.testing.assert_close(pushed, together, rtol=0, atol=1e-5 * float(together.abs().max()))


def test_threads_do_not_matter():
    """On the CPU bands of lines are drawn by several threads, and each pixel sums in the same order."""
    vertices, faces = nr.icosphere(3)
    motion = torch.randn(2, len(vertices), 3, generator=torch.Generator().manual_seed(0))
    cubes = torch.rand(len(faces), 2, 2, 2, 3, generator=torch.Generator().manual_seed(1))
    before = torch.get_num_threads()

    def change(direction):
        def draw(moved):
            return nr.render((moved, faces, cubes), nr.Camera.look_at((0.3, 0.4, 2.7)), 128).rgb

        return jvp(draw, (vertices,), (direction,))[1]

    try:
        torch.set_num_threads(1)
        alone = change(motion[0])
        torch.set_num_threads(3)
        assert torch.equal(change(motion[0]), alone)
    finally:
        torch.set_num_threads(before)


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("shading", ["flat", "smooth"])
def test_inference_mode_has_the_same_derivatives(device, shading):
    """Derivatives by torch.func, forward and backward, are the same outside and inside inference mode."""
    with torch.inference_mode():
        if not vjp(torch.sin, torch.zeros(1))[1](torch.ones(1))[0]:
            pytest.skip("the derivative of a sine is 0 in inference mode, as in torch 2.11; in 2.13 it is 1")
    vertices, faces = (each.to(device) for each in nr.icosphere(2))
    texture = torch.rand(16, 16, 3, generator=torch.Generator().manual_seed(0)).to(device)

    def draw(shift):
        mesh = nr.UVMesh(vertices + shift, faces, 0.5 + 0.5 * vertices[:, :2], texture)
        images = nr.render(mesh, nr.Camera.look_at((0.3, 0.4, 3.0)), 24, shading=shading)
        return images.alpha, images.rgb, images.depth

    def derivatives():
        shift, direction = torch.zeros(3, device=device), torch.tensor([0.3, 0.2, 0.5], device=device)
        images, pull = vjp(draw, shift)
        return *jvp(draw, (shift,), (direction,))[1], *jacfwd(draw)(shift), *pull(images)

    outside = derivatives()
    with torch.inference_mode():
        inside = derivatives()
    for own, other in zip(inside, outside, strict=True):
        size = float(other.abs().max())
        assert size > 0
        torch.testing.assert_close(own, other, rtol=0, atol=64 * EPS * size)


def test_paper_gradient_is_refused(device):
    scene = Scene(1, 1, 4, 12, 12, True, True, ("plain",))
    faces, index = drawn(scene, device)
    image = scene.noise(1, 2, 12, 12).to(device)
    with pytest.raises(RuntimeError, match="is no linear map of motions"):
        jvp(lambda f: nmr_gradient(image, f, index, 1e-3, True), (faces,), (faces,))
    change = jvp(lambda i: nmr_gradient(i, faces, index, 1e-3, True, True), (image,), (image,))[1]
    torch.testing.assert_close(change, halve(image), rtol=0, atol=0)


@pytest.mark.parametrize("shading", ["flat", "smooth"])
@pytest.mark.parametrize("colors", ["none", "faces", "vertices", "cubes", "images"])
def test_columns_are_those_of_one_direction_each_and_share_all_kernels(monkeypatch, device, colors, shading):
    if colors == "none" and shading == "smooth":
        pytest.skip("a silhouette has no shading")
    random = torch.Generator().manual_seed(0)
    vertices, faces = (each.to(device) for each in nr.icosphere(level=1))

    def noise(*shape):
        return torch.rand(*shape, generator=random).to(device)

    mesh = {
        "none": lambda: (vertices, faces),
        "faces": lambda: nr.Mesh(vertices, faces, face_colors=noise(len(faces), 3)),
        "vertices": lambda: nr.Mesh(vertices, faces, vertex_colors=noise(len(vertices), 3)),
        "cubes": lambda: (vertices, faces, noise(len(faces), 3, 3, 3, 3)),
        "images": lambda: nr.UVMesh(vertices, faces, 0.5 + 0.5 * vertices[:, :2], noise(16, 16, 3)),
    }[colors]()
    output, place = "alpha" if colors == "none" else "rgb", torch.tensor([0.3, 0.4, -2.7, 0.1, 0.0, -0.1])
    launches = []
    monkeypatch.setattr(launch, "emulator", _counted(launches, launch.emulator))

    def draw(place):
        camera = nr.Camera.look_at(place[:3].to(device), place[3:].to(device), viewing_angle=25)
        return getattr(nr.render(mesh, camera, 20, shading=shading, outputs=(output,)), output)

    jvp(draw, (place,), (torch.ones(6),))
    if device == "cuda":
        torch.cuda.synchronize()  # from here on it is known that the surface is closed, which saves launches
    launches.clear()
    jvp(draw, (place,), (torch.ones(6),))
    of_one = len(launches)
    launches.clear()
    columns = jacfwd(draw)(place)
    assert len(launches) == of_one
    for number, unit in enumerate(torch.eye(6)):
        change = jvp(draw, (place,), (unit,))[1]
        size = float(change.abs().max())
        assert size > 0
        torch.testing.assert_close(columns[..., number], change, rtol=0, atol=64 * EPS * size)


def _counted(launches, emulator):
    def count(kernel, tasks, arguments):
        launches.append(kernel)
        return emulator is not None and emulator(kernel, tasks, arguments)

    return count
