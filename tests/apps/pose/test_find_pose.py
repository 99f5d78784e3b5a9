"""Poses of a small object, from photos, silhouettes, depth and several cameras."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.pose.descent import _joined
from neural_renderer.apps.pose.model import Model, Poses
from neural_renderer.apps.pose.search import settled
from neural_renderer.apps.pose.target import Picture

ANGLE = 18.0


def thing() -> nr.Mesh:
    """An object without symmetry: an ellipsoid with a horn and an arm, dark on one side."""
    vertices, faces = nr.icosphere(3)
    horn = 0.9 * (vertices @ torch.tensor([0.6, 0.7, 0.39])).clamp(min=0) ** 8
    arm = 0.7 * (vertices @ torch.tensor([-0.9, 0.1, 0.42])).clamp(min=0) ** 10
    vertices = vertices * (1 + horn + arm)[:, None] * torch.tensor([1.0, 0.75, 0.5])
    colors = 0.6 + 0.3 * torch.sin(5 * vertices)
    return nr.Mesh(2 * vertices + 1, faces, vertex_colors=colors)  # neither around the origin nor of size 1


def placed(seed: int) -> torch.Tensor:
    random = torch.Generator().manual_seed(seed)
    pose = torch.eye(4)
    pose[:3, :3] = nr.rotations.from_quaternion(torch.randn(4, generator=random))
    pose[:3, 3] = torch.tensor([0.3, -0.2, 14.0]) - pose[:3, :3] @ torch.ones(3)
    return pose


def seen(pose: torch.Tensor, size: int = 96, **options: object) -> nr.Images:
    camera = nr.Camera.from_matrix(world_to_camera=pose, viewing_angle=ANGLE)
    light = nr.Light(direction=tuple((pose[:3, :3].T @ torch.tensor([0.3, -0.6, -0.7])).tolist()))
    return nr.render(thing(), camera, size, light=light, shading="smooth", **options)


def turned(found: torch.Tensor, pose: torch.Tensor) -> torch.Tensor:
    return nr.rotations.to_axis_angle(found[:3, :3] @ pose[:3, :3].T)


def place(pose: torch.Tensor) -> torch.Tensor:
    x, y, z = (pose @ torch.cat((Model.of(thing()).center, torch.ones(1))))[:3]
    return torch.stack((x / z, y / z, -z.log()))


def check(found: torch.Tensor, pose: torch.Tensor, degrees: float = 1.0, share: float = 0.01) -> None:
    assert math.degrees(float(turned(found, pose).norm())) < degrees
    center = torch.tensor([1.0, 1, 1, 1])
    assert float((found @ center - pose @ center).norm()) < share * 14


@pytest.mark.parametrize(("kind", "seed"), [("photo", 1), ("silhouette", 4)])
def test_one_picture(kind: str, seed: int) -> None:
    pose = placed(seed)
    images = seen(pose, 64)
    found = nr.find_pose(thing(), images.rgb[0] if kind == "photo" else None, images.alpha[0], viewing_angle=ANGLE)
    check(found.matrix, pose)
    assert found.agreement > 0.98 and found.verdict == "match" and not found.advice
    assert found.viewing_angle == pytest.approx(ANGLE, rel=1e-5)
    again = nr.render(thing(), found.camera, 64, outputs=("alpha",)).alpha
    assert float(nr.metrics.silhouette_iou(again, images.alpha)) > 0.98
    error = torch.cat((turned(found.matrix, pose), place(found.matrix) - place(pose)))
    assert float(error @ torch.linalg.solve(found.covariance, error)) < 54  # of six squared normal numbers, once in 1e9


@pytest.mark.slow
def test_covariance_of_photos_knows_wrong_light() -> None:
    """Errors over covariance are about 1 under a directional light; with small blocks alone they are 1.5."""
    squares = []
    for seed in range(1, 9):
        pose, random = placed(seed), torch.Generator().manual_seed(seed)
        images = seen(pose, 64)
        photo = (images.rgb[0] + 0.02 * torch.randn(3, 64, 64, generator=random)).clamp(0, 1)
        found = nr.find_pose(thing(), photo, images.alpha[0], viewing_angle=ANGLE)
        error = torch.cat((turned(found.matrix, pose), place(found.matrix) - place(pose)))
        squares.append(float(error @ torch.linalg.solve(found.covariance, error)) / 6)
    assert 0.5 < math.sqrt(sum(squares) / len(squares)) < 1.4


def test_blocks_of_a_jackknife_join_their_neighbours() -> None:
    blocks = torch.rand(2, 8, 8, 3, generator=torch.Generator().manual_seed(0))
    joined = _joined(blocks.flatten(0, 2), 2).view(2, 4, 4, 3)
    torch.testing.assert_close(joined[1, 3, 2], blocks[1, 6:, 4:6].sum((0, 1)))
    assert torch.equal(_joined(blocks.flatten(0, 2), 1), blocks.flatten(0, 2))


@pytest.mark.slow
def test_hidden_in_part() -> None:
    """The mask shows what is left of the object beside a straight edge."""
    pose = placed(2)
    images = seen(pose, 48)
    left = images.alpha[0] * (torch.arange(48) < 26)
    found = nr.find_pose(thing(), images.rgb[0], left, viewing_angle=ANGLE, hidden=True)
    check(found.matrix, pose, degrees=2.0, share=0.02)
    assert found.agreement > 0.95


def test_hidden_in_part_from_a_start() -> None:
    """What the mask lacks neither moves the object nor makes it smaller."""
    pose, size = placed(2), 48
    images = seen(pose, size)
    start = nr.find_pose(thing(), mask=images.alpha[0], viewing_angle=ANGLE)
    left = images.alpha[0] * (torch.arange(size) < 26)
    found = nr.find_pose(thing(), images.rgb[0], left, viewing_angle=ANGLE, hidden=True, start=start)
    check(found.matrix, pose, degrees=2.0, share=0.02)
    assert found.agreement > 0.95


def test_places_of_hidden_objects_follow_colours_too() -> None:
    """A pose a third of the object's radius beside the true one returns to it, to less than a step of the grid."""
    pose, size = placed(2), 48
    images = seen(pose, size)
    model = Model.of(thing())
    focal = size / 2 / math.tan(math.radians(ANGLE))
    K = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    left = images.alpha[0] * (torch.arange(size) < 26)
    picture = Picture(K, torch.eye(3, 4), left, images.rgb[0] * left)
    crop = picture.crop(picture.window(1.7), size)
    size_on_it = torch.tensor([0.0, 0, math.log(model.scale)])
    true = Poses(pose[None, :3, :3], (place(pose) + size_on_it)[None], torch.zeros(1, 1))
    radius = true.place[:, 2:].exp()
    beside = Poses(true.rotation, true.place + 0.3 * radius * torch.tensor([1.0, -1, 0]), true.zoom)
    cost = math.inf
    for reach, steps in ((0.4, 5), (0.13, 3)):
        before, (beside, costs) = cost, settled(model, beside, crop, picture.motion, 2.0, reach, steps)
        cost = float(costs)
        assert cost < before
    assert float((beside.place - true.place)[:, :2].norm() / radius) < 0.2
    assert abs(float(beside.place[0, 2] - true.place[0, 2])) < 0.2


