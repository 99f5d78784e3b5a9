"""The operations put together: torch's machinery, dtypes, repeatability, memory."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster.colors import texture_cubes as textures
from neural_renderer.raster.ops import barycentrics, corners, coverage
from neural_renderer.raster.visibility import nmr as edges
from tests.programs import run_python
from tests.raster.scenes import FAR, FRONT, NEAR, Scene
from tests.rounding import rounding


def scene_inputs(device, batch=2, count=9, height=14, width=18):
    scene = Scene(3, batch, count, height, width, True, True, FRONT)
    faces = scene.faces.to(device)
    index = coverage.coverage(faces, height, width, NEAR, FAR, True, True)
    weights, depth = barycentrics.barycentrics(faces, index, NEAR, FAR, True)
    return scene, faces, index, weights, depth


def draw(faces, cubes, size=(14, 18), **options):
    images = nr.rasterize_images(faces, size, textures=cubes, two_sided=True, far=FAR, **options)
    return torch.cat((images.rgb, images.alpha[:, None], images.depth[:, None]), 1)


@pytest.mark.parametrize("name", ["coverage", "barycentrics", "textures", "edges", "corners"])
def test_operators_are_well_formed(device, name):
    scene, faces, index, weights, depth = scene_inputs(device)

    def noise(*shape):
        return scene.noise(*shape).to(device)

    leaf = faces.clone().requires_grad_()
    light, cubes = noise(1, 2, 9, 3), noise(2, 9, 3, 3, 3, 3)
    image, behind = noise(2, 3, 14, 18), noise(2, 3, 14, 18)
    triangles = torch.randint(0, 5, (1, 9, 3), dtype=torch.int32, device=device)
    calls = {
        "coverage": [(coverage.coverage, (faces, 14, 18, NEAR, FAR, True, True))],
        "barycentrics": [
            (barycentrics.barycentrics, (leaf, index, NEAR, FAR, True)),
            (barycentrics.barycentrics_backward, (weights, depth, faces, index, NEAR, FAR, True)),
        ],
        "textures": [
            (
                textures.sample_textures,
                (
                    *(t.clone().requires_grad_() for t in (cubes, light, behind)),
                    leaf,
                    index,
                    1e-3,
                    True,
                ),
            ),
            (textures.sample_textures_backward, (image, True, True, True, cubes, light, faces, index, 1e-3, True)),
            (textures.sample_textures_backward, (image, False, True, False, cubes, light, faces, index, 1e-3, True)),
        ],
        "edges": [
            (edges.nmr_gradient, (image.clone().requires_grad_(), leaf, index, 1e-3, True)),
            (edges.nmr_gradient, (None, leaf, index, 1e-3, True, True)),
            (edges.nmr_gradient_backward, (image, image, faces, index, 1e-3, True)),
            (edges.nmr_gradient_backward, (image[..., ::2, ::2], image, faces, index, 1e-3, True)),
        ],
        "corners": [
            (corners.gather_corners, (noise(2, 5, 3).requires_grad_(), triangles)),
            (corners.gather_corners_backward, (faces, triangles, 5)),
        ],
    }
    for operator, arguments in calls[name]:
        torch.library.opcheck(operator.operator, arguments)


@pytest.mark.parametrize("backend", ["aot_eager", pytest.param("inductor", marks=pytest.mark.slow)])
def test_compiles_as_one_graph(device, backend):
    if backend == "inductor" and device == "cpu" and not _has_compiler():
        pytest.skip("torch's inductor needs a C++ compiler")
    _, faces, *_ = scene_inputs(device)
    torch._dynamo.reset()

    def loss(corners):
        return nr.rasterize_silhouettes(corners, (14, 18)).square().sum()

    results = []
    for function in (loss, torch.compile(loss, fullgraph=True, backend=backend)):
        leaf = faces.clone().requires_grad_()
        value = function(leaf)
        value.backward()
        results.append((value.detach(), leaf.grad))
    # The same kernels; the loss, a sum of multiples of 1 / 16, is exact in any order.
    torch.testing.assert_close(results[0], results[1])
    assert results[0][1].any()


def test_renderers_compile_as_one_graph(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    cubes = torch.rand(1, len(faces), 2, 2, 2, 3, device=device)
    renderer = nr.Renderer(16, camera_mode="look_at", perspective=True)
    camera = nr.Camera.look_at(torch.tensor([[0.0, 0.5, 3.0]], device=device))

    def old(points, colors):
        return torch.cat([image.flatten() for image in renderer(points[None], faces[None], colors)])

    def new(points, colors):
        return torch.cat([image.flatten() for image in nr.render((points, faces, colors), camera, (12, 16))])

    for function in (old, new):
        torch._dynamo.reset()
        results = []
        for f in (function, torch.compile(function, fullgraph=True, backend="aot_eager")):
            inputs = vertices.clone().requires_grad_(), cubes.clone().requires_grad_()
            image = f(*inputs)
            results.append((image, *torch.autograd.grad(image.square().sum(), inputs)))
        # Fused operations round differently; depth is up to 100, and sums have 16 x 16 x 4 terms.
        for one, other in zip(*results, strict=True):
            torch.testing.assert_close(one, other, **rounding(32**2, float(other.detach().abs().max())))


def _has_compiler() -> bool:
    import shutil

    return any(shutil.which(name) for name in ("g++", "clang++", "c++"))


def test_no_grad_saves_nothing(device):
    _, faces, *_ = scene_inputs(device)
    faces.requires_grad_()
    cubes = torch.rand(2, 9, 2, 2, 2, 3, device=device, requires_grad=True)
    saved = []

    def pack(tensor):
        saved.append(tensor)
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda t: t):
        with torch.no_grad():
            image = draw(faces, cubes)
        assert not image.requires_grad and not saved
        assert torch.equal(draw(faces, cubes).detach(), image) and saved
        saved.clear()
        draw(faces.detach(), cubes.detach())
        assert not saved


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.bfloat16])
def test_other_dtypes_are_computed_in_float32(device, dtype):
    _, faces, *_ = scene_inputs(device)
    cubes = torch.rand(2, 9, 2, 2, 2, 3, device=device)
    rounded = [t.to(dtype).requires_grad_() for t in (faces, cubes)]
    exact = [t.detach().float().requires_grad_() for t in rounded]
    images = [draw(*inputs) for inputs in (rounded, exact)]
    assert images[0].dtype == torch.float32 and torch.equal(*images)
    for image in images:
        image.square().sum().backward()
    for a, b in zip(rounded, exact, strict=True):
        assert a.grad.dtype == dtype and torch.equal(a.grad, b.grad.to(dtype))


@pytest.mark.usefixtures("deterministic")
def test_autocast_changes_nothing(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    vertices.requires_grad_()
    mesh = vertices, faces, torch.rand(len(faces), 2, 2, 2, 3, device=device)
    camera = nr.Camera.look_at(torch.tensor([[1.0, 0.5, 3.0]], device=device))
    plain = nr.render(mesh, camera, 16)
    with torch.autocast(device, dtype=torch.bfloat16):
        cast = nr.render(mesh, camera, 16)
    assert all(torch.equal(a, b) for a, b in zip(plain, cast, strict=True))
    assert all(
        torch.equal(*(torch.autograd.grad(image.sum(), vertices, retain_graph=True)[0] for image in pair))
        for pair in ((plain.alpha, cast.alpha), (plain.depth, cast.depth))
    )


def test_faces_of_any_kind_are_equal(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    vertices = torch.stack((vertices, vertices * 0.5 + 0.1))
    results = []
    for kind in (
        faces,
        faces.long(),
        faces[None],
        faces.expand(2, -1, -1),
        faces.long().expand(2, -1, -1).contiguous(),
    ):
        leaf = vertices.clone().requires_grad_()
        corners = nr.vertices_to_faces(leaf, kind)
        assert torch.equal(corners, vertices[:, faces.long()])
        corners.square().sum().backward()
        results.append(leaf.grad)
    assert all(torch.equal(results[0], other) for other in results[1:])


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (7, 33), (33, 7)])
def test_non_square_images_show_the_same_scene(device, size):
    """The picture of the whole screen, sampled otherwise: a pixel of a 3 times finer image lies on each centre."""
    _, faces, *_ = scene_inputs(device)
    cubes = torch.rand(2, 9, 2, 2, 2, 3, device=device)
    image = draw(faces, cubes, size, anti_aliasing=False)
    assert image.shape == (2, 5, *size)
    fine = draw(faces, cubes, (3 * size[0], 3 * size[1]), anti_aliasing=False)[:, :, 1::3, 1::3]
    assert ((image - fine).abs().amax(1) > 1e-3).float().mean() <= 0.01


def test_anti_aliasing_is_the_mean_of_four(device):
    _, faces, *_ = scene_inputs(device)
    cubes = torch.rand(2, 9, 2, 2, 2, 3, device=device)
    fine = draw(faces, cubes, (28, 36), anti_aliasing=False, background=(0.2, 0.4, 0.6))
    mean = torch.nn.functional.avg_pool2d(fine, 2)
    torch.testing.assert_close(draw(faces, cubes, background=(0.2, 0.4, 0.6)), mean, **rounding(4, FAR))


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_one_texel_is_eight_equal_ones(device, gradient):
    """The same images, and the gradient of the one is the sum of the eight's; equal texels blend up to rounding."""
    _, faces, *_ = scene_inputs(device)
    found = []
    for size in (1, 2):
        leaf = faces.clone().requires_grad_()
        cubes = torch.rand(2, 9, 1, 1, 1, 3, generator=torch.Generator().manual_seed(0)).to(device).requires_grad_()
        image = draw(leaf, cubes.expand(2, 9, size, size, size, 3), gradient=gradient)
        (image * torch.randn(image.shape, generator=torch.Generator().manual_seed(1)).to(device)).sum().backward()
        found.append((image.detach(), leaf.grad, cubes.grad))
    for one, eight in zip(*found, strict=True):
        assert one.any() and (one - eight).norm() <= 1e-5 * eight.norm()


