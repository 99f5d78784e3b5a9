"""Turntables are photographs from evenly spaced azimuths."""

from __future__ import annotations

import torch
import torch.nn.functional as F

import neural_renderer as nr
from neural_renderer.apps.common.pictures.photograph import _blur, photograph, turntable


def test_one_turn() -> None:
    vertices, faces = nr.torus(0.7, 0.2, 12, 8)
    mesh = nr.Mesh(vertices, faces, torch.rand(len(faces), 1, 1, 1, 3))
    frames = list(turntable(mesh, 3, 30.0, size=24, elevation=40.0))
    assert len(frames) == 3
    for frame, azimuth in zip(frames, (30.0, 150.0, 270.0), strict=True):
        assert torch.equal(frame, photograph(mesh, azimuth, 40.0, 24).cpu())


def test_blur_is_three_boxes_and_a_resize() -> None:
    shadow = torch.rand(1, 1, 9, 14)
    expected = shadow
    for _ in range(3):
        expected = F.avg_pool2d(F.pad(expected, [2] * 4, mode="replicate"), 5, stride=1)
    expected = F.interpolate(expected, (19, 28), mode="bilinear", align_corners=False)
    torch.testing.assert_close(_blur(9, 19, 2) @ shadow @ _blur(14, 28, 2).t(), expected, rtol=1e-5, atol=1e-6)
