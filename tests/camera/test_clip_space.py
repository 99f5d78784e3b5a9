"""Vertices in clip space instead of a camera."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer import Camera

F, NEAR, FAR = 2.0, 0.1, 10.0
PROJECTION = torch.tensor(
    [[F, 0, 0, 0], [0, F, 0, 0], [0, 0, -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)], [0, 0, -1, 0]]
)
VIEW = torch.eye(4)
VIEW[2, 3] = -3.0
MATRIX = PROJECTION @ VIEW
MESH = nr.Mesh.icosphere(2, texture_size=1)


def clip_vertices(vertices: torch.Tensor | None = None) -> torch.Tensor:
    vertices = MESH.vertices.detach() if vertices is None else vertices
    return torch.cat((vertices, torch.ones(len(vertices), 1)), 1) @ MATRIX.T


@pytest.mark.parametrize("batch", [1, 2])
def test_they_show_what_the_matrix_shows(batch: int) -> None:
    camera = Camera.from_clip(MATRIX)
    clip = clip_vertices().expand(batch, -1, -1) if batch > 1 else clip_vertices()
    expected = nr.fragments(MESH, camera, 48)
    found = nr.fragments((clip, MESH.faces), None, 48)
    # Both round; a pixel whose centre lies on an edge may show either face.
    assert (found.face_index != expected.face_index).float().mean() < 1e-3
    same = found.face_index == expected.face_index
    torch.testing.assert_close(found.depth[same], expected.depth.expand(batch, -1, -1)[same])
    drawn = nr.render((clip, MESH.faces, MESH.textures), None, 48, light=None)
    plain = nr.render(MESH, camera, 48, light=None)
    assert ((drawn.rgb - plain.rgb).abs() > 1e-3).float().mean() < 2e-3


def test_gradients_reach_them() -> None:
    """Through the matrix they are those that the camera gives the vertices."""
    found, expected = (MESH.vertices.detach().clone().requires_grad_() for _ in range(2))
    for mesh, camera in (
        ((clip_vertices(found), MESH.faces), None),
        ((expected, MESH.faces), Camera.from_clip(MATRIX)),
    ):
        fragments = nr.fragments(mesh, camera, 32)
        fragments.composite(torch.ones(*fragments.face_index.shape, 1))[0, 0, 16, :8].sum().backward()
    assert expected.grad is not None and expected.grad.abs().max() > 0.1
    torch.testing.assert_close(found.grad, expected.grad, rtol=1e-3, atol=1e-3)


def test_errors() -> None:
    clip = clip_vertices()
    for call, error, sentence in [
        (lambda: nr.fragments(MESH, None, 8), ValueError, r"vertices without a camera: expected shape \[V, 4\]"),
        (lambda: nr.fragments(MESH, 3, 8), TypeError, "camera: expected a Camera, or None for vertices in clip space"),
        (lambda: nr.render((clip, MESH.faces, MESH.textures), None, 8), ValueError, "light: expected None"),
        (
            lambda: nr.fragments((torch.cat((clip[:, :3], torch.ones(len(clip), 1)), 1), MESH.faces), None, 8),
            ValueError,
            "expected clip coordinates of a perspective projection",
        ),
    ]:
        with pytest.raises(error, match=sentence):
            call()


def test_what_is_not_lit_needs_no_light():
    vertices, faces = clip_vertices(), MESH.faces
    images = nr.render((vertices, faces), None, 8, outputs=("alpha", "depth", "face_index"))
    assert torch.equal(images.alpha, nr.render((vertices, faces), None, 8, light=None, outputs="alpha").alpha)
    with pytest.raises(ValueError, match="light: expected None"):
        nr.render((vertices, faces), None, 8)
