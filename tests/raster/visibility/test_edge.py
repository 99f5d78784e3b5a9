"""The estimator `gradient="edge"` against its reference and closed forms.

Its parts, `crossings`, `outlines`, `seams`, `gains` and `nearness`, run inside its kernel and are tested through it.
"""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import neural_renderer as nr
from neural_renderer.camera.rotations import from_axis_angle
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.visibility.edge import EdgeOptions, edge_gradient, edge_gradient_backward
from tests.raster.scenes import FAR, NEAR, Scene, examples, scenes
from tests.raster.visibility.checks import ball, compare, send_gradient
from tests.rounding import rounding

KINDS = ("plain", "plain", "tiny", "huge", "outside", "point", "copy", "flat")


@examples(30)
@given(
    scene=scenes(KINDS, most_faces=6, side=20, empty=False),
    channels=st.integers(1, 4),
    seams=st.booleans(),
)
def test_random_scenes(device, scene, channels, seams):
    faces, options = scene.faces[:2], (scene.two_sided, scene.perspective, seams)
    compare(device, faces, scene.height, scene.width, channels, *options)


@pytest.mark.parametrize("perspective", [False, True])
def test_most_gradients_are_compared(device, perspective):
    """Rounding decides nothing about at least nine in ten faces with a gradient, some of which intersect."""
    compared = torch.zeros(2)
    for seed in range(5):
        faces = Scene(seed, 1, 8, 20, 27, True, perspective, ("plain", "outside", "tiny")).faces
        compared += compare(device, faces, 20, 27, 3, seed % 2 == 0, perspective, seed % 3 == 0, seed)
    assert compared[0] >= 0.9 * compared[1] and compared[1] >= 20


@pytest.mark.parametrize("seams", [False, True])
@pytest.mark.parametrize("perspective", [False, True])
def test_closed_surfaces(device, seams, perspective):
    """Faces narrower than a pixel at the outline, with adjacent faces as stand-ins; seams of faces of any width."""
    compared = torch.zeros(2)
    for seed, level in ((0, 0), (1, 1), (2, 2)):
        compared += compare(device, ball(seed, level), 17, 24, 2, seed % 2 == 0, perspective, seams, seed)
    assert compared[0] >= 0.8 * compared[1] and compared[1] >= 30


@pytest.mark.parametrize("seams", [False, True])
def test_surfaces_that_hide_parts_of_themselves(device, seams):
    compared = torch.zeros(2)
    for seed, level in ((0, 0), (1, 1), (2, 0)):
        compared += compare(device, ball(seed, level, 0.2), 20, 27, 2, seed % 2 == 0, True, seams, seed)
    assert compared[0] >= 0.8 * compared[1] and compared[1] > 20


@pytest.mark.parametrize("side", range(4))
def test_outlines_over_the_border_of_the_image(device, side):
    """The mean derivative of the visible area of a triangle by each corner, one of which is outside the image."""
    size, shifts = 32, 8
    corners = torch.tensor([[-3.7, 28.3], [2.2, 5.1], [21.4, 27.6]], dtype=torch.float64, requires_grad=True)
    far, near = corners[0], corners[1:]
    a, b = far + (near - far) * (-far[0] / (near[:, 0] - far[0]))[:, None]  # the crossings of its edges with x = 0
    quad = torch.stack((a, near[0], near[1], b))
    x, y = quad.unbind(1)
    area = (x * y.roll(-1) - y * x.roll(-1)).sum().abs() / 2
    (expected,) = torch.autograd.grad(area, corners)

    def turned(points):  # a quarter turn for each further border
        for _ in range(side):
            points = torch.stack((-points[..., 1], points[..., 0]), -1)
        return points

    offsets = (torch.cartesian_prod(torch.arange(shifts), torch.arange(shifts)) + 0.5) / shifts - 0.5
    screen = turned((2 * (corners.detach() + offsets[:, None]) / size - 1).float())
    faces = torch.cat((screen, torch.full_like(screen[..., :1], 2)), -1)[:, None].to(device)
    index = coverage(faces, size, size, NEAR, FAR, True, True)
    image = (index >= 0).float()[:, None]
    mean = edge_gradient_backward(torch.ones_like(image), image, faces, index, EdgeOptions(True, True, True)).mean(0)[
        0, :, :2
    ]
    # The mean over 64 shifts of edges of 20 to 40 pixels: 2 % of an area.
    torch.testing.assert_close(
        mean.cpu().double() * 2 / size, turned(expected), rtol=0, atol=0.02 * float(expected.norm())
    )


