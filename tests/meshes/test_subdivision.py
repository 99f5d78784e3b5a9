"""Midpoint subdivision: four faces each, edges in order, surfaces unchanged."""

from __future__ import annotations

import torch

import neural_renderer as nr
from neural_renderer.meshes.subdivision import split_faces


def test_four_faces_of_a_quarter_each() -> None:
    vertices, faces = (part.double() for part in nr.cube())
    edges, split = split_faces(faces.long(), len(vertices))
    assert len(edges) == 18 and (edges[:, 0] < edges[:, 1]).all()
    assert torch.equal(edges, edges[torch.argsort(edges[:, 0] * 8 + edges[:, 1])])
    a, b, c = torch.cat((vertices, vertices[edges].mean(1)))[split].unbind(1)
    # Corners of the cube are -1 and 1: all products are exact.
    areas = torch.linalg.cross(b - a, c - a)
    p, q, r = vertices[faces.long()].unbind(1)
    assert torch.equal(areas, (torch.linalg.cross(q - p, r - p) / 4).repeat_interleave(4, 0))
