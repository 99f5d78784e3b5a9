"""Remeshing: topology, faces, lengths of edges, distance to the old surface, values carried along."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.geometry.edges import Edges, area_vectors, connected_components, lengths
from neural_renderer.apps.common.geometry.operations import collapse_short, flip_edges, split, split_long
from neural_renderer.apps.common.geometry.remesh import remesh_once
from neural_renderer.apps.common.geometry.surface import Surface


def bumpy_sphere(level: int) -> tuple[Tensor, Tensor]:
    vertices, faces = nr.icosphere(level)
    x, y, z = vertices.unbind(1)
    return vertices * (1 + 0.15 * torch.sin(5 * x) * torch.cos(4 * y + z))[:, None], faces


CLOSED = {
    "torus": nr.torus(segments=24, sides=12),
    "sphere": bumpy_sphere(3),
    "cube": nr.cube(),
    "tetrahedron": (torch.eye(4)[:, :3] - 0.25, torch.tensor([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])),
}


def surface_of(vertices: Tensor, faces: Tensor, length: float) -> Surface:
    return Surface(torch.cat((vertices, torch.full((len(vertices), 1), length)), 1), faces.long())


def topology(vertices: Tensor, faces: Tensor) -> tuple[bool, int, int]:
    """Watertight with consistent orientation, and Euler characteristic, as trimesh sees them; components."""
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    components = len(torch.unique(connected_components(faces)))
    return mesh.is_watertight and mesh.is_winding_consistent, mesh.euler_number, components


@pytest.mark.parametrize("name", CLOSED)
@pytest.mark.parametrize("length", [0.6, 0.15, 0.06])
def test_closed_manifold_stays_one(name: str, length: float) -> None:
    vertices, faces = CLOSED[name]
    assert topology(vertices, faces)[0]
    found = nr.remesh((vertices, faces), length)
    assert topology(found.vertices, found.faces) == topology(vertices, faces)
    edges = Edges.of(found.faces, len(found.vertices))
    assert edges.regular.all()  # each edge has two faces, and trimesh agrees
    assert len(torch.unique(found.faces)) == len(found.vertices)
    assert len(torch.unique(found.faces.sort(1).values, dim=0)) == len(found.faces)


def test_smooth_surface_becomes_isotropic() -> None:
    """On a smooth surface with an edge length below its features, faces are good, and the surface stays."""
    length = 0.06
    for vertices, faces in (bumpy_sphere(3), nr.torus(segments=48, sides=24)):
        found = nr.remesh((vertices, faces), length)
        corners = found.vertices[found.faces]
        normals = area_vectors(corners)
        edges = Edges.of(found.faces, len(found.vertices))
        size = lengths(found.vertices, edges.ends) / length
        # Splits and collapses end between 4/5 and 4/3; smoothing comes after them.
        assert 0.8 < size.mean() < 4 / 3
        assert ((size > 0.6) & (size < 1.6)).float().mean() > 0.99
        quality = 2 * 3**0.5 * normals.norm(dim=1) / (corners - corners.roll(-1, 1)).square().sum((1, 2))
        assert quality.min() > 0.3
        assert quality.mean() > 0.93
        assert (edges.valence() == 6).float().mean() > 0.6
        # No face looks the other way: its normal agrees with that of the old surface beside it.
        beside = nr.closest_points((vertices, faces), corners.mean(1))
        assert ((torch.nn.functional.normalize(normals, dim=1) * beside.normals).sum(1) > 0.7).all()
        # Vertices lie on the old surface; faces leave it by the height of an arc over an edge, L² / 8 R, of radius
        # R ≥ 0.2, and as much again because the old faces are chords, too.
        on_surface = nr.closest_points((vertices, faces), found.vertices)
        assert (on_surface.points - found.vertices).norm(dim=1).max() < 0.3 * length
        assert (on_surface.points - found.vertices).norm(dim=1).mean() < 1e-3 * length
        samples = nr.sample_points((vertices, faces), 2000, torch.Generator().manual_seed(0)).points
        back = nr.closest_points((found.vertices, found.faces), samples)
        assert (back.points - samples).norm(dim=1).mean() < 2 * length**2 / (8 * 0.2)


def test_lengths_of_vertices() -> None:
    vertices, faces = nr.icosphere(3)
    wanted = torch.where(vertices[:, 1] > 0, 0.05, 0.15)
    found = nr.remesh((vertices, faces), wanted)
    ends = Edges.of(found.faces, len(found.vertices)).ends
    size, height = lengths(found.vertices, ends), found.vertices[ends].mean(1)[:, 1]
    assert 0.04 < size[height > 0.2].mean() < 4 / 3 * 0.05
    assert 0.12 < size[height < -0.2].mean() < 4 / 3 * 0.15


def test_attributes_are_carried_along() -> None:
    """An affine function of the position stays one under splits and collapses, not under smoothing."""
    vertices, faces = bumpy_sphere(2)
    values = torch.stack((vertices.sum(1), 2 * vertices[:, 0] - 1), 1).double()
    surface = surface_of(vertices, faces, 0.1)
    surface = Surface(torch.cat((surface.values, values.float()), 1), surface.faces)
    for _ in range(3):
        surface = collapse_short(split_long(surface))
    x = surface.vertices
    expected = torch.stack((x.sum(1), 2 * x[:, 0] - 1), 1)
    torch.testing.assert_close(surface.values[:, 4:], expected, rtol=0, atol=1e-5)
    found = nr.remesh((vertices, faces), 0.1, attributes=values)
    assert found.attributes is not None
    assert found.attributes.dtype == torch.float64
    # Smoothing moves a vertex by less than half an edge in each of five passes, mostly back and forth.
    assert (found.attributes[:, 0] - found.vertices.sum(1)).abs().mean() < 0.1
    assert nr.remesh((vertices, faces), 0.1).attributes is None


@pytest.mark.parametrize("number", range(1, 8))
def test_split_faces_cover_the_old_ones(number: int) -> None:
    """Any choice of edges to split: same area and orientation, no gap."""
    vertices, faces = nr.icosphere(2)
    surface = surface_of(vertices, faces, 1.0)
    edges = Edges.of(surface.faces, len(vertices))
    chosen = torch.arange(len(edges.keys)) * 37 % 7 < number
    found = split(surface, edges, chosen)
    assert len(found.values) == len(vertices) + int(chosen.sum())
    assert len(found.faces) == len(faces) + 2 * int(chosen.sum())
    assert topology(found.vertices, found.faces) == topology(vertices, faces)
    old, new = (area_vectors(part.vertices[part.faces]) for part in (surface, found))
    torch.testing.assert_close(new.norm(dim=1).sum(), old.norm(dim=1).sum())
    torch.testing.assert_close(found.vertices[: len(vertices)], vertices)


def test_flips_bring_valences_nearer_to_six() -> None:
    vertices, faces = CLOSED["torus"]
    surface = split_long(split_long(surface_of(vertices, faces, 0.1)))
    before, after = (
        Edges.of(part.faces, len(part.values)).valence() for part in (surface, flip_edges(surface, rounds=20))
    )
    assert (after - 6).square().sum() < (before - 6).square().sum()
    assert after.sum() == before.sum()


def test_border_stays() -> None:
    """An open patch: its border keeps its vertices, and the corners of the surface their place."""
    line = torch.linspace(-1, 1, 9)
    grid = torch.stack((*torch.meshgrid(line, line, indexing="ij"), torch.zeros(9, 9)), -1).reshape(-1, 3)
    corner = (torch.arange(8)[:, None] * 9 + torch.arange(8)).flatten()[:, None]
    faces = torch.cat((corner + torch.tensor([0, 9, 10]), corner + torch.tensor([0, 10, 1])))
    for length in (0.1, 0.7):
        found = nr.remesh((grid, faces), length)
        border = Edges.of(found.faces, len(found.vertices))
        assert (found.vertices[border.fixed][:, :2].abs().amax(1) == 1).all()
        assert border.fixed.sum() >= 32
        area = area_vectors(found.vertices[found.faces])
        torch.testing.assert_close(area.sum(0) / 2, torch.tensor([0.0, 0.0, 4.0]), rtol=1e-5, atol=1e-5)
        assert (area[:, 2] > 0).all()


def test_non_manifold_parts_stay() -> None:
    """Three sheets that meet in one edge."""
    vertices = torch.tensor([[0.0, 0, -1], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]])
    faces = torch.tensor([[0, 1, 2], [1, 0, 3], [1, 0, 4]])
    found = nr.remesh((vertices, faces), 0.2)
    area = area_vectors(found.vertices[found.faces]).norm(dim=1).sum()
    torch.testing.assert_close(area, area_vectors(vertices[faces]).norm(dim=1).sum(), rtol=1e-4, atol=0)
    edges = Edges.of(found.faces, len(found.vertices))
    on_axis = (found.vertices[edges.ends][..., :2].abs() < 1e-6).all(2).all(1)
    assert not edges.regular[on_axis].any()
    torch.testing.assert_close(lengths(found.vertices, edges.ends[on_axis]).sum(), torch.tensor(2.0))


def test_input_is_kept_and_degenerate_faces_are_dropped() -> None:
    mesh = nr.Mesh(*nr.torus(segments=12, sides=6))
    vertices, faces = mesh.vertices.clone(), mesh.faces.clone()
    found = nr.remesh(mesh, 0.2)
    assert torch.equal(mesh.vertices, vertices) and torch.equal(mesh.faces, faces)
    assert not found.vertices.requires_grad
    again = nr.remesh((vertices, torch.cat((faces, torch.tensor([[0, 0, 1]], dtype=faces.dtype)))), 0.2)
    assert torch.equal(again.vertices, found.vertices) and torch.equal(again.faces, found.faces)


def test_in_an_optimisation() -> None:
    """One pass at each step: a sphere grows fivefold, and its edges keep their length."""
    vertices, faces = nr.icosphere(2)
    surface = surface_of(vertices, faces, 0.25)
    for _ in range(12):
        surface = remesh_once(surface.moved(surface.vertices * 1.15), rounds=1)
    assert topology(surface.vertices, surface.faces) == (True, 2, 1)
    radius = surface.vertices.norm(dim=1)
    torch.testing.assert_close(radius.mean(), torch.tensor(1.15**12), rtol=0.02, atol=0)
    size = lengths(surface.vertices, Edges.of(surface.faces, len(surface.values)).ends)
    assert 0.8 < size.mean() / 0.25 < 4 / 3
    assert len(surface.faces) > 15 * len(faces)


def test_errors() -> None:
    vertices, faces = nr.cube()
    for call, sentence in [
        (lambda: nr.remesh((vertices, faces), 0.0), "edge_length: expected"),
        (lambda: nr.remesh((vertices, faces), math.inf), "edge_length: expected"),
        (lambda: nr.remesh((vertices, faces), 1e-6), "edge_length: expected a length that gives at most 20,000,000"),
        (lambda: nr.remesh((vertices, faces), torch.zeros(8)), "edge_length: expected finite lengths above 0"),
        (lambda: nr.remesh((vertices, faces), torch.ones(7)), r"edge_length: expected shape \[8\]"),
        (lambda: nr.remesh((vertices, faces), 0.1, passes=0), "passes: expected"),
        (
            lambda: nr.remesh((vertices, faces), 0.1, attributes=torch.ones(7, 2)),
            r"attributes: expected shape \[8, C\]",
        ),
        (lambda: nr.remesh((vertices, faces[:0]), 0.1), "mesh: expected at least one face"),
        (lambda: nr.remesh((vertices * math.nan, faces), 0.1), "vertices: expected finite"),
        (lambda: nr.remesh((vertices, faces + 8), 0.1), "faces: expected"),
        (lambda: nr.closest_points((vertices, faces[:0]), vertices), "mesh: expected at least one face"),
        (lambda: nr.closest_points((vertices, faces), vertices * math.nan), "points: expected finite"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            call()


@pytest.mark.parametrize("name", ["sphere", "torus", "cube"])
def test_closest_points_agree_with_a_full_search(name: str) -> None:
    """Against the closest point on every face, in float64, by the regions of a triangle (as trimesh computes them)."""
    vertices, faces = CLOSED[name]
    points = 2.5 * torch.rand(60, 3, generator=torch.Generator().manual_seed(1)) - 1.25
    points = torch.cat((points, vertices[:20], vertices[faces[:20].long()].mean(1)))
    found = nr.closest_points((vertices, faces), points)
    triangles = vertices[faces.long()].double().numpy()
    near = [
        trimesh.triangles.closest_point(triangles, np.broadcast_to(point, (len(triangles), 3)))
        for point in points.double().numpy()
    ]
    expected = [np.linalg.norm(each - point, axis=1).min() for each, point in zip(near, points.numpy(), strict=True)]
    np.testing.assert_allclose((found.points - points).norm(dim=1), expected, rtol=0, atol=2e-6)
    torch.testing.assert_close(found.interpolate(vertices), found.points)
    assert (found.weights >= 0).all()
