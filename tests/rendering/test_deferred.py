"""Fragments: visible faces, interpolated attributes, and composited images."""

from __future__ import annotations

import re

import pytest
import torch

import neural_renderer as nr
from tests.rounding import EPS, rounding


def scene(device, gradient="edge", **options):
    mesh = nr.Mesh.icosphere(2).to(device)
    camera = nr.Camera.look_at([[0.3, 1.0, -2.5], [1.5, 0.2, -2.0]], viewing_angle=30).to(device)
    return mesh, camera, nr.fragments(mesh, camera, (40, 56), gradient=gradient, **options)


def test_positions_lie_on_the_rays(device):
    """Interpolated positions, seen through the camera, fall on the centres of their pixels, at their depth."""
    mesh, camera, fragments = scene(device, anti_aliasing=False)
    points = fragments.interpolate(mesh.vertices)
    assert points.shape == (2, 40, 56, 3) and not points[~fragments.mask].any()
    screen = camera(points.flatten(1, 2), aspect=56 / 40).view(2, 40, 56, 3)
    x = (2 * torch.arange(56, device=device) + 1 - 56) / 56
    y = -(2 * torch.arange(40, device=device) + 1 - 40) / 40
    expected = torch.stack((x.expand(40, 56), y[:, None].expand(40, 56)), -1).expand(2, -1, -1, -1)
    # Weights of faces a few pixels wide are sums of products about (56 / 3)² times as large as the result.
    torch.testing.assert_close(
        screen[..., :2][fragments.mask], expected[fragments.mask], **rounding(4 * (56 // 3) ** 2)
    )
    torch.testing.assert_close(
        screen[..., 2][fragments.mask], fragments.depth[fragments.mask], **rounding(4 * (56 // 3) ** 2)
    )


def test_white_on_black_is_the_silhouette(device):
    mesh, camera, fragments = scene(device)
    image = fragments.composite(fragments.interpolate(torch.ones(len(mesh.vertices), 1, device=device)))
    expected = nr.render(mesh, camera, (40, 56), outputs="alpha").alpha
    torch.testing.assert_close(image[:, 0], expected, **rounding(16))


@pytest.mark.parametrize("gradient", ["nmr", "edge"])
def test_gradients_reach_everything(device, gradient):
    vertices, faces = (t.to(device) for t in nr.icosphere(2))
    vertices.requires_grad_()
    eye = torch.tensor([0.3, 1.0, -2.5], device=device, requires_grad=True)
    colors = torch.rand(len(vertices), 5, device=device, requires_grad=True)
    behind = torch.rand(5, 32, 32, device=device, requires_grad=True)
    fragments = nr.fragments((vertices, faces), nr.Camera.look_at(eye, viewing_angle=30), 32, gradient=gradient)
    image = fragments.composite(fragments.interpolate(colors) ** 2, behind)
    assert image.shape == (1, 5, 32, 32) and image.is_contiguous()
    weight = torch.randn(image.shape, generator=torch.Generator().manual_seed(0)).to(device)
    (image * weight).sum().backward()
    for leaf in (vertices, eye, colors, behind):
        assert leaf.grad.isfinite().all() and leaf.grad.any()
    hidden = torch.nn.functional.avg_pool2d((~fragments.mask).float()[:, None], 2)
    torch.testing.assert_close(behind.grad, (weight * hidden)[0])


def test_texture_coordinates_have_faces_of_their_own(device):
    mesh, _, fragments = scene(device)
    corners = torch.eye(3, device=device).repeat(len(mesh.faces), 1)
    own = torch.arange(3 * len(mesh.faces), device=device).view(-1, 3)
    torch.testing.assert_close(fragments.interpolate(corners, own), fragments.weights)


def test_what_does_not_fit(device):
    mesh, camera, fragments = scene(device)
    with pytest.raises(ValueError, match="triangles: expected 320 like the mesh's faces, got 2"):
        fragments.interpolate(mesh.vertices, mesh.faces[:2])
    with pytest.raises(ValueError, match="triangles: expected indices in"):
        fragments.interpolate(mesh.vertices[:5], mesh.faces)
    for wrong in (mesh.vertices[:5], torch.rand(len(mesh.faces), 2, device=device)):  # of faces, for example
        expected = re.escape("attributes: expected [162, C] for vertices or [320, 3, C] for corners, got [")
        with pytest.raises(ValueError, match=expected):
            fragments.interpolate(wrong)
    alone = nr.fragments((mesh.vertices, mesh.faces[:2]), camera, 8)  # as many faces as images
    with pytest.raises(ValueError, match=re.escape("or [2, 2, 3, C] for corners, got [2, 3, 4] float32")):
        alone.interpolate(torch.rand(2, 3, 4, device=device))
    with pytest.raises(TypeError, match="attributes: expected a floating-point"):
        fragments.interpolate(mesh.faces)
    with pytest.raises(TypeError, match="attributes: expected a floating-point torch tensor, got list"):
        fragments.interpolate([mesh.vertices])
    with pytest.raises(ValueError, match="colors: expected shape"):
        fragments.composite(torch.zeros(2, 40, 56, 3, device=device))
    with pytest.raises(ValueError, match="background: expected"):
        fragments.composite(torch.zeros(2, 80, 112, 3, device=device), [1.0, 2.0])
    with pytest.raises(TypeError, match="camera: expected a Camera, or None"):
        nr.fragments(mesh, 3.0)
    with pytest.raises(ValueError, match=r"vertices without a camera: expected shape \[V, 4\]"):
        nr.fragments(mesh, None)
    with pytest.raises(ValueError, match="gradient: expected one of nmr, edge, opendr"):
        nr.fragments(mesh, camera, gradient="soft")


def test_seams_between_faces_of_different_colour(device):
    """A colour for each face, as cubes and as shading of one's own: the same image, and the same gradient."""
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    colors = torch.rand(len(faces), 3, generator=torch.Generator().manual_seed(0)).to(device)
    camera = nr.Camera.look_at((0.3, 1.0, -2.5), viewing_angle=30)
    corners = torch.arange(3 * len(faces), device=device).view(-1, 3)

    def shaded(moved, seams):
        fragments = nr.fragments((moved, faces), camera, 48)
        return fragments.composite(fragments.interpolate(colors.repeat_interleave(3, 0), corners), seams=seams)

    def drawn(moved):
        cubes = colors[:, None, None, None].expand(-1, 2, 2, 2, 3).contiguous()
        return nr.render((moved, faces, cubes), camera, 48, light=None, gradient="edge").rgb

    torch.testing.assert_close(shaded(vertices, True), drawn(vertices), **rounding(32))
    weight = torch.randn(1, 3, 48, 48, generator=torch.Generator().manual_seed(1)).to(device)
    found = []
    for draw in (lambda v: shaded(v, True), lambda v: shaded(v, False), drawn):
        leaf = vertices.clone().requires_grad_()
        found += torch.autograd.grad((draw(leaf) * weight).sum(), leaf)
    with_seams, without, expected = found
    # A vertex gathers at most about 48² terms; cubes interpolate colours that differ in their last bits.
    torch.testing.assert_close(with_seams, expected, rtol=0, atol=48**2 * EPS * float(expected.abs().max()))
    assert (without - expected).norm() > 0.3 * expected.norm()


def test_meshes_of_different_sizes(device):
    """A list is drawn as each mesh alone, and all that follows takes what `batch` makes."""
    meshes = [mesh.to(device).trainable() for mesh in (nr.Mesh.icosphere(1, 0.8), nr.Mesh.icosphere(2))]
    camera = nr.Camera.look_at((0.3, 1.0, -2.5), viewing_angle=30).to(device)
    fragments = nr.fragments(meshes, camera, 24)
    vertices, _, _ = nr.batch(meshes)
    points = fragments.interpolate(vertices)
    image = fragments.composite(points, background=(0.0, 0.5, 1.0))
    for i, mesh in enumerate(meshes):
        alone = nr.fragments(mesh, camera, 24)
        assert torch.equal(fragments.face_index[i], alone.face_index[0])
        assert torch.equal(points[i], alone.interpolate(mesh.vertices)[0])
        assert torch.equal(image[i], alone.composite(alone.interpolate(mesh.vertices), (0.0, 0.5, 1.0))[0])
        assert torch.equal(fragments.visible_faces()[i, : mesh.num_faces], alone.visible_faces()[0])
        assert torch.equal(fragments.visible_vertices()[i, : mesh.num_vertices], alone.visible_vertices()[0])
    assert not fragments.visible_faces()[0, meshes[0].num_faces :].any()
    image.sum().backward()
    assert all(mesh.vertices.grad.any() for mesh in meshes)


def test_attributes_of_corners(device):
    mesh, _, fragments = scene(device)
    corners = torch.rand(mesh.num_faces, 3, 5, device=device, requires_grad=True)
    own = torch.arange(3 * mesh.num_faces, device=device).view(-1, 3)
    expected = fragments.interpolate(corners.reshape(-1, 5), own)
    for given in (corners, corners[None], corners.expand(2, -1, -1, -1)):
        assert torch.equal(fragments.interpolate(given), expected)
    weight = torch.rand(expected.shape, device=device)
    (found,) = torch.autograd.grad((fragments.interpolate(corners) * weight).sum(), corners)
    (wanted,) = torch.autograd.grad((expected * weight).sum(), corners)
    # Sums over the pixels of a face, of numbers up to 1.
    torch.testing.assert_close(found, wanted, **rounding(400, 1))
    with pytest.raises(ValueError, match="triangles: expected None"):
        fragments.interpolate(corners[None], own)
    with pytest.raises(ValueError, match=r"attributes: expected shape \[B, 320, 3, C\]"):
        fragments.interpolate(corners[None, 1:])
    with pytest.raises(ValueError, match="attributes: expected a batch of 1 or 2, got 3"):
        fragments.interpolate(corners.expand(3, -1, -1, -1))


def test_visible_faces_and_vertices(device):
    mesh, _, fragments = scene(device)
    for i in range(2):
        shown = sorted(set(fragments.face_index[i].flatten().tolist()) - {-1})
        assert torch.nonzero(fragments.visible_faces()[i]).flatten().tolist() == shown
        used = sorted(set(mesh.faces[shown].flatten().tolist()))
        assert torch.nonzero(fragments.visible_vertices(200)[i]).flatten().tolist() == used
    assert fragments.visible_vertices(200).shape == (2, 200) and fragments.visible_vertices().shape == (2, 162)
    with pytest.raises(ValueError, match="count: expected at least 162, got 100"):
        fragments.visible_vertices(100)


def test_a_background_has_its_channels_first_or_last(device):
    mesh, camera, fragments = scene(device)
    height = fragments.interpolate(mesh.vertices)
    for shape in ((3, 40, 56), (2, 3, 40, 56)):
        behind = torch.rand(shape, device=device, requires_grad=True)
        last = behind.movedim(-3, -1)
        for call in (
            lambda image: nr.render(mesh, camera, (40, 56), background=image).rgb,
            lambda image: fragments.composite(height, image),
        ):
            expected = call(behind)
            assert torch.equal(call(last), expected)
            (gradient,) = torch.autograd.grad(expected.sum(), behind)
            assert torch.equal(torch.autograd.grad(call(last).sum(), behind)[0], gradient)
    cubic = torch.rand(3, 3, 3, device=device)  # fits both: the channels are first
    drawn = nr.render((mesh.vertices + 9, mesh.faces, mesh.textures), camera[0], 3, background=cubic).rgb[0]
    assert torch.equal(drawn, cubic)
    clear = torch.rand(40, 56, 4, device=device)
    with pytest.raises(ValueError, match=r"\[40, 56, 3\] or a batch .*\[\.\.\., :3\] is without transparency"):
        nr.render(mesh, camera, (40, 56), background=clear)


def test_images_of_different_sizes_are_told(device):
    mesh, camera, _ = scene(device)
    with pytest.raises(
        ValueError, match=r"size: .* got \[\(8, 9\), \(4, 4\)\]; images of different sizes are drawn by"
    ):
        nr.render(mesh, camera, [(8, 9), (4, 4)])
