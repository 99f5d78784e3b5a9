"""The paper's gradient through visibility, against the reference. It tests the sums along scan lines too."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neural_renderer.raster.colors.downsample import halve, halve_backward
from neural_renderer.raster.ops.coverage import coverage, silhouette
from neural_renderer.raster.visibility.nmr import nmr_gradient
from neural_renderer.raster.warp.layout import concurrent
from tests.raster.reference.nmr import nmr_gradient_reference
from tests.raster.scenes import FAR, NEAR, Scene, examples, scenes
from tests.rounding import rounding

KINDS = ("plain", "plain", "tiny", "huge", "outside", "point", "line", "copy", "flat")


def gradient(image, faces, index, eps, two_sided, binary, grad):
    faces = faces.clone().requires_grad_()
    image = image.clone().requires_grad_()
    output = nmr_gradient(None if binary else image, faces, index, eps, two_sided)
    assert torch.equal(output, image)
    output.backward(grad)
    assert image.grad is None if binary else torch.equal(image.grad, grad)
    return faces.grad.cpu()


def share_in_doubt(faces: torch.Tensor, height: int, width: int, eps: float) -> torch.Tensor:
    """Bound the relative error of each face's gradient in float32; infinite if another pixel may be the nearest.

    It is 2^-24 of the pixel coordinates, grown by the edge's slope, over the distance to the nearest pixel.
    """
    result = torch.zeros(faces.shape[:2], dtype=torch.float64)
    for b, f in torch.cartesian_prod(*(torch.arange(n) for n in faces.shape[:2])).tolist():
        corners = faces[b, f].double()
        if len(corners.unique(dim=0)) < 3:
            continue
        for k in range(3):
            for axis, (lines, length) in enumerate(((height, width), (width, height))):
                ends = corners[[k, (k + 1) % 3]]
                pu, qu = ((lines * ends[:, 1 - axis] + lines - 1) / 2).tolist()
                pv, qv = ((length * ends[:, axis] + length - 1) / 2).tolist()
                last = 3e-7 * max(abs(pu), abs(qu), abs(pv), abs(qv), lines, length)
                u = torch.arange(lines, dtype=torch.float64)
                if abs(pu - qu) <= last or min((u - pu).abs().min(), (u - qu).abs().min()) <= last:
                    result[b, f] = torch.inf
                    continue
                u = u[(u > min(pu, qu)) & (u < max(pu, qu))]
                slope = (qv - pv) / (qu - pu)
                c = pv + slope * (u - pu)
                c = c[(c > -1) & (c < length)]
                if not len(c):
                    continue
                doubt, distance = last * (1 + abs(slope)), (c - c.round()).abs().min()
                share = doubt / (distance + eps * length / 2) if distance > doubt else torch.inf
                result[b, f] = max(float(result[b, f]), float(share))
    return result


@examples(40)
@given(
    scene=scenes(KINDS, most_faces=8, side=24, empty=False),
    channels=st.integers(1, 4),
    eps=st.sampled_from([1e-3, 1e-4]),
    ones=st.booleans(),
)
def test_random_scenes(device, scene, channels, eps, ones):
    """Any image, whatever the faces have to do with it; and the silhouette, also by the faster path for it."""
    faces = scene.faces
    index = coverage(faces.to(device), scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective)
    image = (index >= 0).float()[:, None] if ones else scene.noise(len(index), channels, *index.shape[1:]).to(device)
    grad = scene.noise(*image.shape).flip(0).to(device)
    expected = nmr_gradient_reference(grad, image, faces, index, eps, scene.two_sided)
    size = expected.abs().flatten(2).amax(2)
    # Pulls outward and inward partly cancel: twice the share.
    error = (2 * share_in_doubt(faces, scene.height, scene.width, eps) + 1e-5) * size + 1e-5
    known = error < 0.1 * size + 1e-4
    assert known.float().mean() >= 0.3 or not size.any()
    for binary in (False, True) if ones else (False,):
        found = gradient(image, faces.to(device), index, eps, scene.two_sided, binary, grad)
        assert not found[..., 2].any() and found.isfinite().all()
        difference = (found - expected).abs().flatten(2).amax(2)
        assert (difference <= error)[known].all(), (difference / size)[known].max()


def test_most_gradients_agree_closely(device):
    """Over many scenes, the faces that no crossing near a pixel centre puts in doubt: 2e-4 of each face's gradient."""
    compared = total = 0
    for seed in range(4):
        scene = Scene(seed, 1, 10, 24, 31, seed % 2 == 0, True, ("plain", "outside", "tiny"))
        faces = scene.faces
        index = coverage(faces.to(device), 24, 31, NEAR, FAR, scene.two_sided, True)
        image, grad = (scene.noise(2, 1, 3, *index.shape[1:])).to(device)
        found = gradient(image, faces.to(device), index, 1e-3, scene.two_sided, False, grad)
        expected = nmr_gradient_reference(grad, image, faces, index, 1e-3, scene.two_sided)
        drawn = expected.abs().flatten(2).amax(2) > 0
        clear = drawn & (share_in_doubt(faces, 24, 31, 1e-3) < 2e-3)
        difference = (found - expected).norm(dim=(2, 3)) / expected.norm(dim=(2, 3))
        assert (difference[clear] <= 2e-4).all()
        compared, total = compared + int(clear.sum()), total + int(drawn.sum())
    assert compared >= 0.8 * total > 0


