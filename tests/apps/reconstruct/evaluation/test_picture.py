"""One picture to a coloured mesh, with the shipped network, in Python and by the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.masks.rule import box_mask
from neural_renderer.apps.reconstruct.evaluation.familiarity import Calibration, shipped_calibration
from neural_renderer.apps.reconstruct.evaluation.picture import (
    LEAST_OUTLINE,
    WEIGHTS,
    fit_outline,
    load_shape_network,
    picture_colors,
    shipped_network,
)
from neural_renderer.apps.reconstruct.shapes.shapes import CLASSES, Shapes
from neural_renderer.apps.reconstruct.shapes.views import crop_poses, draw, random_poses
from neural_renderer.meshes.primitives import torus
from tests.paths import EXAMPLES


def view_of(number: int) -> tuple[Tensor, Tensor]:
    """Draw a generated shape: the picture [1, 4, 64, 64] and its pose [1, 6]."""
    rng, shape = np.random.default_rng(number), Shapes(seed=1)(number)
    pose = crop_poses(random_poses(1, rng), [shape.vertices], rng)
    return draw([shape], pose, rng), pose


def test_the_shipped_network_is_whole_and_small() -> None:
    network = shipped_network()
    assert all(bool(value.isfinite().all()) for value in network.state_dict().values())
    assert network.category.out_features == len(CLASSES)
    assert 2 * sum(value.numel() for value in network.parameters()) < 6_000_000  # bytes in half precision


def test_a_mirrored_picture_has_the_mirrored_pose() -> None:
    network, images = shipped_network(), view_of(3)[0]
    category, poses, scores = network.recognize(images)
    same, mirrored, others = network.recognize(images.flip(3))
    assert torch.equal(category, same) and torch.allclose(scores, others)
    turn = (poses[0, 0, 0] + mirrored[0, 0, 0] - torch.pi) / (2 * torch.pi)
    assert float(turn) == pytest.approx(round(float(turn)), abs=1e-5)
    assert torch.allclose(poses[..., 1:], mirrored[..., 1:] * torch.tensor([1.0, 1, -1, 1, 1]), atol=1e-5)


def test_a_picture_becomes_a_mesh() -> None:
    image = view_of(3)[0][0].permute(1, 2, 0)
    kept = image.clone()
    result = nr.reconstruct(image, steps=5)
    assert torch.equal(image, kept)
    mesh = result.mesh
    assert mesh.vertex_colors is not None and bool(((mesh.vertex_colors >= 0) & (mesh.vertex_colors <= 1)).all())
    assert float(mesh.vertices.abs().max()) < 1
    assert sum(result.probabilities.values()) == pytest.approx(1, abs=1e-5)
    assert result.category == max(result.probabilities, key=result.probabilities.__getitem__)
    corners = mesh.vertices[mesh.faces.long()].double()
    assert float(torch.linalg.det(corners).sum()) > 0  # faces are outward
    turned = nr.reconstruct(image, azimuth=90.0, steps=0)
    assert float(turned.pose[0]) == 0


def test_the_outline_fits_better_and_holes_stay() -> None:
    vertices, faces = torus(0.35, 0.1)
    images, pose = view_of(1)
    ring = vertices[:, [0, 2, 1]]
    pose[:, :2], pose[:, 3:] = 0.0, torch.tensor([0.0, 0.0, 0.6])
    losses = []
    fitted, view = fit_outline(ring, faces, images, pose, 10, lambda step, loss: losses.append(loss))
    assert len(losses) == 10 and losses[-1] < losses[0]
    assert fitted.shape == ring.shape and view.shape == pose.shape
    same, kept = fit_outline(ring, faces, images, pose, 0)
    assert torch.equal(same, ring) and torch.equal(kept, pose)
    stopped = []
    fit_outline(ring, faces, images, pose, 10, lambda step, loss: stopped.append(step) or step < 2)
    assert stopped == [1, 2]


def test_colours_come_from_the_picture_and_the_mirrored_side() -> None:
    vertices, faces = nr.icosphere(3, radius=0.5)
    image = torch.ones(1, 4, 64, 64)
    image[:, :3] = torch.tensor([0.9, 0.1, 0.2])[:, None, None]
    image[:, 0, :32] = 0.3  # the upper half
    pose = torch.tensor([[0.6, 0.0, 3.0, 0.0, 0.0, 0.55]])
    colors = picture_colors(vertices, faces, image, pose)
    height = vertices[:, 1]
    # Rows of the picture blend at the middle alone; hidden vertices average four neighbours of 0.1 or less.
    assert torch.allclose(colors[height > 0.2], torch.tensor([0.3, 0.1, 0.2]), atol=1e-5)
    assert torch.allclose(colors[height < -0.2], torch.tensor([0.9, 0.1, 0.2]), atol=1e-5)


def test_a_box_finds_the_object_on_a_busy_background() -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(80, 120, 3, generator=generator) * torch.tensor([0.3, 0.6, 0.9])
    truth = torch.zeros(80, 120)
    truth[25:60, 45:85] = 1
    image = torch.where(truth[..., None] > 0, torch.tensor([0.9, 0.3, 0.1]), image)
    mask = box_mask(image, (0.3, 0.2, 0.8, 0.85))
    common = (mask * truth).sum() / torch.maximum(mask, truth).sum()
    assert float(common) > 0.85
    for box in ((0.5, 0.2, 0.4, 0.8), (0.0, 0.0, 1.0, 1.0), (-0.1, 0.0, 0.5, 0.5)):
        with pytest.raises(ValueError, match="box: expected left < right"):
            box_mask(image, box)


def teapot(azimuth: float) -> Tensor:
    """A picture [96, 96, 4] of an object that is of none of the network's kinds."""
    mesh = nr.Mesh.load(EXAMPLES / "data" / "teapot.obj").normalize()
    camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 25.0, azimuth), viewing_angle=30)
    images = nr.render(mesh, camera, 96, outputs=("rgb", "alpha"))
    return torch.cat((images.rgb[0], images.alpha)).permute(1, 2, 0).clamp(0, 1)