@pytest.mark.slow
def test_start_and_focal_length() -> None:
    """From a pose nearby, with a focal length that is wrong by a fifth."""
    images, near = seen(placed(2)), seen(placed(2) + 0.0)
    first = nr.find_pose(thing(), near.rgb[0], near.alpha[0], viewing_angle=ANGLE)
    wrong = math.degrees(math.atan(1.2 * math.tan(math.radians(ANGLE))))
    found = nr.find_pose(thing(), images.rgb[0], images.alpha[0], viewing_angle=wrong, fit_focal=True, start=first)
    assert found.viewing_angle == pytest.approx(ANGLE, rel=0.05)
    check(found.matrix, placed(2), share=0.06)
    assert found.covariance.shape == (7, 7)


def test_depth_and_two_cameras() -> None:
    """The pose is that in the world of the cameras."""
    world = placed(3)
    eyes = torch.tensor([[0.0, 0.0, 14.0], [12.0, 3.0, 6.0]])
    middle = (world @ torch.tensor([1.0, 1, 1, 1]))[:3]
    camera = nr.Camera.look_at(middle + eyes, middle, viewing_angle=ANGLE)
    mesh = thing()
    moved = nr.Mesh(mesh.vertices @ world[:3, :3].T + world[:3, 3], mesh.faces)
    images = nr.render(moved, camera, 64)
    depth = nr.render(moved, camera, 64, anti_aliasing=False, outputs=("depth", "alpha"))
    found = nr.find_pose(mesh, mask=images.alpha, depth=depth.depth * depth.alpha, camera=camera)
    check(found.matrix, world, degrees=0.1, share=0.001)  # a far background at outlines made errors ten times as large


