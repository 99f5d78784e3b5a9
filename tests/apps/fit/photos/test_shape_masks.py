"""Masks by depth: the solid, its outlines, and what photographs say of a mesh."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from scipy import ndimage

import neural_renderer as nr
from neural_renderer.apps.common.adjustable import generator
from neural_renderer.apps.fit import Views
from neural_renderer.apps.fit.commands.cameras import ELSEWHERE, EVIDENCE, NO_OBJECT, target_of
from neural_renderer.apps.fit.commands.verdict import verdict_lines, verdict_of, verdict_report
from neural_renderer.apps.fit.photos.beside import stands_beside
from neural_renderer.apps.fit.photos.geometry.comparison import moved, split_in_places
from neural_renderer.apps.fit.photos.geometry.cut import cut_out
from neural_renderer.apps.fit.photos.geometry.depth import DepthMaps, find_depth
from neural_renderer.apps.fit.photos.geometry.solid import Solid, find_solid, points_at, with_hanging
from neural_renderer.apps.fit.photos.masks import object_masks, voxels
from neural_renderer.apps.fit.photos.masks.shape_masks import (
    ShapeMasks,
    contradiction,
    draw,
    evidence_of_depth,
    read_depth,
    shown_by_depth,
    write_depth,
)
from neural_renderer.apps.fit.photos.masks.sharpen import sharpen
from neural_renderer.apps.fit.photos.place import find_place
from neural_renderer.apps.fit.photos.witness import Witness, ask, edges
from neural_renderer.apps.fit.verdict import Reason, Verdict, doubt_rivals, doubt_shape

SIZE = 96


def pattern(count: int, seed: int) -> torch.Tensor:
    """Make colours of wood and of an object alike, which histograms do not tell apart."""
    generator = torch.Generator().manual_seed(seed)
    return torch.tensor([0.45, 0.32, 0.2]) + 0.3 * (torch.rand(count, count, 3, generator=generator) - 0.5)


def sphere_texture(mesh: nr.Mesh, seed: int) -> nr.Mesh:
    """Give a mesh random colours, one for each face."""
    generator = torch.Generator().manual_seed(seed)
    colors = torch.tensor([0.45, 0.32, 0.2]) + 0.4 * (torch.rand(len(mesh.faces), 3, generator=generator) - 0.5)
    return nr.Mesh(mesh.vertices, mesh.faces, face_colors=colors.clamp(0, 1))


def ball(radius: float, center: tuple[float, float, float], seed: int) -> nr.Mesh:
    """Make a ball with a pattern."""
    vertices, faces = nr.icosphere(3, radius)
    return sphere_texture(nr.Mesh(vertices + torch.tensor(center), faces), seed)


@cache
def scene(second: bool = False) -> tuple[Views, torch.Tensor, torch.Tensor]:
    """Draw a ball on a table of the same colours, from all around: views, points, and true masks."""
    corners = torch.tensor([[-1.9, -0.6, -1.9], [-1.9, -0.6, 1.9], [1.9, -0.6, 1.9], [1.9, -0.6, -1.9]])
    uv = torch.tensor([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])
    table = nr.UVMesh(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]), uv, pattern(48, 0))
    eyes = nr.get_points_from_angles(4.0, torch.tensor([25.0, 50.0] * 10), torch.arange(20) * 18.0)
    camera = nr.Camera.look_at(eyes, viewing_angle=20.0)
    things = [ball(0.6, (0.0, 0.0, 0.0), 1)] + ([ball(0.35, (1.35, -0.25, 0.0), 2)] if second else [])
    images = nr.render(table, camera, SIZE, light=None).rgb
    masks = []
    for thing in things[::-1]:  # seen from above, a ball beside hides little of the other one
        drawn = nr.render(thing, camera, SIZE, light=None)
        images = drawn.rgb + images * (1 - drawn.alpha[:, None])
        masks.append(drawn.alpha)
    generator = torch.Generator().manual_seed(3)
    flat = (torch.rand(200, 3, generator=generator) - 0.5) * 3.2
    flat[:, 1] = -0.6
    points = torch.cat((flat, things[0].vertices[::5]))
    return Views(camera, torch.ones(20, SIZE, SIZE), images), points, masks[-1]


@cache
def depth(second: bool = False) -> DepthMaps:
    views, points, _ = scene(second)
    maps = find_depth(views, points, lambda *_: None)
    assert maps is not None
    return maps


@cache
def solid(second: bool = False) -> Solid:
    found = find_solid(scene(second)[0], depth(second))
    assert isinstance(found, Solid), found
    return found


def iou(first: np.ndarray, second: np.ndarray) -> float:
    return float((first & second).sum() / (first | second).sum())


@pytest.mark.slow
def test_an_object_with_the_colours_of_its_table_is_found() -> None:
    views, _, true = scene()
    found = solid()
    assert found.ground is not None
    np.testing.assert_allclose(found.ground, [0, 1, 0, -0.6], atol=0.05)
    drawn = draw(found, views.camera, views.size) > 0.5
    assert iou(drawn, true.numpy() > 0.5) > 0.85
    again = find_solid(views, depth())
    assert isinstance(again, Solid) and torch.equal(again.vertices, found.vertices)


@pytest.mark.slow
def test_photographs_tell_a_mesh_that_lacks_a_part_and_one_that_is_too_large() -> None:
    views, points, _ = scene()
    whole = ball(0.6, (0.0, 0.0, 0.0), 1)
    assert views.photos is not None
    photos = views.photos

    def told(mesh: nr.Mesh) -> list[str]:
        witness = ask(mesh.vertices, mesh.faces.long(), views.camera, depth(), solid().ground, photos, points)
        return [reason.text for reason in doubt_shape(witness)]

    assert told(whole) == []
    half = whole.vertices.clone()
    half[:, 0] = half[:, 0].clamp(max=0.1)
    assert "may cut the object" in " ".join(told(nr.Mesh(half, whole.faces)))
    assert "see through" in " ".join(told(ball(0.85, (0.3, 0.25, 0.0), 1)))


def test_what_stands_beside_a_mesh_hides_the_background(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(voxels, "_CELLS", 32)
    views, points, true = scene()
    assert views.photos is not None
    photos, camera, whole = views.photos[::2], views.camera[::2], true[::2].numpy() > 0.5
    lit = photos.clone()  # a highlight on the table, which is elsewhere in each view
    for row, photo in enumerate(lit):
        photo[:, 66:76, 4 + 8 * row : 14 + 8 * row] = 1.0
    assert stands_beside(lit, camera, points, whole) < 0.005
    half = whole.copy()
    half[:, : SIZE // 2] = False
    assert stands_beside(photos, camera, points, half) > 0.05


def depth_of_meshes(meshes: list[nr.Mesh], camera: nr.Camera) -> DepthMaps:
    """Draw the depth of one mesh in each view."""
    maps = [nr.render(one, camera[row], SIZE, light=None, outputs=("depth", "alpha")) for row, one in enumerate(meshes)]
    depth = torch.cat([one.depth.where(one.alpha > 0.99, torch.nan) for one in maps])
    return DepthMaps(
        depth, torch.full(depth.shape, 9), torch.full((len(depth),), 0.005), torch.zeros_like(depth).bool()
    )


def test_depth_separates_what_colours_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plane by structure from motion may cut the object, and some of its pixels have no depth."""
    monkeypatch.setattr(voxels, "_CELLS", 32)
    views, points, true = scene()
    assert views.photos is not None
    camera, inside = views.camera[::2], true[::2].numpy() > 0.5
    images = views.photos[::2].permute(0, 2, 3, 1).numpy()
    thing, ground = ball(0.6, (0.0, 0.0, 0.0), 1), np.array([0.0, 1.0, 0.0, -0.6])
    table = nr.Mesh(torch.tensor([[-9.0, -0.6, -9.0], [-9.0, -0.6, 9.0], [9.0, -0.6, 0.0]]), torch.tensor([[0, 1, 2]]))
    maps, far = (depth_of_meshes([one] * 10, camera) for one in (thing, table))
    depth = torch.where(maps.depth.isfinite(), maps.depth, far.depth)
    depth[:, ::16] = depth[:, 1::16] = depth[:, 2::16] = torch.nan
    maps = replace(maps, depth=depth, others=None)
    shape = ShapeMasks(
        inside, maps, ground, None, True, 0.0, points, Solid(thing.vertices, thing.faces, ground, 0.0, maps)
    )
    shown = shown_by_depth(shape, camera)
    core = np.stack([ndimage.binary_erosion(one, iterations=2) for one in inside])
    assert (shown[core] >= 0).all() and not (shown[~inside] > 0).any()
    half = inside.copy()
    half[:, : SIZE // 2] = False
    assert contradiction(inside, shown) < 0.05 < 0.3 < contradiction(half, shown)
    assert contradiction(inside, 0 * shown[:, :1, :1]) == 0  # unknown
    evidence = evidence_of_depth(shown, (2 * SIZE, 2 * SIZE))
    assert evidence.shape == (10, 2 * SIZE, 2 * SIZE) and set(np.unique(evidence)) == {-1, 0, 1}
    tilted = np.array([0.2, 0.98, 0.0, -0.2])
    places = [find_place(camera, points, views.size, plane) for plane in (tilted, ground)]
    masks = [
        object_masks._masks_of_colors(images, camera, place, lambda *_: None, seen)[0]
        for place, seen in zip(places, (0 * shown, shown), strict=True)
    ]
    assert iou(masks[0], inside) < 0.75 < 0.9 < iou(masks[1], inside)


def test_photographs_that_show_the_object_elsewhere_are_found() -> None:
    camera = nr.Camera.look_at(nr.get_points_from_angles(4.0, 30.0, torch.arange(10) * 36.0), viewing_angle=20.0)
    here, there = ball(0.6, (0.0, 0.0, 0.0), 1), ball(0.6, (0.3, 0.0, 0.3), 1)
    for count, expected in ((0, []), (2, [0, 1]), (4, [0, 1, 2, 3])):
        maps = depth_of_meshes([there] * count + [here] * (10 - count), camera)
        for ground in (None, np.array([0.0, 1.0, 0.0, -0.6])):
            assert np.flatnonzero(moved(camera, maps, here.vertices, here.faces, ground)).tolist() == expected


def test_photographs_that_the_others_confirm_show_the_object_where_it_is() -> None:
    """A mesh that is too large at its back contradicts those of the back, but not those beside them."""
    camera = nr.Camera.look_at(nr.get_points_from_angles(4.0, 30.0, torch.arange(20) * 18.0), viewing_angle=20.0)
    thing, slab = ball(0.6, (0.0, 0.0, 0.0), 1), ball(0.35, (0.0, 0.0, 0.5), 2)
    maps = depth_of_meshes([thing] * 20, camera)
    wrong = torch.cat((thing.vertices, slab.vertices)), torch.cat((thing.faces, slab.faces + len(thing.vertices)))
    assert moved(camera, maps, *wrong).any()
    assert not moved(camera, maps, *wrong, np.array([0.0, 1.0, 0.0, -0.6])).any()


def test_of_an_object_turned_after_half_of_the_photographs_the_first_half_counts() -> None:
    """The mesh may hold both places, so that half of the photographs contradict none of its parts."""
    camera = nr.Camera.look_at(nr.get_points_from_angles(4.0, 30.0, torch.arange(12) * 30.0), viewing_angle=20.0)
    box = nr.Mesh.from_trimesh(trimesh.creation.box((1.2, 0.4, 0.4)))
    turned = nr.Mesh(box.vertices[:, [2, 1, 0]], box.faces.flip(1))
    both = trimesh.creation.box((1.2, 0.4, 0.4)) + trimesh.creation.box((0.4, 0.4, 1.2))
    cross = nr.Mesh.from_trimesh(both)
    table = nr.Mesh(torch.tensor([[-9.0, -0.2, -9.0], [-9.0, -0.2, 9.0], [9.0, -0.2, 0.0]]), torch.tensor([[0, 1, 2]]))
    far, ground = depth_of_meshes([table] * 12, camera).depth, np.array([0.0, 1.0, 0.0, -0.2])
    for order in ("aaaaaabbbbbb", "abababababab", "aaaaaaaaaaaa"):
        maps = depth_of_meshes([box if one == "a" else turned for one in order], camera)
        maps = replace(maps, depth=torch.where(maps.depth.isfinite(), maps.depth, far))
        found = moved(camera, maps, cross.vertices, cross.faces, ground)
        assert "".join("b" if one else "a" for one in found) == order


@pytest.mark.parametrize("places", [2, 3])
def test_photographs_split_where_they_contradict_each_other(places: int) -> None:
    true = np.arange(12) % places
    values = np.where(true[:, None] == true, 0.1, 0.4) + np.random.default_rng(0).uniform(-0.1, 0.1, (12, 12))
    values = (values + values.T) / 2
    values[2, 5] = values[5, 2] = np.nan  # two photographs that share nothing
    found = split_in_places(values)
    assert found is not None and np.array_equal(found[:, None] == found, true[:, None] == true)
    assert split_in_places(values / 4) is None, "what right cameras show"
    assert split_in_places(np.full((12, 12), 0.4)) is None, "wrong cameras contradict each other everywhere"
    assert split_in_places(np.full((12, 12), np.nan)) is None
    assert split_in_places(values[:4, :4]) is None


def test_the_bottom_of_an_object_in_hands_is_no_piece_of_the_table() -> None:
    box = nr.Mesh.from_trimesh(trimesh.creation.box((1.0, 1.0, 1.0)))
    eyes = nr.get_points_from_angles(4.0, torch.tensor([30.0, 30.0, -40.0]), torch.tensor([0.0, 90.0, 0.0]))
    camera = nr.Camera.look_at(eyes, viewing_angle=20.0)
    maps, ground = depth_of_meshes([box] * 3, camera), np.array([0.0, 1.0, 0.0, -0.5])
    found = ask(box.vertices, box.faces, camera, maps, ground, torch.zeros(3, 3, SIZE, SIZE), torch.zeros(0, 3))
    assert found.confirmed == 1 and found.lying == 0
    sheet = nr.Mesh(box.vertices * torch.tensor([2.0, 0.01, 2.0]) - torch.tensor([0.0, 0.495, 0.0]), box.faces)
    maps = depth_of_meshes([sheet] * 3, camera)
    found = ask(sheet.vertices, sheet.faces, camera, maps, ground, torch.zeros(3, 3, SIZE, SIZE), torch.zeros(0, 3))
    assert found.lying > 0.9


def test_outlines_are_where_colours_change() -> None:
    y, x = np.mgrid[:64, :64]
    inside = np.stack([(x - 32) ** 2 + (y - 32) ** 2 < radius**2 for radius in (20, 14)])
    photo = torch.from_numpy(np.where(inside[0], 0.7, 0.3)).float() + 0.02 * torch.randn(
        3, 64, 64, generator=generator(0, 0)
    )
    assert edges(photo[None], inside[:1]) > 3 > 1.5 > edges(photo[None], inside[1:])


@pytest.mark.slow
def test_of_two_objects_the_one_that_is_pointed_at_is_found() -> None:
    views, _, _ = scene(second=True)
    assert solid(second=True).rivals > 0
    place, _ = views.camera[:1].project(torch.tensor([[1.35, -0.1, 0.0]]), views.size)
    x, y = (place[0, 0] / SIZE).tolist()
    for reach in (0.0, 0.03):
        points = points_at(views, depth(second=True), 0, (x - reach, y - reach, x + reach, y + reach))
        assert points is not None and len(points) == 1 if not reach else len(points) > 8  # type: ignore[arg-type]
        assert float((points - torch.tensor([1.35, -0.25, 0.0])).norm(dim=1).max()) < 0.6
    for reach in (0.0, 0.14):  # a point, and a box
        found = find_solid(views, depth(second=True), (0, (x - reach, y - reach, x + reach, y + reach)))
        assert isinstance(found, Solid)
        assert float((found.vertices.mean(0) - torch.tensor([1.35, -0.25, 0.0])).norm()) < 0.25


def test_a_box_cuts_an_object_from_what_it_touches_by_colours() -> None:
    rng = np.random.default_rng(0)
    points = rng.random((20_000, 3)) * [3.0, 1.0, 0.2]
    true = np.linalg.norm(points - [1.5, 0.5, 0.1], axis=1) < 0.4
    colors = np.where(true[:, None], [0.2, 0.6, 0.2], [0.6, 0.5, 0.4]) + rng.normal(0, 0.05, points.shape)
    box = (np.abs(points[:, :2] - [1.5, 0.5]) < 0.45).all(1)
    found = cut_out(points, colors.clip(0, 1), box, 0.05)
    assert iou(found, true) > 0.9 > iou(box, true)
    assert not cut_out(points, colors.clip(0, 1), np.zeros_like(box), 0.05).any()


def test_what_floats_belongs_to_what_is_below_it() -> None:
    rng = np.random.default_rng(0)
    stem, cap, other = rng.random((3, 500, 3)) * [0.2, 0.4, 0.2]
    cap = cap * [4, 1, 4] + [-0.3, 0.45, -0.3]
    points, own = np.concatenate((stem, cap, other + [1.0, 0.0, 0.0])), np.repeat([1, 2, 3], 500)
    ground = np.array([0.0, 1.0, 0.0, 0.0])
    assert with_hanging(points, own, [1], ground, 1.0) == [1, 2]
    assert with_hanging(points, own, [2], ground, 1.0) == [2, 1]
    assert with_hanging(points, own, [2], None, 1.0) == [2]


def test_outlines_move_to_edges() -> None:
    image = np.zeros((64, 64, 3)) + [0.2, 0.3, 0.2]
    y, x = np.mgrid[:64, :64]
    true = (x - 32) ** 2 + (y - 32) ** 2 < 20**2
    image[true] = [0.6, 0.3, 0.2]
    image += np.random.default_rng(0).normal(0, 0.02, image.shape)
    for shift in (-3, 3):
        drawn = (x - 32) ** 2 + (y - 32) ** 2 < (20 + shift) ** 2
        assert iou(sharpen(image, drawn), true) > 0.97 > iou(drawn, true)
    same = sharpen(np.full((64, 64, 3), 0.5), true)
    assert iou(same, true) > 0.99, "without colours the outline stays"
    assert not sharpen(image, np.zeros_like(true)).any()


def test_depth_is_kept_for_a_verdict(tmp_path: Path) -> None:
    maps = DepthMaps(torch.rand(3, 4, 5), torch.ones(3, 4, 5, dtype=torch.int64), torch.rand(3))
    assert read_depth(tmp_path, ["a"]) is None
    plane = np.array([0.0, 1.0, 0.0, 2.0])
    write_depth(tmp_path, ShapeMasks(None, maps, plane, None, True, 0.25, torch.zeros(0, 3)), ["a", "b", "c"])
    assert read_depth(tmp_path, ["a", "d"]) is None
    known = read_depth(tmp_path, ["c", "a"])
    assert known is not None and known[2] == 0.25
    assert torch.equal(known[0].depth, maps.depth[[2, 0]]) and known[0].others is None
    maps = replace(maps, others=torch.rand(3, 4, 5) > 0.5)
    write_depth(tmp_path, ShapeMasks(None, maps, plane, None, True, 0.25, torch.zeros(0, 3)), ["a", "b", "c"])
    again = read_depth(tmp_path, ["b"])
    assert again is not None and again[0].others is not None and maps.others is not None
    assert torch.equal(again[0].others, maps.others[1:2])
    assert np.array_equal(known[1], plane)


def test_verdict_has_reasons_with_pictures_and_remedies() -> None:
    assert verdict_report(Verdict((), True)) == {"verdict": "good", "reasons": []}
    doubtful = Verdict((Reason("the mesh lacks an ear", "masks.jpg", "correct the masks", ("masks",)),), True)
    said = ["verdict: doubtful", "the mesh lacks an ear; look at masks.jpg; correct the masks (--masks FOLDER)"]
    assert verdict_lines(doubtful) == said
    assert verdict_report(doubtful)["reasons"][0]["remedy"] == "correct the masks (--masks FOLDER)"
    assert doubt_rivals(0.1) == [] and "--object X Y" in verdict_lines(Verdict(tuple(doubt_rivals(0.8)), True))[1]


def test_many_photographs_of_another_place_are_a_reason(tmp_path: Path) -> None:
    """A fifth of them is a side that was turned up later; near half of them may have wrong cameras."""
    result: Any = SimpleNamespace(verdict="match", advice=())
    options: Any = SimpleNamespace(output=tmp_path)
    few, many = (verdict_of(result, options, None, None, {ELSEWHERE: share}) for share in (0.2, 0.46))
    assert few.word == "good" and many.word == "doubtful" and "46% of the photographs" in many.reasons[0].text


def test_a_surface_that_was_not_asked_for_is_doubtful(tmp_path: Path) -> None:
    result: Any = SimpleNamespace(verdict="good", advice=())
    options: Any = SimpleNamespace(output=tmp_path)
    assert verdict_of(result, options, None, None, {}).word == "good"
    doubtful = verdict_of(result, options, None, None, {NO_OBJECT: "the masks found reach over the border"})
    assert verdict_lines(doubtful) == [
        "verdict: doubtful",
        "the masks found reach over the border, so that this is an open surface of all that is seen; look at "
        "preview.png; ask for the surface, or point at the object (--surface, --object X Y, --masks FOLDER)",
    ]
    (tmp_path / "masks.jpg").touch()
    assert verdict_of(result, options, None, None, {NO_OBJECT: "why"}).reasons[0].picture == "masks.jpg"


@pytest.mark.parametrize(
    "evidence, said",
    [
        ((0.5, 0.0, 500, False), "50% of the matched pairs of photographs contradict the cameras"),
        ((0.95, 0.4, 500, False), "other cameras, 40% of their spread away, agree as well"),
        ((0.95, 0.0, 60, False), "photographs share only 60 points"),
        ((0.95, 0.0, 500, True), "cameras were found only in smoothed copies"),
        ((0.9, 0.01, 500, False), None),
    ],
)
def test_cameras_that_were_found_are_doubted(
    evidence: tuple[float, float, int, bool], said: str | None, tmp_path: Path
) -> None:
    result: Any = SimpleNamespace(verdict="good", advice=())
    options: Any = SimpleNamespace(output=tmp_path)
    verdict = verdict_of(result, options, None, None, dict(zip(EVIDENCE, evidence, strict=True)))
    texts = [reason.text for reason in verdict.reasons]
    assert texts == [] if said is None else len(texts) == 1 and said in texts[0]


@pytest.mark.parametrize(
    "figures, said",
    [
        ({"lacking": 0.1, "points": 0.5}, ["the mesh lacks one part of what stands there, 10% of it"]),
        ({"points": 0.5}, ["of the points that photographs share there, the mesh has 50%"]),
        ({"beside": 0.1}, ["something else stands next to the mesh, 10% as large"]),
        ({"seen_through": 0.2, "edges": 0.8}, ["see through 20% of the mesh", "colours change 0.8 times as much"]),
        ({"lying": 0.2}, ["20% of the mesh lies flat on the ground"]),
        ({"confirmed": 0.1}, ["three photographs confirm 10%"]),
        ({}, []),
    ],
)
def test_each_witness_has_its_reason(figures: dict[str, float], said: list[str]) -> None:
    good = Witness(lacking=0.0, confirmed=0.8, seen_through=0.0, points=0.99, beside=0.0, lying=0.0, edges=3.0)
    texts = [reason.text for reason in doubt_shape(replace(good, **figures))]
    assert len(texts) == len(said) and all(part in text for part, text in zip(said, texts, strict=True))


@pytest.mark.parametrize(
    "given, expected",
    [
        (("32", "12"), (0, (0.5, 0.25, 0.5, 0.25))),
        (("0.5", "0.25"), (0, (0.5, 0.25, 0.5, 0.25))),
        (("b.jpg:32,12",), (1, (0.5, 0.25, 0.5, 0.25))),
        (("b:32,12",), (1, (0.5, 0.25, 0.5, 0.25))),
        (("32", "36", "16", "12"), (0, (0.25, 0.25, 0.5, 0.75))),
        (("b:0.25,0.25,0.5,0.75",), (1, (0.25, 0.25, 0.5, 0.75))),
        ((), None),
    ],
)
def test_the_object_is_pointed_at(given: tuple[str, ...], expected: object) -> None:
    assert target_of(given, ["a.jpg", "b.jpg"], (48, 64)) == expected


@pytest.mark.parametrize(
    "given, said",
    [(("c:1,2",), "such as a.jpg"), (("1",), "X Y"), (("1", "2", "3"), "X Y X Y"), (("99", "1"), "64 x 48")],
)
def test_a_wrong_place_is_told(given: tuple[str, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        target_of(given, ["a.jpg", "b.jpg"], (48, 64))


def test_no_depth_without_points() -> None:
    views, _, _ = scene()
    assert find_depth(replace(views), torch.zeros(0, 3), lambda *_: None) is None