def test_what_is_not_known_is_doubted() -> None:
    """A teapot was watercraft (87 %). Most objects of known kinds are not doubted."""
    strange = [nr.reconstruct(teapot(azimuth), steps=0) for azimuth in (20.0, 240.0)]
    for result in strange:
        assert result.verdict == "doubtful" and result.familiar < 0.5
        assert f"its mesh is a guess, nearest to {result.category}" in result.doubts[0]
        assert max(result.probabilities.values()) < 0.8
    familiar = [nr.reconstruct(view_of(number)[0][0].permute(1, 2, 0), steps=0) for number in (1, 5)]
    assert all(result.familiar > 0.5 for result in familiar)
    own = load_shape_network(WEIGHTS)  # other weights have no calibration
    assert nr.reconstruct(teapot(20.0), steps=0, network=own).familiar is None


def test_outlines_that_do_not_agree_are_doubted() -> None:
    result = nr.reconstruct(view_of(3)[0][0].permute(1, 2, 0), steps=0)
    assert result.outline > LEAST_OUTLINE and result.verdict == "good" and result.doubts == ()
    [doubt] = replace(result, outline=0.46).doubts
    assert doubt.startswith("the outline of the mesh agrees with the picture to an IoU of 0.46 only, expected 0.7;")


def test_probabilities_are_calibrated_by_a_temperature_and_a_logit() -> None:
    shares = torch.tensor([[0.9, 0.1], [0.5, 0.5]])
    numbers = Calibration(2.0, (1.0, -2.0), 0.5)
    assert torch.allclose(numbers.categories(shares), torch.tensor([[0.75, 0.25], [0.5, 0.5]]))
    assert torch.allclose(numbers.familiar(torch.tensor([[1.5, 1.0]])), torch.tensor([0.5]))
    shipped = shipped_calibration()
    assert len(shipped.weights) == 261 and 1 < shipped.temperature < 2


def test_the_command_needs_no_checkpoint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nr.save_image(tmp_path / "a.png", view_of(3)[0][0])
    arguments = ["reconstruct", "predict", str(tmp_path / "a.png"), "--refine", "2"]
    assert cli.main([*arguments, "--turntable", "2", "-o", str(tmp_path / "out")]) == 0
    assert "outline IoU" in capsys.readouterr().out
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"a.glb", "a_sheet.png", "a_turntable.gif"}
    nr.save_image(tmp_path / "pot.png", teapot(75.0))
    pictures = [str(tmp_path / name) for name in ("a.png", "pot.png")]
    command = ["reconstruct", "predict", *pictures, "--refine", "0", "--no-sheet", "--turntable", "0"]
    assert cli.main([*command, "-o", str(tmp_path / "both")]) == 3  # as of other doubtful results
    said = capsys.readouterr()
    assert "pot.glb: doubtful" in said.out and "a.glb: car (" in said.out
    assert f"{pictures[1]}: this looks like none of the 13 kinds" in said.err and pictures[0] not in said.err
    assert cli.main([*arguments, "--box", "0", "0", "0", "1", "-o", str(tmp_path / "b.obj")]) == 1
    assert "box: expected" in capsys.readouterr().err