@pytest.mark.parametrize("live", [0, 1, 3])
def test_channels_without_a_gradient_have_no_part(device, live):
    scene = Scene(3, 2, 10, 24, 31, True, True, ("plain", "tiny"))
    index = coverage(scene.faces.to(device), 24, 31, NEAR, FAR, True, True)
    image, grad = scene.noise(2, 2, 5, 24, 31).to(device)
    grad[:, live:] = 0
    found = gradient(image, scene.faces.to(device), index, 1e-3, True, False, grad)
    alone = gradient(image[:, :live], scene.faces.to(device), index, 1e-3, True, False, grad[:, :live])
    # A face's edges pass some 2 x (24 + 31) pixels, whose pulls may be summed in another order.
    torch.testing.assert_close(found, alone, **rounding(2 * (24 + 31), float(alone.abs().max())))
    assert bool(found.any()) == (live > 0)


def on_pixels(side: int) -> list[torch.Tensor]:
    """Triangles whose corners are pixel centres, with edges along rows, columns and diagonals: nothing is rounded."""
    pixel = torch.tensor([[2, 1], [6, 1], [6, 5], [2, 5], [4, 3], [0, 0]], dtype=torch.float32)
    corners = torch.cat(((2 * pixel + 1 - side) / side, torch.full((6, 1), 2.0)), 1)
    triangles = ([0, 1, 2], [0, 2, 3], [0, 1, 3], [4, 1, 2], [5, 1, 2], [2, 1, 0])
    return [corners[torch.tensor(triangle)][None, None] for triangle in triangles]


@pytest.mark.parametrize("side", [8, 16])
@pytest.mark.parametrize("binary", [False, True])
def test_centres_exactly_on_edges(device, side, binary):
    """A pixel on the edge, at no distance from it, takes the sign of its side."""
    for faces in on_pixels(side):
        index = coverage(faces.to(device), side, side, NEAR, FAR, True, True)
        image = (index >= 0).float()[:, None]
        for seed in range(3):
            grad = torch.randn(image.shape, generator=torch.Generator().manual_seed(seed)).to(device)
            for x, y in ((side * faces[0, 0, :, :2] + side - 1) / 2).int().tolist():
                grad[0, 0, side - 1 - y, x] = 0  # for the corners see the next test
            expected = nmr_gradient_reference(grad, image, faces, index, 1e-3, True)
            found = gradient(image, faces.to(device), index, 1e-3, True, binary, grad)
            # Terms of the size 1 / eps that cancel leave their float32 rounding.
            torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=6e-7 / 1e-3)


def test_centres_exactly_on_corners(device):
    """On the line through one of its ends, an edge moves with this end only."""
    for faces in on_pixels(8):
        index = coverage(faces.to(device), 8, 8, NEAR, FAR, True, True)
        image = (index >= 0).float()[:, None]
        expected = nmr_gradient_reference(image, image, faces, index, 1e-3, True)
        found = gradient(image, faces.to(device), index, 1e-3, True, False, image)
        torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-4)


def crossing_case(scene, device, sign):
    faces = scene.faces
    index = coverage(faces.to(device), scene.height, scene.width, NEAR, FAR, scene.two_sided, True)
    image = (index >= 0).float()[:, None]
    grad = sign * scene.noise(*image.shape).abs().to(device)
    expected = nmr_gradient_reference(grad, image, faces, index, 1e-3, scene.two_sided)
    found = gradient(image, faces.to(device), index, 1e-3, scene.two_sided, True, grad)
    share = 10 * share_in_doubt(faces, scene.height, scene.width, 1e-3) + 1e-5
    difference = (found - expected).abs().flatten(2).amax(2)
    assert (difference <= share * expected.abs().flatten(2).amax(2) + 1e-5)[share < 0.1].all()


@examples(20)
@given(scene=scenes(("crossing",), most_faces=3, side=20, empty=False))
def test_faces_through_the_camera_plane_are_pulled_outward(device, scene):
    """Edges with both ends in front pull as ever; others have no place on the screen."""
    crossing_case(scene, device, -1)