def test_what_is_asked_for_does_not_change_it(device):
    _, faces, *_ = scene_inputs(device)
    cubes = torch.rand(2, 9, 2, 2, 2, 3, device=device)
    together = nr.rasterize_images(faces, 20, textures=cubes)
    for name in ("rgb", "alpha", "depth"):
        alone = nr.rasterize_images(faces, 20, textures=cubes, outputs=name)
        assert torch.equal(getattr(alone, name), getattr(together, name))
        assert sum(image is not None for image in alone) == 1


def empty_scene(device):
    return torch.full((2, 1, 3, 3), 5.0, device=device), torch.zeros(2, 1, 2, 2, 2, 3, device=device)


@pytest.mark.parametrize("batched", [False, True])
def test_background_colors(device, batched):
    faces, cubes = empty_scene(device)
    color = torch.rand(2, 3, device=device) if batched else torch.rand(3, device=device)
    for given in (color, color.tolist()):
        image = nr.rasterize_images(faces, (4, 6), textures=cubes, background=given, outputs=("rgb",)).rgb
        assert torch.allclose(image, color[..., None, None].expand(2, 3, 4, 6))


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize("anti_aliasing", [False, True])
def test_background_pictures(device, batched, anti_aliasing):
    faces, cubes = empty_scene(device)
    picture = torch.rand(2, 3, 4, 6, device=device) if batched else torch.rand(3, 4, 6, device=device)
    picture.requires_grad_()
    image = nr.rasterize_images(
        faces, (4, 6), textures=cubes, background=picture, outputs=("rgb",), anti_aliasing=anti_aliasing
    ).rgb
    assert torch.allclose(image, picture.expand(2, 3, 4, 6))
    image.sum().backward()
    assert torch.allclose(picture.grad, torch.full_like(picture, 1.0 if batched else 2.0))


