"""Visible faces: against the reference, ties, both sides, behind the camera. `draw_face` runs in its kernels."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from neural_renderer.meshes.primitives import icosphere
from neural_renderer.raster.ops.coverage import coverage
from tests.raster.reference.coverage import coverage_reference
from tests.raster.scenes import FAR, FRONT, NEAR, Scene, doubt, examples, scenes


def draw(scene: Scene, device: str) -> torch.Tensor:
    options = (scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective)
    return coverage(scene.faces.to(device), *options).cpu()


def check_each_pixel(scene: Scene, found: torch.Tensor) -> None:
    """No face is drawn where it surely is not, or behind one that surely is nearer; none is missing."""
    for b in range(scene.batch if scene.count else 0):
        open_ = doubt(scene.faces[b], scene.height, scene.width, scene.two_sided, scene.perspective)
        low, high = open_.depth - open_.error, open_.depth + open_.error
        certain = open_.certain & (low > NEAR) & (high < FAR)
        possible = open_.possible & (high > NEAR) & (low < FAR)
        nearest = torch.where(certain, high, math.inf).min(0).values
        index = found[b].clamp(min=0).long()[None]
        visible = found[b] >= 0
        assert possible.gather(0, index)[0][visible].all()
        assert (low.gather(0, index)[0] <= nearest)[visible].all()
        assert not certain.any(0)[~visible].any()
        # Identical faces have identical depths: the first of them is seen.
        same = (scene.faces[b][:, None] == scene.faces[b]).flatten(2).all(2)
        first = same.int().argmax(0)
        assert torch.equal(first[found[b][visible].long()], found[b][visible].long())


@examples(25)
@given(scene=scenes())
def test_random_scenes(device, scene):
    found = draw(scene, device)
    assert found.dtype == torch.int32 and found.shape == (scene.batch, scene.height, scene.width)
    check_each_pixel(scene, found)


def test_few_pixels_differ_from_the_reference(device):
    """Rounding decides at centres within some 1e-6 pixels of an edge: at most one centre in 10,000."""
    differ = total = 0
    for seed in range(6):
        scene = Scene(seed, 2, 20, 40, 37, seed % 2 == 0, seed % 3 != 0, FRONT)
        found = draw(scene, device)
        expected = coverage_reference(scene.faces, 40, 37, NEAR, FAR, scene.two_sided, scene.perspective)
        differ += int((found != expected).sum())
        total += found.numel()
    assert differ <= 1e-4 * total


@examples(60)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(1, 30),
    side=st.sampled_from([1, 2, 8, 16, 32]),
    two_sided=st.booleans(),
    perspective=st.booleans(),
)
def test_exact_where_float32_is(device, seed, count, side, two_sided, perspective):
    """Corners on a grid finer than the pixels and depths that are powers of two: nothing is rounded, many centres lie
    exactly on edges and corners, many depths tie, and every pixel must agree."""
    random = torch.Generator().manual_seed(seed)
    faces = torch.randint(-80, 81, (2, count, 3, 3), generator=random) / 64
    faces[..., 2] = 2.0 ** torch.randint(-1, 2, (2, count, 1), generator=random)
    found = coverage(faces.to(device), side, 2 * side, NEAR, FAR, two_sided, perspective).cpu()
    assert torch.equal(found, coverage_reference(faces, side, 2 * side, NEAR, FAR, two_sided, perspective))


@pytest.mark.parametrize("reverse", [False, True])
def test_planes_have_no_holes(device, reverse):
    """Every centre inside a triangulated square is covered, wherever the square lies, from whichever side."""
    n, size = 9, 64
    for seed in range(40):
        random = torch.Generator().manual_seed(seed)
        grid = torch.stack(torch.meshgrid(torch.arange(n), torch.arange(n), indexing="ij"), -1).float()
        inner = ((grid > 0) & (grid < n - 1)).all(-1, keepdim=True)
        grid = (grid + inner * 0.7 * (torch.rand(n, n, 2, generator=random) - 0.5)) / (n - 1) * 1.6 - 0.8
        angle = float(torch.rand((), generator=random)) * 6.3
        turn = torch.tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        shift = torch.rand(2, generator=random) * 4 / size
        points = torch.cat((grid @ turn.T + shift, torch.full((n, n, 1), 2.0)), -1)
        a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
        faces = torch.stack((torch.stack((a, b, c), 2), torch.stack((a, c, d), 2))).reshape(1, -1, 3, 3)
        faces = faces.flip(2) if reverse else faces
        if seed % 2:
            faces = faces[:, torch.randperm(faces.shape[1], generator=random)]
        found = coverage(faces.to(device), size, size, NEAR, FAR, True, True).cpu()[0]
        outline = torch.stack((points[0, 0], points[-1, 0], points[-1, -1], points[0, -1])).double()
        square = outline[torch.tensor([[0, 1, 2], [0, 2, 3]])][None]
        square[..., :2] = (square[..., :2] - shift) * (1 - 1e-6) + shift
        inside = coverage_reference(square, size, size, NEAR, FAR, True, True)[0] >= 0
        assert inside.sum() > 1000 and (found[inside] >= 0).all(), f"seed {seed}: a hole"


def test_spheres_have_no_holes(device):
    """A closed surface covers the same pixels from its front and from its back, and without holes."""
    vertices, faces = icosphere(3, 0.7)
    random = torch.Generator().manual_seed(0)
    shift = torch.rand(24, 1, 2, generator=random) / 16
    points = torch.cat((vertices[:, :2] + shift, 3 - vertices[:, 2:].expand(24, -1, 1)), -1)
    corners = points[:, faces.long()]
    front = coverage(corners.to(device), 48, 48, NEAR, FAR, False, False).cpu() >= 0
    back = coverage(corners.flip(2).contiguous().to(device), 48, 48, NEAR, FAR, False, False).cpu() >= 0
    both = coverage(corners.to(device), 48, 48, NEAR, FAR, True, False).cpu() >= 0
    assert torch.equal(front, both)
    # The front and the back meet in the silhouette's edges, whose twin edges agree exactly.
    assert torch.equal(back, both)
    # Convex, so a row's pixels follow each other.
    changes = (front[:, :, 1:] != front[:, :, :-1]).sum(2)
    assert changes.max() == 2 and front.any(2).any(1).all()


@examples(30)
@given(scene=scenes(FRONT))
def test_two_sided_is_appending_reversed_faces(device, scene):
    faces = scene.faces.to(device)
    appended = torch.cat((faces, faces.flip(2)), 1)
    args = (scene.height, scene.width, NEAR, FAR)
    both = coverage(faces, *args, True, scene.perspective)
    expected = coverage(appended, *args, False, scene.perspective)
    assert torch.equal(both, torch.where(expected >= 0, expected % max(scene.count, 1), -1))


def test_faces_that_exist_twice(device):
    """Many models contain each face twice, once reversed: the copy that faces the camera is visible everywhere.

    Its depth is that of the other copy's back to the last bit, and at equal depth fronts come before backs.
    """
    faces = Scene(0, 2, 200, 1, 1, True, True, ("plain", "tiny")).faces
    twice = torch.cat((faces, faces.flip(2)), 1)
    for perspective in (False, True):
        found = coverage(twice.to(device), 128, 128, NEAR, FAR, True, perspective).cpu()
        front = coverage(twice.to(device), 128, 128, NEAR, FAR, False, perspective).cpu()
        assert (found >= 0).any() and torch.equal(found, front)


def test_near_and_far_cut_pixels_not_faces(device):
    # A slope from depth 1 (left) to 3 (right), orthographic: linear across the screen.
    slope = torch.tensor([[[[-1.0, -1, 1], [3, -1, 5], [-1, 3, 1]]]], device=device)
    found = coverage(slope, 1, 8, 1.5, 2.5, False, False).cpu()[0, 0]
    assert found.tolist() == [-1, -1, 0, 0, 0, 0, -1, -1]


def test_floor_through_the_camera(device):
    """An endless-looking floor below the eye fills exactly the pixels below the horizon that are nearer than far."""
    floor = torch.tensor([[-50.0, -1, -20], [50, -1, -20], [0, -1, 200]])
    screen = torch.cat((floor[:, :2] / floor[:, 2:], floor[:, 2:]), 1)
    found = coverage(screen[None, None].to(device), 64, 64, 0.1, 100.0, True, True).cpu()[0]
    expected = coverage_reference(screen[None, None], 64, 64, 0.1, 100.0, True, True)[0]
    assert torch.equal(found, expected)
    rows = (found >= 0).all(1)
    assert rows[33:].all() and not (found[:32] >= 0).any()
    assert (
        not (coverage(screen[None, None].to(device), 64, 64, 0.1, 100.0, False, True) >= 0).any()
        or not (
            coverage(screen[None, None].flip(2).contiguous().to(device), 64, 64, 0.1, 100.0, False, True) >= 0
        ).any()
    )


@pytest.mark.parametrize("z", [(-1.0, 3.0, 3.0), (-1.0, 3.0, -1.0)])
def test_orthographic_face_through_the_camera_plane(device, z):
    """Without perspective a corner behind the camera does not reverse a face; only ``near`` matters."""
    faces = torch.tensor([[[[-1.0, -1, z[0]], [3, -1, z[1]], [-1, 3, z[2]]]]])
    for two_sided in (False, True):
        found = coverage(faces.to(device), 8, 8, 0.0, 100.0, two_sided, False).cpu()
        assert torch.equal(found, coverage_reference(faces, 8, 8, 0.0, 100.0, two_sided, False))
        assert (found == 0).any()