def test_symmetric_objects_are_ambiguous() -> None:
    mesh = nr.Mesh(*nr.cube())
    view = nr.Camera.look_at((2.0, 3.0, 5.0), viewing_angle=ANGLE)
    mask = nr.render(mesh, view, 64, outputs=("alpha",)).alpha[0]
    found = nr.find_pose(mesh, mask=mask, viewing_angle=ANGLE)
    assert found.verdict == "ambiguous" and "symmetric" in found.advice[0]
    assert found.agreement > 0.97 and len(found.others)


def test_another_object_is_a_mismatch() -> None:
    mask = torch.zeros(32, 32)
    mask[4:6, 4:28] = mask[4:28, 4:6] = mask[26:28, 4:28] = mask[4:28, 26:28] = 1  # a frame
    found = nr.find_pose(thing(), mask=mask, viewing_angle=ANGLE)
    assert found.verdict == "mismatch" and "does not match" in found.advice[0]


def test_another_object_of_a_similar_outline_is_a_mismatch() -> None:
    images = seen(placed(1), 48)
    vertices, faces = nr.icosphere(3)
    stripes = (0.5 + 0.5 * torch.sin(9 * vertices[:, :1]).sign()).expand(-1, 3)
    mesh = nr.Mesh(vertices * torch.tensor([1.0, 0.75, 0.5]), faces, vertex_colors=stripes)
    found = nr.find_pose(mesh, images.rgb[0], images.alpha[0], viewing_angle=ANGLE)
    assert found.verdict == "mismatch" and "differs from the photo" in found.advice[0]
    assert found.agreement > 0.8  # the outline alone would do


def test_arguments_are_checked() -> None:
    mask = torch.zeros(16, 16)
    mask[4:12, 4:12] = 1
    few = torch.zeros(16, 16)
    few[0, :7] = 1
    camera = nr.Camera.look_at((0.0, 0.0, 3.0))
    for options, message in (
        ({}, "photo: expected a photo, a mask or depth"),
        ({"mask": torch.zeros(16, 16)}, "mask: expected an object of at .*, got an empty mask in picture 0"),
        ({"mask": torch.ones(16, 16)}, "mask: expected .*around it, in every picture, got 256 of 256 pixels"),
        ({"mask": few}, "mask: expected .*at least 8 pixels.*, got 7 of 256 pixels in picture 0"),
        ({"mask": 255 * mask}, r"mask: expected numbers in \[0, 1\], got 0 to 255"),
        ({"mask": mask, "depth": 0 * mask}, "depth: expected distances above 0 within the mask, got none"),
        ({"mask": mask[None].repeat(2, 1, 1)}, "camera: expected 2, one for each picture, got none"),
        ({"mask": mask, "photo": torch.ones(3, 8, 8)}, "photo, mask and depth: expected as many of the same size"),
        ({"photo": torch.ones(3, 8, 8)}, "mask: expected the object's silhouette, got none"),
        ({"mask": mask, "viewing_angle": 95.0}, "viewing_angle: expected degrees below 90"),
        ({"mask": mask, "viewing_angle": 20.0, "camera": camera}, "viewing_angle: expected None with camera"),
        ({"mask": mask[None].repeat(2, 1, 1), "camera": camera}, "camera: expected 2, one for each picture, got 1"),
        (
            {"mask": mask, "camera": nr.Camera.look_at((0.0, 0.0, 3.0), orthographic=True)},
            "camera: expected perspective without distortion",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            nr.find_pose(thing(), **options)
    vertices, faces = nr.cube()
    for mesh, message in (((vertices, faces[:0]), "faces, got none"), ((0 * vertices, faces), "a size above 0")):
        with pytest.raises(ValueError, match=f"mesh: expected .*{message}"):
            nr.find_pose(mesh, mask=mask)
    wrong = ({"mesh": mask}, "mesh: expected a Mesh"), ({"start": "x"}, "start: expected an ObjectPose")
    for options, message in wrong:
        with pytest.raises(TypeError, match=message):
            nr.find_pose(**{"mesh": thing(), "mask": mask, **options})
