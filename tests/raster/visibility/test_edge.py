"""The derivative through visibility, `gradient="edge"`, against the reference."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import neural_renderer as nr
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.reference.edge import boundaries_reference
from neural_renderer.raster.visibility.edge import boundaries, boundaries_backward
from tests.raster.scenes import FAR, NEAR, Scene, examples, scenes
from tests.rounding import rounding

KINDS = ("plain", "plain", "tiny", "huge", "outside", "point", "copy", "flat")


def gradient(grad, image, faces, index, two_sided, perspective, seams, edge_hashes=None):
    faces, image = faces.clone().requires_grad_(), image.clone().requires_grad_()
    output = boundaries(image, faces, index, two_sided, perspective, seams, edge_hashes)
    assert torch.equal(output, image)
    output.backward(grad)
    assert torch.equal(image.grad, grad)
    return faces.grad


def jittered(faces: torch.Tensor, seed: int) -> torch.Tensor:
    """Corners moved by more than float32 rounds by, equal ones alike; float64."""
    corners, order = faces.double().reshape(-1, 3).unique(dim=0, return_inverse=True)
    random = torch.rand(corners.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 2 - 1
    return (corners + 1.5e-6 * random * (corners.abs() + 1))[order].view(faces.shape)


def compare(
    device, faces, height, width, channels, two_sided, perspective, seams, seed=0, edge_hashes=None
) -> torch.Tensor:
    """Kernels and reference agree as far as float32 can know; returns how many faces could tell, and of how many.

    Where a crossing is near a pixel's centre or border, or two depths nearly equal, rounding decides. The reference
    itself says where: with the corners moved by about a pixel's rounding, in several ways, it gives something else.
    """
    index = coverage(faces.to(device), height, width, NEAR, FAR, two_sided, perspective)
    random = torch.Generator().manual_seed(seed)
    image, grad = torch.randn(2, len(faces), channels, height, width, generator=random).to(device)
    options = (two_sided, perspective, seams)
    found = gradient(
        grad, image, faces.to(device), index, *options, None if edge_hashes is None else edge_hashes.to(device)
    ).cpu()
    maps = [grad.cpu(), image.cpu()]
    expected = boundaries_reference(*maps, faces, index.cpu(), *options, edge_hashes)
    others = [boundaries_reference(*maps, jittered(faces, n), index.cpu(), *options, edge_hashes) for n in range(4)]
    spread = torch.stack([(other - expected).abs().flatten(2).amax(2) for other in others]).amax(0)
    size = expected.abs().flatten(2).amax(2)
    difference = (found - expected).abs().flatten(2).amax(2)
    known = spread < 1e-2 * size + 1e-6
    assert (difference <= 3 * spread + 1e-4 * size + 1e-5)[known].all(), (difference / size)[known].max()
    assert not found[size + spread == 0].any()
    return torch.tensor([(known & (size > 0)).sum(), (size > 0).sum()])


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
    """Among them of faces that cut through each other, in z as well."""
    told = torch.zeros(2)
    for seed in range(5):
        faces = Scene(seed, 1, 8, 20, 27, True, perspective, ("plain", "outside", "tiny")).faces
        told += compare(device, faces, 20, 27, 3, seed % 2 == 0, perspective, seed % 3 == 0, seed)
    assert told[0] >= 0.9 * told[1] and told[1] >= 20


def ball(seed: int, level: int, bumps: float = 0.0) -> torch.Tensor:
    """[1, F, 3, 3]: an icosphere from somewhere, not quite in the middle, so that no corner is where lines go."""
    random = torch.Generator().manual_seed(seed)
    vertices, faces = nr.icosphere(level)
    vertices = vertices * (1 + bumps * torch.randn(len(vertices), 1, generator=random))
    eye = 2.7 * torch.nn.functional.normalize(torch.randn(3, generator=random), dim=0)
    screen = nr.Camera.look_at(eye, viewing_angle=25)(vertices) + torch.tensor([0.0123, 0.0217, 0])
    return nr.vertices_to_faces(screen, faces)


@pytest.mark.parametrize("seams", [False, True])
@pytest.mark.parametrize("perspective", [False, True])
def test_closed_surfaces(device, seams, perspective):
    """Narrow faces beside the outline, for which the next one stands in; seams of any width."""
    told = torch.zeros(2)
    for seed, level in ((0, 0), (1, 1), (2, 2)):
        told += compare(device, ball(seed, level), 17, 24, 2, seed % 2 == 0, perspective, seams, seed)
    assert told[0] >= 0.8 * told[1] and told[1] >= 30


@pytest.mark.parametrize("seams", [False, True])
def test_surfaces_with_valleys(device, seams):
    told = torch.zeros(2)
    for seed, level in ((0, 0), (1, 1), (2, 0)):
        told += compare(device, ball(seed, level, 0.2), 20, 27, 2, seed % 2 == 0, True, seams, seed)
    assert told[0] >= 0.8 * told[1] and told[1] > 20


def test_a_valley_does_not_cut(device):
    """An open book before a wall: where its pages meet, depth is the same to the last bit, and moves nothing."""
    random = torch.Generator().manual_seed(0)
    book = torch.tensor([[0, -0.9, 3.0], [0, 0.9, 3], [-0.8, 0, 2], [0.8, 0, 2]])
    wall = torch.tensor([[[-9.0, -9, 5], [9, -9, 5], [0, 9, 5]]])
    for _ in range(20):
        pages = (book + 0.1 * torch.rand(4, 3, generator=random))[torch.tensor([[0, 1, 2], [0, 3, 1]])]
        faces = torch.cat((pages, wall))[None].to(device)
        index = coverage(faces, 16, 16, NEAR, FAR, True, True)
        found = boundaries_backward(
            torch.ones_like(index)[:, None].float(), index[:, None].float(), faces, index, True, True, False
        )
        assert not found[..., 2].any()


def quads(device, turn: float = 0.13) -> torch.Tensor:
    """Two quads that cut through each other, the one upright, the other turned about the vertical."""
    one = torch.tensor(
        [[-0.713, -0.621, 1.6], [0.707, -0.617 - turn, 2.6], [0.719, 0.631, 2.6], [-0.723, 0.629 + turn, 1.6]]
    )
    other = torch.tensor(
        [[-0.611, -0.727, 2.7], [0.613, -0.731, 1.7], [0.619, 0.733, 1.6], [-0.627 + turn, 0.717, 2.6]]
    )
    space = torch.cat((one, other))
    return space[torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])][None].to(device)


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("seams", [False, True])
def test_faces_that_cut_through_each_other(device, perspective, seams):
    faces = quads("cpu")
    told = compare(device, faces, 40, 33, 3, True, perspective, seams)
    assert told[0] == 4
    index = coverage(faces.to(device), 40, 33, NEAR, FAR, True, perspective)
    image = (index < 2).float()[:, None]
    found = boundaries_backward(torch.ones_like(image), image, faces.to(device), index, True, perspective, seams)
    # All that the first gains, it gains by coming nearer, and the other by going away.
    assert (found[0, :2, :, 2].sum() < -1) and (found[0, 2:, :, 2].sum() > 1)


def test_cuts_against_differences(device):
    """The area that one of two quads shows, by each corner's depth: in the mean over shifts, a central difference.

    But for the ends of the cut: of its length, about 25 pixels, one is missing.
    """
    faces, size, fine = quads(device), 48, 32

    def white(at, size):
        return (coverage(at, size, size, NEAR, FAR, True, True).clamp(min=-1) // 2 == 0).float()[:, None]

    shifts = (
        torch.cartesian_prod(torch.arange(8.0), torch.arange(8.0))
        + torch.rand(64, 2, generator=torch.Generator().manual_seed(0))
    ) / 8
    moved = faces + 2 / size * torch.cat((shifts, torch.zeros(64, 1)), 1).to(device)[:, None, None]
    index = coverage(moved, size, size, NEAR, FAR, True, True)
    image = white(moved, size)
    mean = boundaries_backward(torch.ones_like(image), image, moved, index, True, True, False).mean(0)
    for same in (faces[0] == corner for corner in faces.reshape(-1, 3).unique(dim=0)):
        same = same.all(-1)
        areas = []
        for sign in (1, -1):
            moved = faces.clone()
            moved[0, :, :, 2] += 0.02 * sign * same
            areas.append(float(white(moved, size * fine).sum()) / fine**2)
        expected = (areas[0] - areas[1]) / 0.04
        found = float(mean[..., 2][same].sum())
        assert abs(found - expected) < 0.06 * abs(expected) + 0.1, (found, expected)


@pytest.mark.parametrize("side", range(4))
def test_outlines_over_the_border_of_the_image(device, side):
    """A triangle with a corner beyond a border: what is seen of it, by each corner, in the mean over shifts."""
    size, shifts = 32, 8
    corners = torch.tensor([[-3.7, 28.3], [2.2, 5.1], [21.4, 27.6]], dtype=torch.float64, requires_grad=True)
    far, near = corners[0], corners[1:]
    a, b = far + (near - far) * (-far[0] / (near[:, 0] - far[0]))[:, None]  # where it meets x = 0
    quad = torch.stack((a, near[0], near[1], b))
    x, y = quad.unbind(1)
    area = (x * y.roll(-1) - y * x.roll(-1)).sum().abs() / 2
    (expected,) = torch.autograd.grad(area, corners)

    def turned(points):  # so that another border is crossed
        for _ in range(side):
            points = torch.stack((-points[..., 1], points[..., 0]), -1)
        return points

    offsets = (torch.cartesian_prod(torch.arange(shifts), torch.arange(shifts)) + 0.5) / shifts - 0.5
    screen = turned((2 * (corners.detach() + offsets[:, None]) / size - 1).float())
    faces = torch.cat((screen, torch.full_like(screen[..., :1], 2)), -1)[:, None].to(device)
    index = coverage(faces, size, size, NEAR, FAR, True, True)
    image = (index >= 0).float()[:, None]
    mean = boundaries_backward(torch.ones_like(image), image, faces, index, True, True, True).mean(0)[0, :, :2]
    # The mean over 64 shifts of edges of 20 to 40 pixels: 2 % of an area.
    torch.testing.assert_close(
        mean.cpu().double() * 2 / size, turned(expected), rtol=0, atol=0.02 * float(expected.norm())
    )


def test_faces_in_one_plane_do_not_cut(device):
    """The same face twice, from another corner on, as rounding shows it: nothing finite moves the line between them."""
    random = torch.Generator().manual_seed(0)
    for _ in range(100):
        face = torch.rand(3, 3, generator=random) * torch.tensor([1.8, 1.8, 2]) - torch.tensor([0.9, 0.9, -1])
        faces = torch.stack((face, face[[1, 2, 0]]))[None].to(device)
        index = coverage(faces, 32, 32, NEAR, FAR, True, True)
        image = (1.0 + index)[:, None]
        found = boundaries_backward(torch.ones_like(image), image, faces, index, True, True, True)
        assert found.isfinite().all() and found.abs().max() < 1e3


@pytest.mark.parametrize("depth", [1.5, 0.0, -0.1])
def test_orthographic_face_through_the_camera_plane(device, depth):
    """A corner behind an orthographic camera is like any other."""
    faces = torch.tensor([[[[-0.53, -0.51, 1.0], [0.52, -0.39, 1.0], [0.057, 0.61, depth]]]])
    told = compare(device, faces, 8, 9, 1, True, False, True)
    assert told.tolist() == [1, 1]


@examples(12)
@given(scene=scenes(("crossing", "plain"), most_faces=3, side=20, empty=False), seams=st.booleans())
def test_faces_through_the_camera_plane(device, scene, seams):
    """Edges with both ends in front move as ever; others have no place on the screen."""
    compare(device, scene.faces[:2], scene.height, scene.width, 2, scene.two_sided, True, seams)


def test_a_line_through_a_corner(device):
    """A quad of two triangles, a corner of which is on a row of centres: that row counts as the others do."""
    pixel = torch.tensor([[3.2, 8.3], [9.4, 1.3], [12.1, 7], [5.9, 10.1]])
    corners = torch.cat(((2 * pixel + 1 - 16) / 16, torch.full((4, 1), 2.0)), 1)
    for cut in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]):
        faces = corners[torch.tensor(cut)][None].to(device)
        index = coverage(faces, 16, 16, NEAR, FAR, False, True)
        image = (index >= 0).float()[:, None]
        near = boundaries_backward(torch.ones_like(image), image, faces, index, False, True, False)
        moved = faces + torch.tensor([0, 1e-5, 0], device=device)
        index = coverage(moved, 16, 16, NEAR, FAR, False, True)
        other = boundaries_backward(torch.ones_like(image), image, moved, index, False, True, False)
        # Moved by 1e-5 of 8 pixels, lines of some 10 pixels' length change by less than a thousandth of themselves.
        torch.testing.assert_close(near.sum((1, 2)), other.sum((1, 2)), rtol=1e-3, atol=1e-2)


@pytest.fixture
def threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def test_same_bits_from_run_to_run_whatever_the_threads(device, threads):
    faces = torch.cat((ball(0, 2, 0.2), Scene(3, 1, 320, 8, 8, True, True, ("plain", "tiny")).faces)).to(device)
    index = coverage(faces, 48, 40, NEAR, FAR, True, True)
    image, grad = Scene(4, 1, 1, 1, 1, True, True, ()).noise(2, 2, 3, 48, 40).to(device)
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(True)
    try:
        results = []
        for count in (1, 2, 1, 3, 2):
            threads(count)
            results.append(boundaries_backward(grad, image, faces, index, True, True, True))
    finally:
        torch.use_deterministic_algorithms(before)
    assert results[0].any() and all(torch.equal(results[0], other) for other in results)


def test_operators_are_registered_well(device):
    scene = Scene(1, 2, 5, 12, 9, True, True, ("plain",))
    faces = scene.faces.to(device)
    index = coverage(faces, 12, 9, NEAR, FAR, True, True)
    image = scene.noise(2, 3, 12, 9).to(device)
    leaves = image.clone().requires_grad_(), faces.clone().requires_grad_()
    torch.library.opcheck(boundaries.operator, (*leaves, index, True, True, True))
    torch.library.opcheck(boundaries_backward.operator, (image, image, faces, index, True, True, False))


def test_tensors_of_any_strides(device):
    scene = Scene(3, 1, 6, 24, 30, True, True, ("plain",))
    faces = scene.faces.to(device)
    index = coverage(faces, 24, 30, NEAR, FAR, True, True)
    image, grad = scene.noise(2, 1, 24, 30, 3).permute(0, 1, 4, 2, 3).to(device)
    expected = boundaries_backward(grad.contiguous(), image.contiguous(), faces, index, True, True, True)
    many = [t.expand(4, *t.shape[1:]) for t in (grad, image, faces, index)]
    found = gradient(many[0], many[1], many[2], many[3], True, True, True)
    # Sums over some 2 x (24 + 30) crossings, of other strides in another order.
    torch.testing.assert_close(found, expected.expand_as(found), **rounding(4 * 54, float(expected.abs().max())))


@pytest.mark.parametrize("shape", [(0, 2, 3, 8), (1, 0, 3, 8), (1, 2, 0, 8), (1, 2, 3, 0)])
def test_empty(device, shape):
    batch, count, channels, side = shape
    faces, image = torch.rand(batch, count, 3, 3, device=device), torch.rand(batch, channels, side, 8, device=device)
    index = torch.full((batch, side, 8), -1, dtype=torch.int32, device=device)
    found = gradient(image, image, faces, index, True, True, True)
    assert found.shape == faces.shape and not found.any()


def test_what_is_not_seen_has_no_gradient(device):
    """Behind another face, turned away, outside."""
    face = torch.tensor([[-0.5, -0.5, 1.0], [0.5, -0.5, 1], [0, 0.5, 1]])
    others = [face * torch.tensor([0.9, 0.9, 2]), face.flip(0), face + torch.tensor([3.0, 0, 0])]
    faces = torch.stack((face, *others))[None].to(device)
    index = coverage(faces, 16, 16, NEAR, FAR, False, True)
    image, grad = Scene(0, 1, 1, 1, 1, True, True, ()).noise(2, 1, 3, 16, 16).to(device)
    for seams in (False, True):
        found = boundaries_backward(grad, image, faces, index, False, True, seams)
        assert found[0, 0].any() and not found[0, 1:].any()


@pytest.mark.parametrize("perspective", [False, True])
def test_a_constant_image_has_no_gradient(device, perspective):
    """To the last bit, if the colour is one with few digits: continued colours are the same then."""
    for seed in range(5):
        faces = torch.cat((ball(seed, 1, 0.2), Scene(seed, 1, 80, 8, 8, True, True, KINDS).faces), 1).to(device)
        index = coverage(faces, 24, 31, NEAR, FAR, True, perspective)
        grad = Scene(seed, 1, 1, 1, 1, True, True, ()).noise(1, 2, 24, 31).to(device)
        found = boundaries_backward(grad, torch.zeros_like(grad), faces, index, True, perspective, True)
        assert not found.any()
        found = boundaries_backward(grad, torch.full_like(grad, 0.5), faces, index, True, perspective, True)
        assert found.abs().max() < 1e-2


def test_size_does_not_depend_on_channels_that_do_not_change(device):
    """A channel without gradient, or the same everywhere, adds nothing."""
    faces = Scene(5, 2, 5, 20, 20, True, True, ("plain",)).faces.to(device)
    index = coverage(faces, 20, 20, NEAR, FAR, True, True)
    image = (index >= 0).float()[:, None]
    grad = Scene(5, 1, 1, 1, 1, True, True, ()).noise(*image.shape).to(device)
    alone = boundaries_backward(grad, image, faces, index, True, True, True)
    images = torch.cat((image, torch.zeros_like(image), torch.randn_like(image)), 1)
    grads = torch.cat((grad, grad, torch.zeros_like(grad)), 1)
    found = boundaries_backward(grads, images, faces, index, True, True, True)
    torch.testing.assert_close(found, alone, **rounding(4 * 20, float(alone.abs().max())))


@pytest.mark.parametrize("batch", [1, 2])
def test_seams_of_equal_marks_are_left_out(device, batch):
    faces = ball(3, 1).repeat(2, 1, 1, 1)
    edge_hashes = torch.randint(0, 2, (batch, faces.shape[1], 3, 2), generator=torch.Generator().manual_seed(batch))
    told = compare(device, faces, 40, 33, 3, True, True, True, 1, edge_hashes)
    assert told[0] > 30
    index = coverage(faces.to(device), 40, 33, NEAR, FAR, True, True)
    image, grad = torch.randn(2, 2, 3, 40, 33, device=device)
    for value, seams in ((0, True), (7, False)):
        equal = torch.full((1, faces.shape[1], 3, 2), value, device=device)
        found = boundaries_backward(grad, image, faces.to(device), index, True, True, True, equal)
        expected = boundaries_backward(grad, image, faces.to(device), index, True, True, seams)
        assert torch.equal(found, expected)


def test_an_edge_within_a_plane_of_one_colour_has_no_gradient(device):
    """Two white triangles make a square: moving what they share shows nothing."""
    corners = torch.tensor([[-0.61, -0.52, 2.0], [0.57, -0.63, 2], [0.66, 0.49, 2], [-0.43, 0.71, 2]])
    faces = corners[torch.tensor([[0, 1, 2], [0, 2, 3]])][None].to(device)
    index = coverage(faces, 30, 30, NEAR, FAR, False, True)
    image = (index >= 0).float()[:, None]
    grad = Scene(0, 1, 1, 1, 1, True, True, ()).noise(1, 1, 30, 30).to(device)
    with_seams = boundaries_backward(grad, image, faces, index, False, True, True)
    without = boundaries_backward(grad, image, faces, index, False, True, False)
    torch.testing.assert_close(with_seams, without, **rounding(4 * 30, float(without.abs().max())))
    assert without.any()
    # Only the inside pulls: the outline is left alone, and so is the diagonal.
    inside = -torch.nn.functional.max_pool2d(-image, 5, 1, 2)
    assert not boundaries_backward(grad * inside, image, faces, index, False, True, True).any()


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
    assert faces.grad[..., 2].any() == (outputs != ("alpha",))  # faces cut through each other, and have depth
    assert "rgb" not in outputs or (cubes.grad.isfinite().all() and cubes.grad.any())


def test_drop_in_functions_take_it(device):
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


def test_rasterize_functions_take_it(device):
    faces = ball(0, 1).to(device)
    cubes = torch.rand(1, faces.shape[1], 2, 2, 2, 3, device=device)
    calls = {"rasterize": (cubes,), "rasterize_rgbad": (cubes,), "rasterize_silhouettes": (), "rasterize_depth": ()}
    for name, textures in calls.items():
        leaf = faces.clone().requires_grad_()
        images = getattr(nr, name)(leaf, *textures, image_size=24, gradient="edge")
        for image in images.values() if isinstance(images, dict) else [images]:
            (grad,) = torch.autograd.grad(
                (image * torch.linspace(-1, 1, 24, device=device)).sum(), leaf, retain_graph=True
            )
            assert grad.isfinite().all() and grad.any(), name


@pytest.mark.parametrize("perspective", [False, True])
def test_depth_within_a_face_has_its_derivative(device, perspective):
    """Of a tilted quad, at pixels away from its border: what a central difference gives for each corner."""
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
