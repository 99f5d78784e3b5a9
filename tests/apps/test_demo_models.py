"""Models of the demo: closed, facing outwards, in [-1, 1]³."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.geometry.isosurface import isosurface
from neural_renderer.apps.demo.models import duck, knot
from neural_renderer.meshes.topology import Topology


@pytest.mark.parametrize(("mesh", "characteristic"), [(duck(24, 2), 2), (knot(96, 12, 2), 0)], ids=["duck", "knot"])
def test_models_are_closed_and_face_outwards(mesh: nr.Mesh, characteristic: int) -> None:
    faces = mesh.faces.long()
    topology = Topology.of(faces)
    assert len(topology.hinges) == len(topology.edges)
    assert mesh.num_vertices - len(topology.edges) + mesh.num_faces == characteristic
    v0, v1, v2 = mesh.vertices.detach()[faces].unbind(1)
    assert (v0 * torch.linalg.cross(v1, v2)).sum() > 0  # six times the volume
    assert mesh.vertices.abs().max() <= 1.00001
    assert mesh.textures.min() >= 0 and mesh.textures.max() <= 1


def test_isosurface_of_a_ball() -> None:
    vertices, _ = isosurface(lambda p: np.linalg.norm(p, axis=-1) - 0.8, 32)
    assert torch.allclose(vertices.norm(dim=1), torch.tensor(0.8), atol=0.01)
