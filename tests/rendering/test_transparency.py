"""Opacity of materials, and `render` with layers."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

import neural_renderer as nr

CAMERA = nr.Camera.look_at((0.0, 0.0, -3.0), viewing_angle=20)
WHITE = torch.ones(1, 1, 3)


def panes(*materials: nr.Material, colors: tuple[float, ...] = (0.2, 0.9)) -> nr.UVMesh:
    """Squares one behind the other, each of one shade of grey and with one material."""
    count = len(materials)
    square = torch.tensor([[-0.6, -0.6, 0.0], [0.6, -0.6, 0.0], [0.6, 0.6, 0.0], [-0.6, 0.6, 0.0]])
    vertices = torch.cat([square * (1 + 0.2 * n) + torch.tensor([0.0, 0.0, 0.5 * n]) for n in range(count)])
    faces = torch.cat([torch.tensor([[0, 2, 1], [0, 3, 2]]) + 4 * n for n in range(count)])
    uv = (square[:, :2] / 1.2 + 0.5)[torch.tensor([[0, 2, 1], [0, 3, 2]])].repeat(count, 1, 1)
    index = torch.arange(count).repeat_interleave(2)
    shades = torch.tensor(colors)[index][:, None, None].expand(-1, 3, 3)
    none = torch.full((2 * count,), -1)
    return nr.UVMesh(vertices, faces, uv, none, (), shades, (), materials=materials, material_index=index)


def center(images: nr.Images) -> float:
    return float(images.rgb[0, 0, 16, 16])


def test_modes() -> None:
    """The middle of two panes over a background of 0.5."""
    glass = nr.Material(opacity=0.25, alpha_mode="BLEND")
    behind = 0.25 * 0.9 + 0.75 * 0.5
    cases = [
        (glass, glass, 0.25 * 0.2 + 0.75 * behind),
        (replace(glass, alpha_mode="OPAQUE"), glass, 0.2),
        (replace(glass, alpha_mode="MASK"), glass, behind),
        (replace(glass, alpha_mode="MASK", alpha_cutoff=0.25), glass, 0.2),
        (glass, nr.Material(), 0.25 * 0.2 + 0.75 * 0.9),
    ]
    for front, back, expected in cases:
        images = nr.render(panes(front, back), CAMERA, 32, light=None, background=0.5, layers=2)
        assert center(images) == pytest.approx(expected, abs=1e-6)
    alone = nr.render(panes(glass, glass), CAMERA, 32, light=None, background=0.5, layers=2)
    assert float(alone.alpha[0, 16, 16]) == pytest.approx(1 - 0.75**2)
    assert float(alone.depth[0, 16, 16]) == pytest.approx(3.0)


def test_the_alpha_of_an_image_is_a_factor() -> None:
    left = torch.zeros(8, 8, 1)
    left[:, :4] = 1
    leaf = nr.Material(opacity_texture=nr.Texture(left), alpha_mode="MASK")
    image = nr.render(panes(leaf, colors=(1.0,)), CAMERA, 32, light=None, layers=1).rgb[0, 0, 16]
    # Mirrored in the picture or not, one half of the pane is there.
    assert sorted({round(float(value), 3) for value in image[[12, 19]]}) == [0.0, 1.0]


@pytest.mark.parametrize("turned", [False, True])
def test_single_sided_faces_have_no_back(turned) -> None:
    """As with ``two_sided=False``, the side of counter-clockwise corners is visible."""
    mesh = panes(nr.Material(double_sided=False), colors=(1.0,))
    mesh = replace(mesh, faces=mesh.faces.flip(1)) if turned else mesh
    layered = nr.render(mesh, CAMERA, 16, light=None, layers=1).rgb
    expected = nr.render(mesh, CAMERA, 16, light=None, two_sided=False).rgb
    assert torch.equal(layered, expected)


@pytest.mark.parametrize("shading", ["flat", "smooth", "pbr"])
def test_opaque_layers_are_the_usual_picture(shading) -> None:
    """Values and gradients: nothing shines through, and seams are found in the same way."""
    vertices, faces = nr.icosphere(1)
    uv = 0.5 + 0.5 * vertices[:, :2]
    results = []
    for layers in (None, 2):
        points = vertices.clone().requires_grad_()
        mesh = nr.UVMesh(points, faces, uv, torch.rand(8, 8, 3, generator=torch.Generator().manual_seed(0)))
        mesh = replace(mesh, materials=(nr.Material(roughness=0.5),))
        images = nr.render(mesh, CAMERA, 24, shading=shading, layers=layers)
        weight = torch.rand(3, 24, 24, generator=torch.Generator().manual_seed(1))
        (images.rgb * weight).sum().backward()
        results.append((images.rgb.detach(), images.alpha.detach(), points.grad))
    # The blend computes c + 0 · (background), and gradients are sums of some hundred terms.
    for got, expected in zip(results[1], results[0], strict=True):
        torch.testing.assert_close(got, expected, rtol=1e-4, atol=1e-5 * float(expected.abs().max()))


def test_opacity_and_place_are_recovered() -> None:
    """A pane's opacity and the place of the pane behind it, from a picture."""
    opacity = torch.tensor(0.8, requires_grad=True)
    shift = torch.tensor([0.25, -0.15], requires_grad=True)

    def draw(alpha, moved):
        mesh = panes(nr.Material(opacity=alpha, alpha_mode="BLEND"), nr.Material(), colors=(0.2, 0.9))
        vertices = mesh.vertices.clone()
        vertices[:4] = 2 * vertices[:4]
        vertices[4:, :2] = 0.4 * vertices[4:, :2] + moved
        return nr.render(replace(mesh, vertices=vertices), CAMERA, 32, light=None, layers=2).rgb

    target = draw(torch.tensor(0.4), torch.zeros(2)).detach()
    optimizer = torch.optim.Adam([opacity, shift], lr=0.03)
    for _ in range(60):
        optimizer.zero_grad()
        (draw(opacity, shift) - target).square().mean().backward()
        optimizer.step()
    assert abs(float(opacity) - 0.4) < 0.02 and float(shift.norm()) < 0.04


def test_what_does_not_fit() -> None:
    with pytest.raises(TypeError, match="mesh: expected a UVMesh to draw layers, got Mesh"):
        nr.render(nr.Mesh.icosphere(0), CAMERA, 8, layers=2)
    with pytest.raises(ValueError, match="layers: expected"):
        nr.render(panes(nr.Material()), CAMERA, 8, layers=0)
    found = nr.fragments(panes(nr.Material()), CAMERA, 8)
    with pytest.raises(TypeError, match="mesh: expected a UVMesh"):
        nr.surface_opacity(found, nr.Mesh.icosphere(0))
    with pytest.raises(ValueError, match="fragments: expected those of 4 faces, got 2"):
        nr.surface_opacity(found, panes(nr.Material(), nr.Material()))
