"""Colour from texture cubes, and its gradients, against the reference."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import neural_renderer as nr
from neural_renderer.raster.colors.texture_cubes import sample_textures
from neural_renderer.raster.ops.barycentrics import barycentrics
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.reference.operators import sample_textures_reference
from tests.raster.scenes import FAR, NEAR, examples, scenes
from tests.rounding import relative, rounding


def drawn(scene, device):
    faces = scene.faces.to(device)
    index = coverage(faces, scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective)
    return faces, index, *barycentrics(faces, index, NEAR, FAR, scene.perspective)


@examples(50)
@given(
    scene=scenes(empty=False),
    size=st.integers(0, 6),  # 0: colours of corners
    shared_textures=st.booleans(),
    shared_light=st.booleans(),
    eps=st.sampled_from([1e-3, 1e-4]),
)
def test_random_scenes(device, scene, size, shared_textures, shared_light, eps):
    faces, index, weights, _ = drawn(scene, device)
    shape = (size, size, size, 3) if size else (3, 3)
    textures = scene.noise(1 if shared_textures else scene.batch, scene.count, *shape)
    light = scene.noise(1 if shared_light else scene.batch, 2, scene.count, 3)
    # Which side of a face without area is seen, rounding decides: light both alike.
    a, b = (faces[:, :, k, :2].cpu() - faces[:, :, 0, :2].cpu() for k in (1, 2))
    thin = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).abs() < 1e-5
    light[:, 1] = torch.where(thin.any(0)[:, None], light[:, 0], light[:, 1])
    background = scene.noise(len(index), 3, *index.shape[1:])
    inputs = [t.to(device).requires_grad_() for t in (textures, light, background, faces)]
    color = sample_textures(*inputs, index, eps, scene.perspective)
    exact = [t.double().requires_grad_() for t in (textures, light, background, weights.cpu())]
    maps = (faces.detach().cpu(), index.cpu())
    reference = sample_textures_reference(*exact[:3], *maps, exact[3], eps, scene.perspective)
    # On a texel the blend has a kink, and rounding decides which side the weight is on.
    coordinate = weights.cpu().double() * (size - 1)
    kink = ((coordinate - coordinate.round()).abs() < 1e-5).any(-1) & (size > 1)
    to_color = scene.noise(*color.shape) * ~kink[:, None]
    found = torch.autograd.grad(color, inputs, to_color.to(device))
    expected = torch.autograd.grad(reference, exact, to_color.double())
    # From the weights to the faces as `barycentrics` has it.
    again = faces.detach().requires_grad_()
    shares = barycentrics(again, index, NEAR, FAR, scene.perspective)[0]
    to_faces = torch.autograd.grad(shares, again, expected[3].to(device).float())[0]
    expected = (*expected[:3], to_faces.cpu().double())
    # A cube coordinate is a few float32 roundings of a number below T off, and texels differ by some units.
    torch.testing.assert_close(color.cpu().double(), reference, rtol=1e-5, atol=2e-5)
    for ours, theirs in zip(found, expected, strict=True):
        error = (ours.cpu() - theirs).nan_to_num().norm()
        assert error <= 1e-5 * theirs.nan_to_num().norm() + 1e-6, float(error)
    assert torch.equal(found[2].cpu(), to_color * (index.cpu() < 0)[:, None])


@pytest.mark.parametrize("perspective", [True, False])
def test_textures_lie_flat_in_space(device, perspective):
    """Cubes with positions in space as colours return the position of the visible point at each pixel."""
    screen = torch.tensor([[[[-0.9, -0.8, 1.0], [0.9, -0.7, 4.0], [0.0, 0.9, 2.0]]]], device=device)
    divisor = screen[..., 2:] if perspective else 1
    world = torch.cat((screen[..., :2] * divisor, screen[..., 2:]), -1)
    shares = torch.stack(torch.meshgrid(*[torch.linspace(0, 1, 4, device=device)] * 3, indexing="ij"), -1)
    textures = (shares @ world[0, 0])[None, None]
    index = coverage(screen, 32, 32, NEAR, FAR, False, perspective)
    weights, depth = barycentrics(screen, index, NEAR, FAR, perspective)
    ones = torch.ones(1, 2, 1, 3, device=device)
    color = sample_textures(textures, ones, torch.zeros(1, 3, 32, 32, device=device), screen, index, 0.0, perspective)
    inside = (index >= 0) & (weights.amax(-1) < 0.9)
    # Weights of a face of 30 pixels, then a place among 4 texels, of depths up to 4.
    torch.testing.assert_close(color[:, 2][inside], depth[inside], **rounding(64, 4 * 4))


def test_each_side_has_its_light(device):
    front = torch.tensor([[-1.0, -1, 1], [1, -1, 1], [0, 1, 1]])
    faces = torch.stack((front, front.flip(0)))[:, None].to(device)
    index = coverage(faces, 4, 4, NEAR, FAR, True, True)
    light = torch.tensor([[[[1.0, 2, 3]], [[4.0, 5, 6]]]], device=device)
    textures = torch.ones(1, 1, 2, 2, 2, 3, device=device)
    black = torch.zeros(2, 3, 4, 4, device=device)
    color = sample_textures(textures, light, black, faces, index, 1e-3, True).cpu()
    assert torch.allclose(color[0, :, index.cpu()[0] >= 0].T, torch.tensor([1.0, 2, 3]), **relative(32))
    assert torch.allclose(color[1, :, index.cpu()[1] >= 0].T, torch.tensor([4.0, 5, 6]), **relative(32))


def test_colours_of_vertices_are_interpolated_attributes():
    """To the bit, with their gradients, without an opinion on what a seam is."""
    vertices, faces = nr.icosphere(2)
    leaves = [vertices.requires_grad_(), torch.rand(len(vertices), 3).requires_grad_()]
    camera = nr.Camera.look_at((0.3, 0.8, -2.2))
    fragments = nr.fragments((vertices, faces), camera, 48)
    corners = leaves[1][faces.long()][None]
    attributes = fragments.blend(fragments.interpolate(leaves[1]), 0.0, False, corner_values=corners)
    colors = nr.render(nr.Mesh(vertices, faces, vertex_colors=leaves[1]), camera, 48, light=None).rgb
    assert torch.equal(colors, attributes)
    to_image = torch.randn(colors.shape)
    for ours, theirs in zip(
        *(torch.autograd.grad(each, leaves, to_image) for each in (colors, attributes)), strict=True
    ):
        assert (ours - theirs).norm() < 1e-5 * theirs.norm()


def test_large_cubes_are_checked_again_after_a_change():
    mesh = nr.Mesh.icosphere(3).replace(textures=torch.rand(1280, 3, 3, 3, 3))
    camera = nr.Camera.look_at((0.0, 0.0, -3.0))
    for _ in range(2):
        nr.render(mesh, camera, 8, outputs=("rgb",))
    mesh.textures[700, 1, 1, 1, 1] = torch.nan
    with pytest.raises(ValueError, match="textures: expected finite numbers"):
        nr.render(mesh, camera, 8, outputs=("rgb",))
