"""One picture to a coloured mesh, with the shipped network, in Python and by the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.masks.rule import box_mask
from neural_renderer.apps.reconstruct.evaluation.picture import fit_outline, picture_colors, shipped_network
from neural_renderer.apps.reconstruct.shapes.shapes import CLASSES, Shapes
from neural_renderer.apps.reconstruct.shapes.views import crop_poses, draw, random_poses
from neural_renderer.meshes.primitives import torus


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


def test_the_command_needs_no_checkpoint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nr.save_image(tmp_path / "a.png", view_of(2)[0][0])
    arguments = ["reconstruct", "predict", str(tmp_path / "a.png"), "--refine", "2"]
    assert cli.main([*arguments, "--turntable", "2", "-o", str(tmp_path / "out")]) == 0
    assert "outline IoU" in capsys.readouterr().out
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"a.glb", "a_sheet.png", "a_turntable.gif"}
    assert cli.main([*arguments, "--box", "0", "0", "0", "1", "-o", str(tmp_path / "b.obj")]) == 1
    assert "box: expected" in capsys.readouterr().err
