"""Hashes of edges: equal on both faces exactly where the colour is continuous."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.texels import Texels
from neural_renderer.raster.colors.edge_hashes import image_edge_hashes, texture_edge_hashes
from neural_renderer.raster.settings import Settings
from neural_renderer.raster.visibility.edge import EdgeOptions, edge_gradient_backward
from tests.rounding import rounding


def matches(edge_hashes, faces):
    """Test which edges of a closed surface match the edge of the adjacent face, [B, 3 F] bool."""
    places = {}
    for f, corners in enumerate(faces.tolist()):
        for k in range(3):
            places[corners[k], corners[(k + 1) % 3]] = 3 * f + k
    other = [places[q, p] for p, q in places]
    order = [places[edge] for edge in places]
    there, back = edge_hashes.flatten(1, 2).unbind(2)
    return there[:, order] == back[:, other]


def sphere(device):
    vertices, faces = nr.icosphere(2)
    vertices = vertices.to(device) + torch.tensor([0.0, 0.0, 3.0], device=device)
    return vertices, faces.to(device)


def test_cubes_match_where_they_share_texels(device):
    _, faces = sphere(device)
    random = torch.Generator().manual_seed(0)
    light = torch.ones(1, 2, len(faces), 3, device=device)
    for size in (3, 4, 5):
        texels = Texels.shared(faces, size)
        shared = texels.cubes(torch.rand(texels.count, 3, generator=random).to(device))[None]
        # Rounding may take values at the border of a rounding step to either side.
        assert matches(texture_edge_hashes(shared, light), faces).float().mean() > 0.98
        assert matches(texture_edge_hashes(shared + 1e-7 * torch.rand_like(shared), light), faces).float().mean() > 0.9
        assert matches(texture_edge_hashes(shared.round(decimals=2), light), faces).all()
        free = torch.rand(1, len(faces), size, size, size, 3, generator=random).to(device)
        assert not matches(texture_edge_hashes(free, light), faces).any()
    dim = light.clone()
    dim[:, :, ::2] = 0.5
    assert not matches(texture_edge_hashes(shared, dim), faces).all()
    both = texture_edge_hashes(torch.cat((shared.round(decimals=2), free)), light)
    assert both.shape == (2, len(faces), 3, 2) and matches(both, faces)[0].all() and not matches(both, faces)[1].all()


@pytest.mark.parametrize("size", [2, 3])
def test_no_discontinuity_is_missed(device, size):
    """Colours of any scale, in any channel, and texels in the opposite order."""
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [0, 3, 1], [3, 2, 1]], device=device)
    light = torch.ones(1, 2, 4, 3, device=device)
    pairs = [((0.2, 0.2, 0.1), (0.2, 0.2, 2.1)), ((0, 0, -1), (0, 0, 1)), ((10, 20, 100), (10, 20, 200))]
    pairs += [((0, 1, 0), (0, 0, 1 / 512)), ((6e5, 0, 0), (5e6, 0, 0)), ((1e-4, 0, 0), (0, 0, 0))]
    for one, other in pairs:
        cubes = torch.tensor([one, other, one, other], dtype=torch.float32, device=device)
        cubes = cubes[None, :, None, None, None].expand(1, 4, size, size, size, 3)
        edge_hashes = texture_edge_hashes(cubes, light)
        found = matches(edge_hashes, faces).view(1, 4, 3)
        assert not found[0, 0, 2] and not found[0, 1, 0]  # edge 0-2, of a face of each colour
        assert matches(texture_edge_hashes(cubes[:, :1].expand_as(cubes), light), faces).all()
    ramp = torch.linspace(0, 1, size, device=device)
    cubes = torch.zeros(1, 4, size, size, size, 3, device=device)
    cubes[0, 0, ..., 0] += ramp.view(size, 1, 1)  # towards corner 0 of the edge 0-2
    cubes[0, 1, ..., 0] += ramp.view(1, size, 1)  # towards corner 2 of it
    assert not matches(texture_edge_hashes(cubes, light), faces).view(4, 3)[0, 2]
    cubes[0, 1, ..., 0] = ramp.view(size, 1, 1)
    assert matches(texture_edge_hashes(cubes, light), faces).view(4, 3)[0, 2]


def test_one_color_per_face(device):
    """A single face of another colour differs at its three edges, seen from both sides."""
    _, faces = sphere(device)
    light = torch.ones(1, 2, len(faces), 3, device=device)
    cubes = torch.full((1, len(faces), 1, 1, 1, 3), 0.4, device=device)
    assert matches(texture_edge_hashes(cubes, light), faces).all()
    cubes[0, 7, ..., 2] = 0.5
    found = matches(texture_edge_hashes(cubes, light), faces).view(-1, 3)
    assert (~found).sum() == 6 and not found[7].any()


def test_images_match_where_texture_coordinates_are_continuous(device):
    vertices, faces = sphere(device)
    corners = vertices[faces.long()]
    uv = corners[..., :2].contiguous()
    one = torch.zeros(len(faces), dtype=torch.int64, device=device)
    assert matches(image_edge_hashes(uv, one, None), faces).all()
    assert not matches(image_edge_hashes(torch.rand_like(uv), one, None), faces).any()
    assert not matches(image_edge_hashes(uv, one - 1, None), faces).any()  # no image
    assert matches(image_edge_hashes(uv, one - 1, None, corners), faces).all()  # colours of the corners instead
    assert not matches(image_edge_hashes(uv, one - 1, None, torch.rand_like(corners)), faces).any()
    other = matches(image_edge_hashes(uv, one + (corners[:, :, 0].mean(1) > 0), None), faces)
    assert 0 < (~other).sum() < 100  # along the line between two images
    light = torch.rand(2, 2, len(faces), 3, device=device)
    assert not matches(image_edge_hashes(uv, one, light), faces).any()


def test_kept_hashes_follow_changes_in_place(device):
    uv, image = torch.rand(4, 3, 2, device=device), torch.zeros(4, dtype=torch.int64, device=device)
    changes = [lambda: None, lambda: uv.mul_(0.5), lambda: image[2:].fill_(1)]
    if device == "cpu":
        changes.append(lambda: uv.numpy().fill(0.25))
    for change in changes:
        change()
        assert torch.equal(image_edge_hashes(uv, image, None), image_edge_hashes(uv.clone(), image.clone(), None))


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("size", [0, 3, 4])
def test_colors_are_compared_as_their_hashes(device, size):
    """The gradient with the texels themselves is that with their hashes, equal to the bit."""
    vertices, triangles = sphere(device)
    faces, random = vertices[triangles.long()][None], torch.Generator().manual_seed(3)
    texels = Texels.shared(triangles, max(size, 3))
    cubes = texels.cubes(torch.rand(texels.count, 3, generator=random).to(device).round(decimals=2))[None]
    if size == 0:
        cubes = vertices[triangles.long()][None].clone()
    cubes[:, 5:30] = torch.rand(cubes[:, 5:30].shape, generator=random).to(device)
    light = torch.ones(1, 2, len(triangles), 3, device=device)
    light[..., 60:90, :] = torch.rand(30, 3, generator=random).to(device)
    settings = Settings.checked(48, 0.1, 100.0, 1e-3, False, False, True, "edge")
    index = settings.face_index(faces)
    image, grad = (torch.rand(1, 3, 48, 48, generator=random).to(device) for _ in range(2))
    hashed, compared = (
        edge_gradient_backward(grad, image, faces, index, EdgeOptions(False, True, True), *options)
        for options in ((texture_edge_hashes(cubes, light),), (None, None, cubes, light))
    )
    assert hashed.any() and torch.equal(hashed, compared)


def test_render_finds_no_seams_in_a_continuous_texture(device):
    """Its gradient equals the gradient of `composite` with ``seams=False``."""
    vertices, faces = sphere(device)
    uv = vertices[faces.long()][..., :2] * 0.4 + 0.5
    image = torch.rand(32, 32, 3, generator=torch.Generator().manual_seed(0)).to(device)
    index, colors = (
        torch.zeros(len(faces), dtype=torch.int64, device=device),
        torch.zeros(len(faces), 3, 3, device=device),
    )
    camera = nr.Camera.look_at((0.1, 0.2, 0.2), at=(0.0, 0.0, 3.0), viewing_angle=28)
    found = []
    for known in (True, False):
        moving = vertices.clone().requires_grad_()
        mesh = nr.UVMesh(moving, faces, uv, index, (image,), colors, ("repeat",))
        if known:
            fragments = nr.fragments(mesh, camera, 32)
            rgb = fragments.composite(mesh.shade(fragments), seams=False)
        else:
            rgb = nr.render(mesh, camera, 32, light=None, gradient="edge").rgb
        rgb.square().sum().backward()
        found.append((rgb, moving.grad))
    assert torch.equal(found[0][0], found[1][0])
    # A vertex sums the gradients of some hundred pixels, in another order.
    torch.testing.assert_close(found[0][1], found[1][1], **rounding(64**2, float(found[0][1].abs().max())))
