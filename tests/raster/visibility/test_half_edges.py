"""Half-edges by vertex indices: the neighbours found by them are those found by corners."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster.ops import half_edges as module
from neural_renderer.raster.ops import neighbors as of_neighbors
from neural_renderer.raster.ops.half_edges import find_half_edges
from neural_renderer.raster.ops.neighbors import neighbors


def points(count, seed, batch=1):
    vertices = torch.rand(batch, count, 3, generator=torch.Generator().manual_seed(seed))
    return vertices * torch.tensor([2.0, 2.0, 3.0]) + torch.tensor([-1.0, -1.0, 0.5])


def check_neighbors(vertices, faces, two_sided):
    """Assert equal neighbours with and without half-edges, of many faces and of few, and return them."""
    corners = nr.vertices_to_faces(vertices, faces)
    half_edges = find_half_edges(faces.to(corners.device))
    for folds in (False, True):
        found = neighbors(corners, two_sided, True, half_edges, folds).cpu()
        with pytest.MonkeyPatch.context() as many:
            many.setattr(of_neighbors, "_MANY", 0)
            assert torch.equal(neighbors(corners, two_sided, True, half_edges, folds).cpu(), found)
        expected = neighbors(corners, two_sided, True, folds=folds).cpu()
        assert torch.equal(found, expected)
    return neighbors(corners, two_sided, True).cpu()


@pytest.mark.parametrize("dtype", [torch.int32, torch.int64])
def test_edges_with_the_same_vertices_are_siblings(dtype):
    faces = torch.tensor([[0, 1, 2], [2, 1, 3], [1, 2, 4], [-1, -1, -1], [5, 5, 6], [0, 3, 1]], dtype=dtype)
    half_edges = find_half_edges(faces)
    assert half_edges.siblings.dtype == torch.int32 and half_edges.siblings.shape == (1, 6, 3)
    own = torch.arange(18).view(6, 3)
    expected = own.clone()
    expected[0, 1], expected[1, 0], expected[2, 0] = 3, 6, 1  # 1 - 2, of three faces
    expected[0, 0], expected[5, 2] = 17, 0  # 0 - 1
    expected[1, 1], expected[5, 1] = 16, 4  # 1 - 3
    expected[4, 1], expected[4, 2] = 14, 13  # 5 - 6, twice in one face
    assert torch.equal(half_edges.siblings[0].long(), expected)
    assert half_edges.boundary == (expected == own).sum()


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_same_neighbors_as_by_corners(device, seed, two_sided):
    random = torch.Generator().manual_seed(seed)
    batch, count = 1 + seed % 2, 24
    shape = (count, 3) if seed % 4 < 2 else (batch, count, 3)
    faces = torch.rand(*shape[:-1], 9, generator=random).argsort(-1)[..., :3]
    faces[..., 3, :] = -1
    expected = check_neighbors(points(9, seed, batch).to(device), faces.to(device), two_sided)
    assert (expected >= 0).any()


@pytest.mark.parametrize("two_sided", [False, True])
def test_doubled_vertices_are_found_by_their_corners(device, two_sided):
    """Meshes have them along the seams of texture coordinates."""
    vertices, faces = nr.icosphere(2)
    doubled = faces.clone()
    doubled[100:] += len(vertices)
    camera = nr.Camera.look_at((1.0, 1.0, -2.5))
    screen = camera(torch.cat((vertices, vertices)))
    expected = check_neighbors(screen.to(device), doubled.to(device), two_sided)
    assert torch.equal(expected, neighbors(nr.vertices_to_faces(screen, faces), two_sided, True))


def test_faces_changed_in_place_get_new_half_edges(device):
    faces = torch.tensor([[0, 1, 2], [2, 1, 3]], device=device)
    first = find_half_edges(faces)
    assert find_half_edges(faces) is first
    faces[1] = torch.tensor([3, 4, 5], device=device)
    assert (find_half_edges(faces).siblings.flatten().cpu() == torch.arange(6)).all()
    faces[1] = torch.tensor([2, 1, 3], device=device)
    assert torch.equal(find_half_edges(faces).siblings, first.siblings)


def test_half_edges_found_in_inference_mode_serve_gradients_later(device):
    faces = nr.icosphere(0)[1].to(device)
    with torch.inference_mode():
        find_half_edges(faces.clone())
    assert not find_half_edges(faces.clone()).siblings.is_inference()


def gradient(vertices, faces, change=None):
    leaf = vertices.clone().requires_grad_()
    camera = nr.Camera.look_at((0.3, 0.8, -2.2))
    fragments = nr.fragments((leaf, faces), camera, 24, gradient="edge")
    if change is not None:
        faces[:] = change
    colors = torch.rand(fragments.mask.shape, generator=torch.Generator().manual_seed(0)).to(leaf.device)
    (fragments.composite(colors[..., None]) * colors[:, None, ::2, ::2]).sum().backward()
    return leaf.grad


@pytest.mark.usefixtures("deterministic")
def test_faces_may_change_before_the_image_is_made(device):
    """Faces of 64 bits: they are copied to 32. (Changes of 32-bit faces are errors in backward.)"""
    vertices, faces = (t.to(device) for t in nr.icosphere(1, 0.7))
    faces = faces.long()
    expected = gradient(vertices, faces)
    assert torch.equal(gradient(vertices, faces.clone(), change=faces.flip(0).roll(1, 1)), expected)
    assert expected.any()


@pytest.mark.usefixtures("deterministic")
def test_rasterized_with_indices_and_without(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(2, 0.7))
    screen = nr.Camera.look_at((0.3, 0.8, -2.2))(vertices)
    grads = []
    for triangles in (None, faces, faces[None].short()):
        leaf = nr.vertices_to_faces(screen, faces).requires_grad_()
        images = nr.rasterize_images(leaf, 32, outputs=("alpha", "depth"), gradient="edge", triangles=triangles)
        (images.alpha.square().sum() + images.depth.sum()).backward()
        grads.append(leaf.grad)
    assert torch.equal(grads[0], grads[1]) and torch.equal(grads[0], grads[2]) and grads[0].any()


@pytest.mark.parametrize(
    ("triangles", "error", "message"),
    [
        ("faces", TypeError, "triangles: expected a torch tensor of whole numbers"),
        (torch.zeros(4, 3, dtype=torch.int32), ValueError, r"triangles: expected \[2, 3\] or"),
        (torch.zeros(3, 2, 3, dtype=torch.int32), ValueError, r"triangles: expected \[2, 3\] or \[2 or 1, 2, 3\]"),
        (torch.full((2, 3), 0.5), ValueError, "triangles: expected whole numbers"),
    ],
)
def test_invalid_indices_are_errors(triangles, error, message):
    with pytest.raises(error, match=message):
        nr.rasterize_images(torch.rand(2, 2, 3, 3), 8, outputs=("alpha",), triangles=triangles)


def test_half_edges_that_a_graph_reads_live_as_long_as_its_faces(monkeypatch):
    faces = nr.icosphere(1)[1]
    known = find_half_edges(faces)
    monkeypatch.setattr(module, "stream_of", lambda device: None)  # as while a graph is captured
    assert find_half_edges(faces) is known
    module._cache.clear()
    assert module._captured[faces] is known