@pytest.mark.parametrize("depth", [1.5, 0.0, -0.1])
def test_orthographic_face_through_the_camera_plane(device, depth):
    """An orthographic camera has no plane that corners could lie behind."""
    faces = torch.tensor([[[[-0.53, -0.51, 1.0], [0.52, -0.39, 1.0], [0.057, 0.61, depth]]]])
    compared = compare(device, faces, 8, 9, 1, True, False, True)
    assert compared.tolist() == [1, 1]


@examples(12)
@given(scene=scenes(("crossing", "plain"), most_faces=3, side=20, empty=False), seams=st.booleans())
def test_faces_through_the_camera_plane(device, scene, seams):
    """Edges with both ends in front have their gradient; others have none."""
    compare(device, scene.faces[:2], scene.height, scene.width, 2, scene.two_sided, True, seams)


def test_a_scan_line_through_a_corner_counts_once(device):
    """A quad of two triangles with a corner on a row of centres has the gradient of the quad moved by 1e-5."""
    pixel = torch.tensor([[3.2, 8.3], [9.4, 1.3], [12.1, 7], [5.9, 10.1]])
    corners = torch.cat(((2 * pixel + 1 - 16) / 16, torch.full((4, 1), 2.0)), 1)
    for cut in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]):
        faces = corners[torch.tensor(cut)][None].to(device)
        index = coverage(faces, 16, 16, NEAR, FAR, False, True)
        image = (index >= 0).float()[:, None]
        near = edge_gradient_backward(torch.ones_like(image), image, faces, index, EdgeOptions(False, True, False))
        moved = faces + torch.tensor([0, 1e-5, 0], device=device)
        index = coverage(moved, 16, 16, NEAR, FAR, False, True)
        other = edge_gradient_backward(torch.ones_like(image), image, moved, index, EdgeOptions(False, True, False))
        # Moved by 1e-5 of 8 pixels, lines of some 10 pixels' length change by less than a thousandth of themselves.
        torch.testing.assert_close(near.sum((1, 2)), other.sum((1, 2)), rtol=1e-3, atol=1e-2)


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.usefixtures("deterministic")
def test_gradients_are_deterministic_for_any_number_of_threads(device, threads):
    faces = torch.cat((ball(0, 2, 0.2), Scene(3, 1, 320, 8, 8, True, True, ("plain", "tiny")).faces)).to(device)
    index = coverage(faces, 48, 40, NEAR, FAR, True, True)
    image, grad = Scene(4, 1, 1, 1, 1, True, True, ()).noise(2, 2, 3, 48, 40).to(device)
    results = []
    for count in (1, 2, 1, 3, 2):
        threads(count)
        results.append(edge_gradient_backward(grad, image, faces, index, EdgeOptions(True, True, True)))
    assert results[0].any() and all(torch.equal(results[0], other) for other in results)


def test_operators_pass_opcheck(device):
    scene = Scene(1, 2, 5, 12, 9, True, True, ("plain",))
    faces = scene.faces.to(device)
    index = coverage(faces, 12, 9, NEAR, FAR, True, True)
    image = scene.noise(2, 3, 12, 9).to(device)
    leaves = image.clone().requires_grad_(), faces.clone().requires_grad_()
    torch.library.opcheck(edge_gradient.operator, (*leaves, index, EdgeOptions(True, True, True)))
    torch.library.opcheck(edge_gradient_backward.operator, (image, image, faces, index, EdgeOptions(True, True, False)))


def test_tensors_of_any_strides(device):
    scene = Scene(3, 1, 6, 24, 30, True, True, ("plain",))
    faces = scene.faces.to(device)
    index = coverage(faces, 24, 30, NEAR, FAR, True, True)
    image, grad = scene.noise(2, 1, 24, 30, 3).permute(0, 1, 4, 2, 3).to(device)
    expected = edge_gradient_backward(
        grad.contiguous(), image.contiguous(), faces, index, EdgeOptions(True, True, True)
    )
    many = [t.expand(4, *t.shape[1:]) for t in (grad, image, faces, index)]
    found = send_gradient(many[0], many[1], many[2], many[3], True, True, True)
    # Sums of about 2 x (24 + 30) crossings; other strides change their order.
    torch.testing.assert_close(found, expected.expand_as(found), **rounding(4 * 54, float(expected.abs().max())))


