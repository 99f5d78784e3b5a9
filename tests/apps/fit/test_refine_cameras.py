"""Cameras that are not exact: their parameters, the similarity that stays free, and fits that refine them."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.fit import MeshFit, ShapeFit, Views, carve, object_bounds
from neural_renderer.apps.fit.agreement import check_agreement
from neural_renderer.apps.fit.cameras import CameraRefinement, Similarity, change_cameras, locate_cameras
from neural_renderer.camera.files import read_camera_file
from neural_renderer.camera.files.opencv import save_cameras

POINTS = torch.rand(40, 3, generator=torch.Generator().manual_seed(0)) - 0.5
EYES = nr.get_points_from_angles(3.0, torch.tensor([70.0, 10, -35, 20, 40, -5, -60, 30]), torch.arange(8) * 45.0)
LENSES = ["angle", "angles", "K", "orthographic"]


def lens(name: str) -> nr.Camera:
    if name == "K":
        around = nr.Camera.look_at(EYES).axes * torch.tensor([1.0, -1.0, 1.0])[:, None]
        K = torch.tensor([[90.0, 0.0, 31.0], [0.0, 95.0, 34.0], [0.0, 0.0, 1.0]])
        shift = -torch.einsum("bij,bj->bi", around, EYES)
        return nr.Camera.projection(K, around, shift, (0.02, 0.0, 0.001, 0.0, 0.0), orig_size=64)
    if name == "angles":
        return nr.Camera.look_at(EYES, viewing_angle=torch.linspace(20, 24, 8))
    return nr.Camera.look_at(EYES, viewing_angle=20.0, orthographic=name == "orthographic", scale=0.8)


def wrong(camera: nr.Camera, degrees: float, share: float) -> nr.Camera:
    """Turn each camera around itself, and move it by a share of its distance, in directions of chance."""
    random = torch.Generator().manual_seed(3)
    turn = torch.nn.functional.normalize(torch.randn(len(camera), 3, generator=random), dim=1) * math.radians(degrees)
    move = torch.nn.functional.normalize(torch.randn(len(camera), 3, generator=random), dim=1) * share
    still = change_cameras(
        replace(camera, origin=torch.zeros_like(camera.origin)), torch.cat((turn, 0 * turn), 1), 0 * turn[:1, :1]
    )
    origin = camera.origin + camera.origin.norm(dim=1, keepdim=True) * move
    return replace(camera, rotation=still.rotation, origin=origin)


def cow(level: int = 3) -> tuple[Tensor, Tensor]:
    """Make a body with bumps, whose outlines are all different."""
    vertices, faces = nr.icosphere(level)
    bumps = torch.nn.functional.normalize(torch.randn(9, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    height = 0.55 + 0.45 * torch.exp(12 * (vertices @ bumps.t() - 1)).sum(1)
    return vertices * height[:, None], faces


@pytest.mark.parametrize("name", LENSES)
def test_no_change_gives_the_same_cameras(name: str) -> None:
    camera = lens(name)
    changed = change_cameras(camera, torch.zeros(8, 6), torch.zeros(1, 1))
    torch.testing.assert_close(changed(POINTS), camera(POINTS))


@pytest.mark.parametrize("name", LENSES)
def test_changes_do_what_they_say(name: str) -> None:
    camera, zero = lens(name), torch.zeros(1, 1)
    poses = torch.zeros(8, 6)
    poses[:, 2] = math.pi / 2  # around the viewing axis: the origin stays, and the picture turns by 90°
    turned = change_cameras(camera, poses, zero)
    torch.testing.assert_close(turned(torch.zeros(1, 3)), camera(torch.zeros(1, 3)), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(turned.rotation[:, 0], -camera.rotation[:, 1], atol=1e-6, rtol=0)
    # A longer focal length enlarges the picture and leaves depth.
    longer = change_cameras(camera, torch.zeros(8, 6), zero + math.log(1.1))
    if name != "K":  # whose principal point is off the centre and whose lens bends
        before, after = camera(POINTS), longer(POINTS)
        torch.testing.assert_close(after[..., :2], 1.1 * before[..., :2], atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(after[..., 2], before[..., 2])


def test_gradients_of_changes() -> None:
    camera = lens("K").to(dtype=torch.float64)
    points = POINTS[:5].double()
    poses, focal = torch.full((8, 6), 0.02, dtype=torch.float64), torch.full((1, 1), 0.01, dtype=torch.float64)
    poses.requires_grad_(), focal.requires_grad_()
    assert torch.autograd.gradcheck(lambda p, f: change_cameras(camera, p, f)(points), (poses, focal))


@pytest.mark.parametrize("name", LENSES)
def test_similarity_is_found_and_changes_no_picture(name: str) -> None:
    camera = lens(name)
    turn = torch.linalg.matrix_exp(torch.tensor([[0.0, -0.3, 0.2], [0.3, 0.0, -0.5], [-0.2, 0.5, 0.0]]))
    given = Similarity(1.3, turn, torch.tensor([0.1, -0.4, 0.2]))
    moved = given.cameras(camera)
    before, after = camera(POINTS), moved(given.points(POINTS))
    torch.testing.assert_close(after[..., :2], before[..., :2], atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(after[..., 2], before[..., 2] * 1.3, atol=1e-5, rtol=1e-5)
    found = Similarity.between(camera, moved)
    assert abs(found.scale - 1.3) < 1e-5
    torch.testing.assert_close(found.rotation, turn, atol=1e-5, rtol=0)
    torch.testing.assert_close(found.shift, given.shift, atol=1e-5, rtol=0)


def test_settled_cameras_give_the_same_pictures_near_the_beginning() -> None:
    camera = lens("angle")
    moved = Similarity(1.2, lens("angle").rotation[1] @ lens("angle").rotation[0].t(), torch.ones(3)).cameras(camera)
    refinement = CameraRefinement(camera)
    refinement._restart(moved)
    before = refinement.camera(POINTS)
    settled = refinement.settle(POINTS)
    torch.testing.assert_close(refinement.camera(settled)[..., :2], before[..., :2], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(refinement.camera.position, camera.position, atol=1e-4, rtol=0)


def test_only_cameras_of_a_step_move_and_parallel_ones_keep_their_scale() -> None:
    for name in ("angle", "orthographic"):
        refinement = CameraRefinement(lens(name))
        refinement.step([torch.ones(8, 6), torch.ones(1, 1)], [2, 5], rate=0.01)
        poses, focal = refinement.parameters
        assert torch.equal(poses.abs().sum(1) > 0, torch.tensor([row in (2, 5) for row in range(8)]))
        assert bool(focal.abs().sum() > 0) == (name == "angle")
    assert refinement.prior() > 0


@pytest.mark.parametrize("name", LENSES)
def test_other_views_get_the_focal_length(name: str) -> None:
    camera = lens(name)
    refinement = CameraRefinement(camera[:4])
    focal = torch.full((1, 1), 0.0 if name == "orthographic" else 0.1)
    refinement.parameters = refinement.parameters[0], focal
    refinement.settle(POINTS)  # the change becomes that of the base
    shared = refinement.share_lens(Views(camera[4:], torch.ones(4, 8, 8))).camera
    torch.testing.assert_close(shared(POINTS), change_cameras(camera[4:], torch.zeros(4, 6), focal)(POINTS))


def test_hull_with_misses_survives_a_wrong_mask() -> None:
    views = Views.of(nr.Mesh(*cow(2)), lens("angle"), 48, light=None)
    masks = views.masks.clone()
    masks[3] = masks[3].roll(12, 1)
    spoiled = replace(views, masks=masks).normalized(*object_bounds(views))
    iou = [float(spoiled[[0, 1, 2, 4, 5, 6, 7]].quality(carve(spoiled, 24, misses))["iou"].mean()) for misses in (0, 1)]
    assert iou[1] > iou[0] + 0.05


def test_shape_fit_moves_cameras_towards_the_true_ones() -> None:
    mesh, camera = nr.Mesh(*cow()), lens("angle")
    views = Views.of(mesh, camera, 64, light=None)
    off = replace(views, camera=wrong(camera, 1.5, 0.015))
    cameras = CameraRefinement(off.camera)
    vertices, faces = cow()
    fit = ShapeFit(off, vertices, faces, steps=40, cameras=cameras, camera_rate=0.01, rate=0.002, batch=8)
    before = float(off.quality((vertices, faces))["iou"].mean())
    while not fit.done:
        fit.advance()
    cameras.settle(fit.shape[0])
    after = float(replace(views, camera=cameras.camera).quality((vertices, faces))["iou"].mean())
    assert before < 0.93 and after > before + 0.04


def test_phases_resume_exactly() -> None:
    camera = lens("angle")
    views = Views.of(nr.Mesh(*cow(2)), camera, 32, light=None)
    off = replace(views, camera=wrong(camera, 1.0, 0.01))
    options = {"refine_cameras": True, "camera_steps": 3, "steps": 4, "texture_steps": 2, "cells": 16}
    fit = MeshFit(off, **options)  # type: ignore[arg-type]
    phases, states = [], []
    while not fit.done:
        states.append(copy.deepcopy(fit.state_dict()))
        fit.advance()
        phases.append(fit.phase)
    assert phases == ["cameras"] * 3 + ["shape"] * 4 + ["texture"] * 2
    for state in states[1::3]:
        other = MeshFit(off, **options)  # type: ignore[arg-type]
        other.load_state_dict(copy.deepcopy(state))
        while not other.done:
            other.advance()
        assert all(torch.equal(a, b) for a, b in zip(fit.shape, other.shape, strict=True))
        assert torch.equal(fit.cameras().rotation, other.cameras().rotation)
    # The cameras belong to the mesh in the world: they show it as the views of the fit do.
    inside = fit.views.quality(fit.shape)["iou"]
    outside = replace(views, camera=fit.cameras())
    mesh = fit.mesh()
    shape = (mesh.vertices.detach(), mesh.faces)
    torch.testing.assert_close(outside.quality(shape)["iou"], inside, atol=0.02, rtol=0)


@pytest.mark.parametrize("start", ["hull", "mesh"])
def test_the_texture_may_follow_unfinished_cameras(start: str) -> None:
    """From a hull, which was not carved yet, or from the shape given; cameras stay as they were."""
    views = Views.of(nr.Mesh(*cow(2)), wrong(lens("angle"), 1.0, 0.01), 32, light=None)
    given = nr.Mesh(*cow(2)) if start == "mesh" else "hull"
    fit = MeshFit(views, given, refine_cameras=True, camera_steps=3, steps=4, texture_steps=2, cells=16)  # type: ignore[arg-type, call-arg]
    fit.advance()
    assert fit.phase == "cameras" and fit.skip_to_texture() and fit.phase == "texture"
    cameras = fit.cameras()
    assert not torch.equal(cameras.rotation, views.camera.rotation)  # moved in the one step
    shape = [part.clone() for part in fit.shape[:2]]
    while not fit.done:
        fit.advance()
    assert fit.phase == "texture" and len(fit.shape) == 3
    assert all(torch.equal(a, b) for a, b in zip(shape, fit.shape, strict=False))
    assert torch.equal(fit.cameras().rotation, cameras.rotation) and fit.mesh().num_faces == len(shape[1])


def test_located_cameras_are_better_and_the_mesh_stays() -> None:
    camera = lens("angle")
    views = Views.of(nr.Mesh(*cow()), camera, 64, light=None)
    off = replace(views[:3], camera=wrong(camera, 1.0, 0.01)[:3])
    shape = cow()
    located = locate_cameras(off, shape, steps=25)
    assert located.quality(shape)["iou"].mean() > off.quality(shape)["iou"].mean() + 0.02


@pytest.mark.parametrize("name", ["angle", "angles", "K"])
def test_written_cameras_are_read_again(name: str, tmp_path: Path) -> None:
    camera = lens(name)
    names = [f"{row}.png" for row in range(8)]
    save_cameras(tmp_path / "cameras.json", camera, names, (64, 64))
    read = read_camera_file(tmp_path / "cameras.json")
    assert [entry.name for entry in read.images] == names
    torch.testing.assert_close(read.cameras((64, 64))(POINTS), camera(POINTS), atol=1e-4, rtol=1e-4)
    with pytest.raises(ValueError, match="names: expected 8 names, got 1"):
        save_cameras(tmp_path / "cameras.json", camera, ["a"], (64, 64))
    with pytest.raises(ValueError, match="camera: expected perspective"):
        save_cameras(tmp_path / "cameras.json", lens("orthographic"), names, (64, 64))


def test_check_with_a_margin_lets_small_errors_pass_and_large_ones_not() -> None:
    camera = nr.Camera.look_at(EYES, viewing_angle=20.0)
    views = Views.of(nr.Mesh(*cow(2)), camera, 96, light=None)
    names = [str(row) for row in range(8)]
    check_agreement(replace(views, camera=wrong(camera, 1.0, 0.01)), names, 4)
    turned = replace(views, masks=views.masks.transpose(1, 2), photos=None, camera=camera[[3, 0, 5, 1, 7, 6, 2, 4]])
    with pytest.raises(ValueError, match="expected masks and cameras that agree"):
        check_agreement(turned, names, 4)


def test_command_writes_cameras_and_locates_held_out_views(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = lens("angle")
    views = Views.of(nr.Mesh(*cow(2)), camera, 48, light=None)
    names = [f"{row}.png" for row in range(8)]
    save_cameras(tmp_path / "cameras.json", wrong(camera, 0.5, 0.005), names, (48, 48))
    for row, name in enumerate(names):
        nr.save_image(tmp_path / name, torch.cat((views.photos[row], views.masks[row][None])))  # type: ignore[index]
    small = ["--cells=16", "--steps=2", "--detail-steps=0", "--camera-steps=2", "--texture-steps=2", "--turntable=0"]
    out = tmp_path / "out"
    arguments = ["fit", str(tmp_path), "-o", str(out), "--refine-cameras", "--held-out", "4", *small]
    assert cli.main(arguments) in (0, 3)  # after so few steps
    written = read_camera_file(out / "cameras.json")
    assert [entry.name for entry in written.images] == [name for row, name in enumerate(names) if row % 4 != 3]
    report = json.loads((out / "report.json").read_text())
    assert report["held_out_located"]["iou"]["mean"] >= report["held_out"]["iou"]["mean"] - 0.01
    assert cli.main(["fit", str(tmp_path), "-o", str(out), "--refine-cameras", "--recover", "texture"]) == 1
    assert "--refine-cameras: expected --recover shape" in capsys.readouterr().err
    with pytest.raises(ValueError, match="refine_cameras: expected False"):
        MeshFit(views, nr.Mesh(*cow(2)), recover="texture", refine_cameras=True)