def test_a_background_of_bytes_is_refused(device):
    faces, cubes = empty_scene(device)
    for picture in (torch.zeros(4, 6, 3, dtype=torch.uint8), np.zeros((4, 6, 3), np.uint8)):
        with pytest.raises(TypeError, match=r"background: expected numbers in \[0, 1\], got \[4, 6, 3\] uint8"):
            nr.rasterize_images(faces, (4, 6), textures=cubes, background=picture)


def test_two_sided_is_appending_reversed_faces(device):
    """Values are bitwise equal; so are gradients, summed over a face and its copy (`fill_back`)."""
    scene, faces, *_ = scene_inputs(device, count=12)
    cubes = scene.noise(2, 12, 3, 3, 3, 3).to(device)
    order = torch.tensor([2, 1, 0], device=device)
    native = [faces.clone().requires_grad_(), cubes.clone().requires_grad_()]
    doubled = [faces.clone().requires_grad_(), cubes.clone().requires_grad_()]
    both = torch.cat((doubled[0], doubled[0][:, :, order]), 1)
    twice = torch.cat((doubled[1], doubled[1].transpose(2, 4)), 1)
    options = {"textures": None, "far": FAR, "anti_aliasing": False, "outputs": ("alpha", "depth")}
    ours = nr.rasterize_images(native[0], 24, two_sided=True, **options)
    theirs = nr.rasterize_images(both, 24, **options)
    assert torch.equal(ours.alpha, theirs.alpha)
    # The corners in another order are other roundings.
    torch.testing.assert_close(ours.depth, theirs.depth, **rounding(16, FAR))
    options |= {"outputs": ("rgb", "alpha")}
    options.pop("textures")
    ours = nr.rasterize_images(native[0], 24, two_sided=True, textures=native[1], **options)
    theirs = nr.rasterize_images(both, 24, textures=twice, **options)
    # Weights, then places among 3 texels along each of three axes, whose colours are up to about 3 apart.
    torch.testing.assert_close(ours.rgb, theirs.rgb, **rounding(256, 3))
    pull = scene.noise(2, 3, 24, 24).to(device)
    for images in (ours, theirs):
        ((images.rgb * pull).sum() + (images.alpha * pull[:, 0]).sum()).backward()
    for a, b in zip(native, doubled, strict=True):
        assert (a.grad - b.grad).norm() <= 1e-3 * b.grad.norm()