@pytest.mark.parametrize("shape", [(0, 2, 3, 8), (1, 0, 3, 8), (1, 2, 0, 8), (1, 2, 3, 0)])
def test_empty(device, shape):
    batch, count, channels, side = shape
    faces, image = torch.rand(batch, count, 3, 3, device=device), torch.rand(batch, channels, side, 8, device=device)
    index = torch.full((batch, side, 8), -1, dtype=torch.int32, device=device)
    found = send_gradient(image, image, faces, index, True, True, True)
    assert found.shape == faces.shape and not found.any()


def test_invisible_faces_have_no_gradient(device):
    """Faces behind another one, turned away, and outside the image."""
    face = torch.tensor([[-0.5, -0.5, 1.0], [0.5, -0.5, 1], [0, 0.5, 1]])
    others = [face * torch.tensor([0.9, 0.9, 2]), face.flip(0), face + torch.tensor([3.0, 0, 0])]
    faces = torch.stack((face, *others))[None].to(device)
    index = coverage(faces, 16, 16, NEAR, FAR, False, True)
    image, grad = Scene(0, 1, 1, 1, 1, True, True, ()).noise(2, 1, 3, 16, 16).to(device)
    for seams in (False, True):
        found = edge_gradient_backward(grad, image, faces, index, EdgeOptions(False, True, seams))
        assert found[0, 0].any() and not found[0, 1:].any()


@pytest.mark.parametrize("perspective", [False, True])
def test_a_constant_image_has_no_gradient(device, perspective):
    """Exactly 0 for a colour that extrapolation does not round."""
    for seed in range(5):
        faces = torch.cat((ball(seed, 1, 0.2), Scene(seed, 1, 80, 8, 8, True, True, KINDS).faces), 1).to(device)
        index = coverage(faces, 24, 31, NEAR, FAR, True, perspective)
        grad = Scene(seed, 1, 1, 1, 1, True, True, ()).noise(1, 2, 24, 31).to(device)
        found = edge_gradient_backward(grad, torch.zeros_like(grad), faces, index, EdgeOptions(True, perspective, True))
        assert not found.any()
        found = edge_gradient_backward(
            grad, torch.full_like(grad, 0.5), faces, index, EdgeOptions(True, perspective, True)
        )
        assert found.abs().max() < 1e-2


def test_channels_without_contrast_or_gradient_add_nothing(device):
    """A constant channel, and one without a gradient."""
    faces = Scene(5, 2, 5, 20, 20, True, True, ("plain",)).faces.to(device)
    index = coverage(faces, 20, 20, NEAR, FAR, True, True)
    image = (index >= 0).float()[:, None]
    grad = Scene(5, 1, 1, 1, 1, True, True, ()).noise(*image.shape).to(device)
    alone = edge_gradient_backward(grad, image, faces, index, EdgeOptions(True, True, True))
    images = torch.cat((image, torch.zeros_like(image), torch.randn_like(image)), 1)
    grads = torch.cat((grad, grad, torch.zeros_like(grad)), 1)
    found = edge_gradient_backward(grads, images, faces, index, EdgeOptions(True, True, True))
    torch.testing.assert_close(found, alone, **rounding(4 * 20, float(alone.abs().max())))


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("batch", [1, 2])
def test_edges_with_matching_hashes_are_no_seams(device, batch):
    faces = ball(3, 1).repeat(2, 1, 1, 1)
    edge_hashes = torch.randint(0, 2, (batch, faces.shape[1], 3, 2), generator=torch.Generator().manual_seed(batch))
    compared = compare(device, faces, 40, 33, 3, True, True, True, 1, edge_hashes)
    assert compared[0] > 30
    index = coverage(faces.to(device), 40, 33, NEAR, FAR, True, True)
    image, grad = torch.randn(2, 2, 3, 40, 33, device=device)
    for value, seams in ((0, True), (7, False)):
        equal = torch.full((1, faces.shape[1], 3, 2), value, device=device)
        found = edge_gradient_backward(grad, image, faces.to(device), index, EdgeOptions(True, True, True), equal)
        expected = edge_gradient_backward(grad, image, faces.to(device), index, EdgeOptions(True, True, seams))
        assert torch.equal(found, expected)


