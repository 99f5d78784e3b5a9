"""Turntables are photographs from evenly spaced azimuths."""

from __future__ import annotations

import torch

import neural_renderer as nr
from neural_renderer.pictures.photograph import photograph, turntable


def test_one_turn() -> None:
    vertices, faces = nr.torus(0.7, 0.2, 12, 8)
    mesh = nr.Mesh(vertices, faces, torch.rand(len(faces), 1, 1, 1, 3))
    frames = list(turntable(mesh, 3, 30.0, size=24, elevation=40.0))
    assert len(frames) == 3
    for frame, azimuth in zip(frames, (30.0, 150.0, 270.0), strict=True):
        assert torch.equal(frame, photograph(mesh, azimuth, 40.0, 24).cpu())
