"""Depth peeling: against the faces of each pixel in the reference, and the rules of `coverage`."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given

from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.ops.peel import peel
from tests.raster.reference.drawing import peel_reference
from tests.raster.scenes import FAR, NEAR, Scene, doubt, examples, scenes


def draw(scene: Scene, device: str, layers: int) -> torch.Tensor:
    options = (scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective, layers)
    return peel(scene.faces.to(device), *options).cpu()


@examples(25)
@given(scene=scenes())
def test_random_scenes(device, scene):
    """Layers are ordered by depth, hold only faces that may be there, and leave out none that surely lies between."""
    found = draw(scene, device, 3)
    first = coverage(
        scene.faces.to(device), scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective
    ).cpu()
    assert found.dtype == torch.int32 and torch.equal(found[0], first)
    for b in range(scene.batch if scene.count else 0):
        open_ = doubt(scene.faces[b], scene.height, scene.width, scene.two_sided, scene.perspective)
        low, high = open_.depth - open_.error, open_.depth + open_.error
        certain = open_.certain & (low > NEAR) & (high < FAR)
        least, above = torch.full((2, *found.shape[2:]), -math.inf, dtype=torch.float64)
        for layer in found[:, b]:
            visible, index = layer >= 0, layer.clamp(min=0).long()[None]
            assert open_.possible.gather(0, index)[0][visible].all()
            assert (high.gather(0, index)[0] >= least)[visible].all()
            # Beyond both depths' rounding and the margin of 2^-17 of the depth, nothing is left out.
            missed = certain & (low > above * (1 + 2e-5)) & (high < low.gather(0, index))
            assert not missed.any(0)[visible].any()
            assert not (certain & (low > above * (1 + 2e-5))).any(0)[~visible].any()
            least, above = (torch.where(visible, d.gather(0, index)[0], math.inf) for d in (low, high))


def test_few_pixels_differ_from_the_reference(device):
    """Rounding decides at centres within some 1e-6 pixels of an edge: at most one centre in 10,000."""
    differ = total = 0
    for seed in range(4):
        scene = Scene(seed, 2, 30, 40, 37, seed % 2 == 0, seed % 3 != 0, ("plain", "tiny", "huge", "copy"))
        found = draw(scene, device, 4)
        expected = peel_reference(scene.faces, 40, 37, NEAR, FAR, scene.two_sided, scene.perspective, 4)
        differ += int((found != expected).sum())
        total += found.numel()
        assert (found[3] >= 0).any()
    assert differ <= 1e-4 * total


@pytest.mark.parametrize("perspective", [False, True])
def test_a_surface_counts_once_at_its_edges(device, perspective):
    """All centres of a column lie on the diagonals and edges of two tilted sheets, whose depths are rounded."""
    grid = torch.linspace(-1, 1, 9)
    x, y = torch.meshgrid(grid, grid, indexing="xy")
    for tilt in (0.0, 0.3):
        sheets = []
        for depth in (2.0, 3.0):
            points = torch.stack((x, y, depth + tilt * x + 0.1 * y), -1)
            a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
            sheets += [torch.stack((a, b, c), 2), torch.stack((a, c, d), 2)]
        faces = torch.stack(sheets).reshape(1, -1, 3, 3).to(device)
        found = peel(faces, 8, 8, NEAR, FAR, True, perspective, 3)
        assert (found[:2] >= 0).all() and (found[2] < 0).all()


def test_more_layers_than_faces(device):
    faces = torch.tensor([[[[-3.0, -3, 2], [3, -3, 2], [0, 3, 2]]]], device=device)
    found = peel(faces, 4, 4, NEAR, FAR, True, True, 3)
    assert (found[0] >= 0).any() and (found[1:] < 0).all()
    assert (peel(faces[:, :0], 4, 4, NEAR, FAR, True, True, 2) < 0).all()
