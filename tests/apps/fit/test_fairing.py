"""Fairing of noisy surfaces."""

from __future__ import annotations

import torch
import torch.nn.functional as F

from neural_renderer.apps.common.geometry.edges import area_vectors
from neural_renderer.apps.common.geometry.surface import Surface
from neural_renderer.apps.fit.detail.fairing import faired
from neural_renderer.meshes.primitives import cube
from neural_renderer.meshes.subdivision import split_faces


def test_noise_goes_and_creases_stay() -> None:
    """Faces of a noisy cube turn back to its six sides, also at its edges; vertices move no farther than by noise."""
    vertices, faces = cube()
    faces = faces.long()
    for _ in range(4):
        ends, faces = split_faces(faces, len(vertices))
        vertices = torch.cat((vertices, vertices[ends].mean(1)))
    true = F.normalize(area_vectors(vertices[faces]), dim=1)
    edge = float((vertices[faces[:, 0]] - vertices[faces[:, 1]]).norm(dim=1).min())
    noise = 0.05 * edge * torch.randn(vertices.shape, generator=torch.Generator().manual_seed(0))
    surface = Surface(torch.cat((vertices + noise, torch.full((len(vertices), 1), edge)), 1), faces)
    before = _angles(surface.vertices, faces, true)
    for _ in range(10):
        surface = surface.moved(faired(surface, 0.5))
    after = _angles(surface.vertices, faces, true)
    assert float(after.mean()) < 0.4 * float(before.mean()) and float(after.max()) < float(before.max())
    assert float((surface.vertices - vertices).norm(dim=1).max()) < 2 * float(noise.norm(dim=1).max())


def _angles(vertices: torch.Tensor, faces: torch.Tensor, true: torch.Tensor) -> torch.Tensor:
    normals = F.normalize(area_vectors(vertices[faces]), dim=1)
    angles: torch.Tensor = (normals * true).sum(1).clamp(-1, 1).acos().rad2deg()
    return angles