@pytest.mark.usefixtures("deterministic")
def test_arguments_are_never_changed(device):
    _, faces, *_ = scene_inputs(device)
    inputs = [faces, torch.rand(2, 9, 2, 2, 2, 3), torch.rand(2, 2, 9, 3), torch.rand(2, 3, 14, 18)]
    inputs = [t.to(device).requires_grad_() for t in inputs]
    before = [t.detach().clone() for t in inputs]
    images = nr.rasterize_images(inputs[0], (14, 18), textures=inputs[1], light=inputs[2], background=inputs[3])
    sum(image.sum() for image in images).backward()
    assert all(torch.equal(a, b) for a, b in zip(inputs, before, strict=True))
    # A caller who changes the result does not change the tensors saved for the gradient.
    grads = [t.grad.clone() for t in inputs]
    for t in inputs:
        t.grad = None
    images = nr.rasterize_images(inputs[0], (14, 18), textures=inputs[1], light=inputs[2], background=inputs[3])
    total = sum(image.sum() for image in images)
    images.alpha.data.zero_()
    total.backward()
    assert all(torch.equal(t.grad, g) for t, g in zip(inputs, grads, strict=True))


def test_non_contiguous_inputs(device):
    _, faces, *_ = scene_inputs(device)
    cubes = torch.rand(2, 9, 2, 2, 2, 3, device=device)
    strided = faces.transpose(0, 3).contiguous().transpose(0, 3)
    turned = cubes.transpose(0, 5).contiguous().transpose(0, 5)
    assert not strided.is_contiguous() and torch.equal(draw(strided, turned), draw(faces, cubes))
    one = faces[:1].expand(4, -1, -1, -1).requires_grad_()
    nr.rasterize_silhouettes(one, 16).sum().backward()


MEMORY = """
import resource, sys, torch
import neural_renderer as nr
vertices, faces = nr.icosphere(8)  # 1.3 million faces, the largest; and some of them again
faces = torch.cat((faces, faces[: 1_600_000 - len(faces)]))
vertices = (vertices * torch.tensor([0.9, 0.9, 0.9]) + torch.tensor([0, 0, 3.0]))[None].requires_grad_()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
alpha, = [i for i in nr.rasterize_images(nr.vertices_to_faces(vertices, faces), 1024, outputs="alpha", two_sided=True,
                                         anti_aliasing=False, perspective=False) if i is not None]
(alpha * torch.linspace(-1, 1, 1024)).sum().backward()
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
covered = float(alpha.mean())
assert len(faces) == 1_600_000 and vertices.grad.isfinite().all() and vertices.grad.any()
print(covered, peak / 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="measures memory with the resource module, in Linux's units")
def test_a_mesh_of_1600000_faces():
    """Memory grows with pixels and faces, not with their product: some 60 bytes a pixel and 150 a face, 0.3 GiB."""
    done = run_python("-c", MEMORY)
    assert done.returncode == 0, done.stderr
    covered, mebibytes = map(float, done.stdout.split())
    assert abs(covered - 3.14159 / 4 * 0.81) < 1e-3  # of a disc's area, its outline's pixels being all or nothing
    assert mebibytes < 1024
