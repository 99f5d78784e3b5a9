"""Voxelisation on shapes with known voxels, in the axes of the published data set, and measures on voxels."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.reconstruct.data.framing import mirror, scale_to_unit, view_camera
from neural_renderer.apps.reconstruct.data.voxels import voxel_iou, voxel_surface, voxelize, voxelize_model
from tests.rounding import rounding


def box(low: list[float], high: list[float]) -> tuple[Tensor, Tensor]:
    """Make an axis-aligned box with counter-clockwise faces."""
    vertices, faces = nr.cube()
    span = torch.tensor([low, high])
    return torch.where(vertices > 0, span[1], span[0]), faces


def test_a_batch_is_its_parts(device: str) -> None:
    vertices, faces = nr.icosphere(2)
    batch = vertices * torch.linspace(0.1, 0.5, 9)[:, None, None] * torch.tensor([1.0, 0.5, 0.8])
    together = voxelize(batch.to(device), faces.to(device)).cpu()
    assert torch.equal(together, torch.cat([voxelize(one[None], faces) for one in batch]))


def test_sphere_has_its_volume() -> None:
    vertices, faces = nr.icosphere(4)
    radius = 0.4 * 31
    count = voxelize(0.4 * vertices[None], faces).sum().item()
    # A voxel is filled if the surface touches it: outwards the ball grows by three quarters of a voxel on average.
    assert 4 / 3 * math.pi * (radius + 0.6) ** 3 < count < 4 / 3 * math.pi * (radius + 0.9) ** 3
    voxels = voxelize(0.4 * vertices[None], faces)[0]
    for axis in range(3):
        assert torch.equal(voxels, voxels.flip(axis))


def test_box_is_exact_and_axes_are_the_published_ones() -> None:
    # In voxels: x from 16 + 31·0.1 = 19.1, y from 16 − 31·0.4 = 3.6, z from 16 − 31·0.3 = 6.7.
    vertices, faces = box([0.1, -0.4, -0.3], [0.2, 0.3, 0.45])
    expected = torch.zeros(32, 32, 32, dtype=torch.bool)
    x, y, z = slice(19, 23), slice(3, 26), slice(6, 30)
    expected[y, x, z] = True
    assert torch.equal(voxelize(vertices[None], faces)[0], expected.flip(2))


def test_the_whole_frame_is_the_whole_grid() -> None:
    vertices, faces = box([-0.5] * 3, [0.5] * 3)
    assert voxelize(vertices[None], faces).all()
    assert voxelize(vertices[None], faces, 16).shape == (1, 16, 16, 16)
    assert not voxelize(vertices[None] + 5, faces).any()


def test_thin_plate_is_one_voxel_thick_and_whole() -> None:
    vertices, faces = box([-0.4, 0.1, -0.4], [0.4, 0.101, 0.4])  # y from 19.1 to 19.13, the others from 3.6 to 28.4
    expected = torch.zeros(32, 32, 32, dtype=torch.bool)
    expected[19, 3:29, 3:29] = True
    assert torch.equal(voxelize(vertices[None], faces)[0], expected)
    assert torch.equal(voxelize_model(vertices, faces), expected)


def test_thin_rod_between_the_lines_is_lost_by_the_published_rule_only() -> None:
    vertices, faces = box([0.01, -0.4, 0.01], [0.02, 0.4, 0.02])
    assert voxelize(vertices[None], faces).sum() == 2
    expected = torch.zeros(32, 32, 32, dtype=torch.bool)
    expected[3:29, 16, 15] = True
    assert torch.equal(voxelize_model(vertices, faces), expected)


def test_open_mesh_is_a_shell_by_the_published_rule_and_full_in_the_ground_truth() -> None:
    vertices, faces = box([-0.4] * 3, [0.4] * 3)
    whole = voxelize(vertices[None], faces)[0]
    bottomless = faces[~(vertices[faces.long()][..., 1] < 0).all(1)]
    assert len(bottomless) == 10
    shell = voxelize(vertices[None], bottomless)[0]
    assert shell.sum() < whole.sum() / 2 and not shell[10, 16, 16]
    for order in (bottomless, bottomless.flip(1)):  # whichever side is said to be out
        filled = voxelize_model(vertices, order)
        assert voxel_iou(filled[None], whole[None]) > 0.85
        assert filled[16:].equal(whole[16:])


def test_a_hole_of_one_face_does_not_empty_a_sphere() -> None:
    vertices, faces = nr.icosphere(2)
    whole = voxelize_model(0.45 * vertices, faces)
    assert voxel_iou(voxelize_model(0.45 * vertices, faces[1:])[None], whole[None]) > 0.98
    assert voxel_iou(voxelize(0.45 * vertices[None], faces[1:]), whole[None]) < 0.5


def test_a_room_with_walls_of_its_own_stays_empty() -> None:
    outer, faces = box([-0.45] * 3, [0.45] * 3)
    inner, _ = box([-0.3, -0.3, -0.3], [0.3, 0.45, 0.3])  # open to the top
    top = (outer[faces.long()][..., 1] > 0).all(1)
    vertices = torch.cat((outer, inner))
    both = torch.cat((faces[~top], (faces[~top] + 8).flip(1)))
    voxels = voxelize_model(vertices, both)
    assert not voxels[20, 16, 16] and voxels[3, 16, 16] and voxels[20, 4, 16]


def test_surface_of_voxels() -> None:
    voxels = torch.zeros(32, 32, 32, dtype=torch.bool)
    voxels[3:9, 4:6, 10:30] = True
    voxels[20, 20, 20] = True
    vertices, faces = voxel_surface(voxels)
    assert len(faces) == 2 * (2 * (6 * 2 + 6 * 20 + 2 * 20) + 6)
    corners = vertices[faces].double()
    assert torch.linalg.det(corners).sum().item() / 6 * 31**3 == pytest.approx(6 * 2 * 20 + 1)  # outward
    assert torch.equal(voxelize(vertices[None], faces)[0] & voxels, voxels)


def test_surface_stands_where_the_object_stands() -> None:
    """Voxels and object have the same silhouettes, from cameras that tell all axes and signs apart."""
    arms = [box([-0.5, -0.5, -0.5], [0.5, -0.35, -0.3]), box([-0.5, -0.5, -0.5], [-0.35, 0.4, -0.3])]
    arms += [box([-0.5, -0.5, -0.5], [-0.2, -0.3, 0.2])]
    vertices = torch.cat([arm for arm, _ in arms])
    faces = torch.cat([8 * index + corners for index, (_, corners) in enumerate(arms)])
    voxels = voxelize_model(vertices, faces.flip(1))
    camera = view_camera(torch.arange(0, 24, 5))

    def silhouettes(mesh: tuple[Tensor, Tensor]) -> Tensor:
        return nr.render(mesh, camera, 64, outputs="alpha").alpha  # type: ignore[return-value]

    expected = silhouettes((vertices, faces))
    right = nr.metrics.silhouette_iou(silhouettes(voxel_surface(voxels)), expected)
    for other in (voxels.flip(0), voxels.flip(1), voxels.flip(2), voxels.transpose(1, 2), voxels.transpose(0, 1)):
        wrong = nr.metrics.silhouette_iou(silhouettes(voxel_surface(other)), expected)
        assert right.min() > 0.8 and right.mean() > wrong.mean() + 0.08


def test_iou() -> None:
    a, b = torch.zeros(3, 4, 4, 4, dtype=torch.bool), torch.zeros(3, 4, 4, 4, dtype=torch.bool)
    a[0, :2], b[0, 1:3] = True, True
    a[1] = True
    assert voxel_iou(a, b).tolist() == [pytest.approx(1 / 3), 0, 1]


def test_views_see_what_the_camera_of_the_model_sees() -> None:
    """A mirrored object under the mirroring camera looks like the model under an ordinary one, at +x for view 0."""
    generator = torch.Generator().manual_seed(0)
    model = torch.rand(50, 3, generator=generator) - 0.5
    for view in (0, 4, 17):
        turn = math.radians(15 * view)
        level = 2.732 * math.cos(math.radians(30))
        eye = [level * math.cos(turn), 2.732 * 0.5, level * math.sin(turn)]
        expected = nr.Camera.look_at(eye, viewing_angle=15)(model)
        assert torch.allclose(view_camera(torch.tensor([view]))(mirror(model)), expected, **rounding(32, 4))
    assert torch.equal(mirror(mirror(model)), model)


@pytest.mark.parametrize(
    ("vertices", "faces", "error", "sentence"),
    [
        (torch.zeros(4, 3), torch.zeros(1, 3).int(), ValueError, r"vertices: expected shape \[B, V, 3\]"),
        (torch.zeros(1, 4, 3), torch.zeros(1, 3) + 0.5, ValueError, "faces: expected whole numbers"),
        (torch.zeros(1, 4, 3), torch.full((1, 3), 4), ValueError, r"faces: expected indices in \[0, 4\), got 4"),
        (torch.full((1, 4, 3), math.nan), torch.zeros(1, 3).int(), ValueError, "vertices: expected finite numbers"),
    ],
)
def test_bad_input(vertices: Tensor, faces: Tensor, error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        voxelize(vertices, faces)


def test_bad_voxels() -> None:
    with pytest.raises(ValueError, match="expected the same shape"):
        voxel_iou(torch.zeros(1, 2, 2, 2, dtype=torch.bool), torch.zeros(1, 3, 3, 3, dtype=torch.bool))
    with pytest.raises(ValueError, match="vertices: expected vertices that differ"):
        scale_to_unit(torch.ones(3, 3))