def test_faces_through_the_camera_plane_are_pulled_inward(device):
    for seed in range(20):
        crossing_case(Scene(seed, 1, 1, 16, 16, True, True, ("crossing",)), device, 1)


def test_tensors_of_any_strides(device):
    """Expanded and cropped tensors are read correctly."""
    scene = Scene(3, 1, 6, 24, 30, True, True, ("plain",))
    faces = scene.faces.to(device)
    index = coverage(faces, 24, 30, NEAR, FAR, True, True)[:, 2:20, 4:28]
    image, grad = scene.noise(2, 1, 3, 18, 24).to(device)
    expected = gradient(image, faces, index.contiguous(), 1e-3, True, False, grad)
    many = [t.expand(5, *t.shape[1:]) for t in (image, faces, index)]
    found = gradient(many[0], many[1], many[2], 1e-3, True, False, grad.expand(5, -1, -1, -1))
    # Tasks that run all at once add their sums of up to 2 (18 + 24) lines in any order.
    allowed = rounding(2 * (18 + 24), float(expected.abs().max())) if concurrent(faces.device) else rounding(0)
    torch.testing.assert_close(found, expected.expand_as(found), **allowed)
    assert torch.equal(silhouette(many[2]), silhouette(index.contiguous()).expand(5, -1, -1, -1))


def test_what_is_not_seen_has_no_gradient(device):
    faces = torch.tensor([[[-0.5, -0.5, 1.0], [0.5, -0.5, 1], [0, 0.5, 1]]])
    faces = torch.stack((faces[0], faces[0] + torch.tensor([0, 0, 1.0]), faces[0].flip(0)))[None].to(device)
    index = coverage(faces, 16, 16, NEAR, FAR, False, True)
    image = (index >= 0).float()[:, None]
    found = gradient(image, faces, index, 1e-3, False, False, -torch.ones_like(image))
    assert found[0, 0].any() and not found[0, 1:].any()


@pytest.mark.parametrize("binary", [False, True])
def test_size_does_not_depend_on_channels_that_do_not_change(device, binary):
    """A channel without gradient, or the same everywhere, adds nothing."""
    scene = Scene(5, 2, 5, 20, 20, True, True, ("plain",))
    faces = scene.faces.to(device)
    index = coverage(faces, 20, 20, NEAR, FAR, True, True)
    image = (index >= 0).float()[:, None]
    grad = scene.noise(*image.shape).to(device)
    alone = gradient(image, faces, index, 1e-3, True, binary, grad)
    images = torch.cat((image, torch.ones_like(image), torch.randn_like(image)), 1)
    grads = torch.cat((grad, grad, torch.zeros_like(grad)), 1)
    found = gradient(images, faces, index, 1e-3, True, False, grads)
    torch.testing.assert_close(found, alone, **rounding(4 * 20, float(alone.abs().max())))


@pytest.mark.usefixtures("deterministic")
def test_averaged_silhouettes_have_the_gradient_of_their_pixels(device):
    """Each pixel of a block has a quarter of its gradient, to the last bit."""
    scene = Scene(6, 2, 9, 24, 36, True, True, ("plain", "tiny"))
    faces = scene.faces.to(device)
    index = coverage(faces, 24, 36, NEAR, FAR, True, True)
    image = (index >= 0).float()[:, None]
    grad = scene.noise(2, 1, 12, 18).to(device)
    alone = gradient(image, faces, index, 1e-3, True, True, halve_backward(grad))
    leaf = faces.clone().requires_grad_()
    output = nmr_gradient(None, leaf, index, 1e-3, True, True)
    assert torch.equal(output, halve(image))
    output.backward(grad)
    assert torch.equal(leaf.grad.cpu(), alone) and alone.any()


@pytest.mark.usefixtures("deterministic")
def test_averaged_images_have_the_gradients_of_their_pixels(device):
    scene = Scene(7, 2, 9, 24, 36, True, True, ("plain", "tiny"))
    faces = scene.faces.to(device)
    index = coverage(faces, 24, 36, NEAR, FAR, True, True)
    image, grad = scene.noise(2, 3, 24, 36).to(device), scene.noise(2, 3, 12, 18).to(device)
    alone = gradient(image, faces, index, 1e-3, True, False, halve_backward(grad))
    leaves = image.clone().requires_grad_(), faces.clone().requires_grad_()
    output = nmr_gradient(*leaves, index, 1e-3, True, True)
    assert torch.equal(output, halve(image))
    output.backward(grad)
    assert torch.equal(leaves[0].grad, halve_backward(grad))
    assert torch.equal(leaves[1].grad.cpu(), alone) and alone.any()