def test_an_edge_within_a_plane_of_one_colour_has_no_gradient(device):
    """The diagonal of a white square of two triangles."""
    corners = torch.tensor([[-0.61, -0.52, 2.0], [0.57, -0.63, 2], [0.66, 0.49, 2], [-0.43, 0.71, 2]])
    faces = corners[torch.tensor([[0, 1, 2], [0, 2, 3]])][None].to(device)
    index = coverage(faces, 30, 30, NEAR, FAR, False, True)
    image = (index >= 0).float()[:, None]
    grad = Scene(0, 1, 1, 1, 1, True, True, ()).noise(1, 1, 30, 30).to(device)
    with_seams = edge_gradient_backward(grad, image, faces, index, EdgeOptions(False, True, True))
    without = edge_gradient_backward(grad, image, faces, index, EdgeOptions(False, True, False))
    torch.testing.assert_close(with_seams, without, **rounding(4 * 30, float(without.abs().max())))
    assert without.any()
    # With a gradient inside the square only, neither the outline nor the diagonal has one.
    inside = -torch.nn.functional.max_pool2d(-image, 5, 1, 2)
    assert not edge_gradient_backward(grad * inside, image, faces, index, EdgeOptions(False, True, True)).any()


TEXTURED = {"rgb": ("rgb",), "alpha": ("alpha",), "depth": ("depth",), "all": ("rgb", "alpha", "depth")}


@pytest.mark.parametrize("anti_aliasing", [False, True])
@pytest.mark.parametrize("outputs", TEXTURED.values(), ids=TEXTURED)
def test_images(device, outputs, anti_aliasing):
    scene = Scene(7, 2, 12, 20, 27, True, True, ("plain", "tiny", "outside"))
    faces = scene.faces.to(device).requires_grad_()
    cubes = scene.noise(1, 12, 2, 2, 2, 3).to(device).requires_grad_()
    options = {"outputs": outputs, "anti_aliasing": anti_aliasing, "textures": cubes if "rgb" in outputs else None}
    images = nr.rasterize_images(faces, (20, 27), gradient="edge", **options)
    plain = nr.rasterize_images(faces, (20, 27), gradient="nmr", **options)
    asked = [image for image in images if image is not None]
    assert len(asked) == len(outputs)
    for image, other in zip(images, plain, strict=True):
        assert (image is None and other is None) or torch.equal(image, other)
    sum((image * scene.noise(*image.shape).to(device)).sum() for image in asked).backward()
    assert faces.grad.isfinite().all() and faces.grad[..., :2].any()
    assert faces.grad[..., 2].any() == (outputs != ("alpha",))  # faces intersect, and have depth
    assert "rgb" not in outputs or (cubes.grad.isfinite().all() and cubes.grad.any())


