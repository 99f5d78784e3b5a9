"""Generated shapes: closed, repeatable, filled like their meshes, and drawn where their poses say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.reconstruct.data.framing import mirror, view_camera
from neural_renderer.apps.reconstruct.data.models_folder import Model
from neural_renderer.apps.reconstruct.data.voxels import voxelize, voxelize_model
from neural_renderer.apps.reconstruct.networks.shape_network import outline_iou
from neural_renderer.apps.reconstruct.shapes.parts import Builder
from neural_renderer.apps.reconstruct.shapes.shapes import CLASSES, GRAMMARS, Shapes
from neural_renderer.apps.reconstruct.shapes.views import (
    clip_points,
    crop_poses,
    draw,
    published_crops,
    published_pose,
    random_poses,
)


@pytest.mark.parametrize("name", CLASSES)
def test_parts_are_closed_and_face_outward(name: str) -> None:
    for seed in range(3):
        builder = Builder(np.random.default_rng(seed))
        GRAMMARS[name](builder)
        for vertices, faces, color in builder.parts:
            edges = np.sort(np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)]), 1)
            assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
            assert np.linalg.det(vertices[faces]).sum() > 0
            assert ((color >= 0) & (color <= 1)).all()


def test_cut_subtracts_a_part_from_the_parts_before_it() -> None:
    builder = Builder(np.random.default_rng(0))
    red = np.array([1.0, 0, 0])
    for x in (0, 3):
        builder.box((x, 0, 0), (2, 2, 2), red)
    builder.box((3, 0, 0), (1, 1, 9), 1 - red)
    builder.cut(1)
    first, second = (np.linalg.det(vertices[faces]).sum() / 6 for vertices, faces, _ in builder.parts)
    assert first == pytest.approx(8) and second == pytest.approx(8 - 2, abs=1e-5)  # float32 corners up to 4
    assert all((color == red).all() for *_, color in builder.parts)


def test_models_of_a_category_exchange_their_upper_parts(tmp_path: Path) -> None:
    vertices, faces = nr.cube()
    models = []
    for name, width, high in (("a", 0.9, 0.5), ("b", 1.0, 0.3), ("c", 0.1, 0.5)):  # a foot, and a cube above it
        above = vertices * torch.tensor([width, high, 1.0]) + torch.tensor([0.0, 2.0, 0.0])
        both = torch.cat((vertices, above)), torch.cat((faces, faces + len(vertices)))
        nr.save_mesh(tmp_path / f"{name}.obj", *both)
        models.append(Model("table", name, tmp_path / f"{name}.obj"))
    stored = Shapes(0, models).stored[CLASSES.index("table")]
    mixed = stored[3:]
    assert len(mixed) == 2  # the narrow cube of c would be scaled tenfold
    for one in mixed:
        sides = one.vertices.amax(0) - one.vertices.amin(0)
        assert any(torch.allclose(sides, own.vertices.amax(0) - own.vertices.amin(0), atol=1e-6) for own in stored[:2])
        assert len(one.faces) == 2 * len(faces) and one.voxels.any()


def test_a_shape_depends_on_seed_and_number_alone() -> None:
    shapes = Shapes(seed=3)
    first, again, other = shapes(5), Shapes(seed=3)(5), shapes(6)
    assert torch.equal(first.vertices, again.vertices) and torch.equal(first.voxels, again.voxels)
    assert first.vertices.shape != other.vertices.shape or not torch.equal(first.vertices, other.vertices)
    sides = first.vertices.amax(0) - first.vertices.amin(0)
    assert float(sides.max()) == pytest.approx(1, abs=1e-6)


def test_voxels_hold_the_surface() -> None:
    for number in range(4):
        shape = Shapes()(number)
        published = voxelize(mirror(shape.vertices)[None], shape.faces)[0]
        assert bool((shape.voxels | ~published).all())  # the rule of models marks thin parts besides


def test_poses_are_the_views_of_data_sets() -> None:
    shape, views = Shapes()(2), torch.arange(0, 24, 5)
    place = clip_points(shape.vertices, published_pose(views))
    ours = nr.render((place, shape.faces), None, 64, outputs=("alpha",)).alpha
    camera = view_camera(views)
    theirs = nr.render((mirror(shape.vertices), shape.faces), camera, 64, outputs=("alpha",)).alpha
    assert torch.allclose(ours, theirs, atol=0.02)  # anti-aliasing of float32 outlines
    images = torch.cat((ours[:, None].expand(-1, 3, -1, -1), ours[:, None]), 1)
    cropped, pose = published_crops(images, views)
    filled = shape.voxels.float().expand(len(views), -1, -1, -1)
    assert bool((outline_iou(filled, cropped, pose) > outline_iou(filled, cropped, pose.roll(2, 0))).all())


def test_pictures_show_the_whole_object() -> None:
    rng = np.random.default_rng(0)
    made = [Shapes()(number) for number in range(6)]
    pose = crop_poses(random_poses(6, rng), [shape.vertices for shape in made], rng)
    images = draw(made, pose, rng)
    assert images.shape == (6, 4, 64, 64) and float(images.amin()) >= 0 and float(images.amax()) <= 1
    alpha = images[:, 3]
    assert bool((alpha.amax((1, 2)) == 1).all())
    assert not alpha[:, [0, -1]].any() and not alpha[:, :, [0, -1]].any()


def test_models_keep_their_interior(tmp_path: Path) -> None:
    vertices, faces = nr.cube()
    nr.save_mesh(tmp_path / "a.obj", vertices * torch.tensor([1.0, 0.5, 0.5]), faces[:-2])  # an open box
    shapes = Shapes(0, [Model("table", "a", tmp_path / "a.obj"), Model("table", "b", tmp_path / "b.obj")], share=1.0)
    table = CLASSES.index("table")
    assert [len(models) for models in shapes.stored.values()] == [int(k == table) for k in range(13)]
    interior = shapes.stored[table][0].voxels
    loaded = nr.load_mesh(tmp_path / "a.obj")
    assert torch.equal(interior, voxelize_model(mirror(loaded[0] / 2), loaded[1].long().flip(1)))
    number = next(n for n in range(99) if shapes(n).category == table and len(shapes(n).faces) == 10)
    assert int(shapes(number).voxels.sum()) > 0.25 * 32**3 / 2


def test_a_picture_without_an_object_is_kept_whole() -> None:
    cropped, pose = published_crops(torch.zeros(1, 4, 64, 64), torch.zeros(1))
    assert not bool(cropped.any()) and float(pose[0, 3:5].abs().max()) == 0