def test_drop_in_renderer_takes_the_estimator(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    cubes = torch.rand(1, len(faces), 2, 2, 2, 3, device=device)
    for name in ("render", "render_silhouettes", "render_depth", "render_rgb"):
        grads = {}
        for gradient in ("edge", "nmr"):
            renderer = nr.Renderer(image_size=24, camera_mode="look_at", gradient=gradient)
            renderer.eye = nr.get_points_from_angles(2.732, 20, 40)
            leaf = vertices[None].clone().requires_grad_()
            shape = (leaf, faces[None]) + ((cubes,) if name in ("render", "render_rgb") else ())
            images = getattr(renderer, name)(*shape)
            image = images[0] if isinstance(images, tuple) else images
            (image * torch.linspace(-1, 1, 24, device=device)).sum().backward()
            assert leaf.grad.isfinite().all() and leaf.grad.any()
            grads[gradient] = leaf.grad
        assert not torch.equal(grads["edge"], grads["nmr"])


def test_rasterize_functions_take_the_estimator(device):
    """Their images and gradients are those of `rasterize_images`."""
    faces = ball(0, 1).to(device)
    cubes = torch.rand(1, faces.shape[1], 2, 2, 2, 3, device=device)
    weights = torch.linspace(-1, 1, 24, device=device)
    calls = {"rasterize": "rgb", "rasterize_silhouettes": "alpha", "rasterize_depth": "depth", "rasterize_rgbad": ""}
    for name, output in calls.items():
        textures = cubes if output in ("rgb", "") else None
        leaves = [faces.clone().requires_grad_() for _ in range(2)]
        found = getattr(nr, name)(leaves[0], *[cubes] * (textures is not None), image_size=24, gradient="edge")
        outputs = (output,) if output else ("rgb", "alpha", "depth")
        images = nr.rasterize_images(leaves[1], 24, outputs=outputs, textures=textures, gradient="edge")
        for each in outputs:
            pair = found[each] if isinstance(found, dict) else found, getattr(images, each)
            grads = [
                torch.autograd.grad((image * weights).sum(), leaf, retain_graph=True)[0]
                for image, leaf in zip(pair, leaves, strict=True)
            ]
            assert torch.equal(*pair) and grads[0].any(), (name, each)
            torch.testing.assert_close(*grads, rtol=0, atol=1e-5 * float(grads[1].abs().max()))


@pytest.mark.parametrize("perspective", [False, True])
def test_depth_inside_faces_is_differentiated(device, perspective):
    """Depth of a tilted quad, away from its border, against central differences."""
    corners = torch.tensor(
        [[-0.8, -0.7, 1.5], [0.7, -0.8, 2.5], [0.8, 0.7, 3.1], [-0.7, 0.8, 1.9]], dtype=torch.float64
    )
    order = torch.tensor([[0, 1, 2], [0, 2, 3]])
    weight = torch.zeros(24, 24)
    weight[9:15, 9:15] = Scene(0, 1, 1, 1, 1, True, True, ()).noise(6, 6)

    def depth(at):
        faces = at[order][None].float().to(device)
        options = {"outputs": ("depth",), "anti_aliasing": False, "perspective": perspective, "gradient": "edge"}
        return (nr.rasterize_images(faces, 24, **options).depth[0].cpu().double() * weight).sum()

    leaf = corners.clone().requires_grad_()
    (found,) = torch.autograd.grad(depth(leaf), leaf)
    for k in range(4):
        for axis in range(3):
            step = torch.zeros(4, 3, dtype=torch.float64)
            step[k, axis] = 2e-3
            expected = (depth(corners + step) - depth(corners - step)) / 4e-3
            assert abs(found[k, axis] - expected) < 0.03 * found.abs().max(), (k, axis)


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("halved", [False, True])
def test_silhouettes_need_no_image(device, halved):
    """The gradient is that of the image of 0 and 1, to the last bit."""
    scene = Scene(6, 2, 9, 24, 36, True, True, ("plain", "tiny"))
    faces = scene.faces.to(device)
    index = coverage(faces, 24, 36, NEAR, FAR, True, True)
    image = (index >= 0).float()[:, None]
    grad = scene.noise(2, 1, 12, 18) if halved else scene.noise(*image.shape)
    outputs, grads = [], []
    for shown in (None, image):
        leaf = faces.clone().requires_grad_()
        outputs.append(edge_gradient(shown, leaf, index, EdgeOptions(True, True, False, halved)))
        outputs[-1].backward(grad.to(device))
        grads.append(leaf.grad)
    assert torch.equal(*outputs) and torch.equal(*grads) and grads[0].any()


@pytest.mark.parametrize("angles", [(-3.0, 17.0, 0.0), (-3.0, 30.0, 2e-4), (6.0, 17.0, 0.0), (-30.0, 45.0, 1e-3)])
@pytest.mark.parametrize("place", [0.0, 100.0])
def test_faces_seen_edge_on_have_no_outline(device, angles, place):
    """Rounding decides how they run. A ramp times the silhouette changes by its slope times the area of the box."""
    vertices, faces = nr.cube()
    vertices = 0.5 * vertices / vertices.abs().max()
    for axis, degrees in zip((0, 2, 1), angles, strict=True):
        turn = torch.zeros(3)
        turn[axis] = degrees * torch.pi / 180
        vertices = vertices @ from_axis_angle(turn).T
    center, size, count = torch.tensor([place, place / 2, 0.0]), 24, 8
    seen = torch.linalg.cross(*(vertices[faces.long()][:, k] - vertices[faces.long()][:, 0] for k in (1, 2)))
    area = seen[:, 2].abs().sum() / 4 * (size / 2) ** 2  # in pixels; each is seen from both sides
    leaf = (vertices + center).to(device).requires_grad_()
    eye = center + torch.tensor([0.0, 0.0, 4.0])
    camera = nr.Camera.look_at(eye[None].to(device), center[None].to(device), orthographic=True)
    steps = (torch.arange(float(count)) + 0.5) / count - 0.5
    views = camera[[0] * count**2].shifted(torch.cartesian_prod(steps, steps), (size, size))
    alpha = nr.render((leaf, faces.to(device)), views, size, outputs=("alpha",), anti_aliasing=False).alpha
    (alpha * torch.arange(float(size), device=device)).sum().div(count**2).backward()
    assert abs(float(leaf.grad[:, 0].sum()) / float(area * size / 2) - 1) < 0.01
