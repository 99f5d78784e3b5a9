"""Materials and textures: transforms, wrapping, gradients, and what a `UVMesh` does with them."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

import neural_renderer as nr


def square(**attributes) -> nr.UVMesh:
    """Two triangles over [0, 1]², with an image."""
    vertices = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    return nr.UVMesh(vertices, torch.tensor([[0, 1, 2], [0, 2, 3]]), vertices[:, :2], torch.rand(4, 4, 3), **attributes)


@pytest.mark.parametrize("wrap", ["repeat", "clamp", "mirror", ("repeat", "clamp"), ("mirror", "repeat")])
def test_wrapping_is_that_of_an_image_written_out(wrap) -> None:
    """Sampling [−1, 2]² equals sampling an image of 3 × 3 copies, which are shifted, mirrored or extended."""
    image = torch.rand(5, 7, 2, generator=torch.Generator().manual_seed(0))
    at = torch.rand(1, 20, 20, 2, generator=torch.Generator().manual_seed(1)) * 2 - 0.5
    wide = image
    for axis, mode in zip((1, 0), wrap if isinstance(wrap, tuple) else (wrap, wrap), strict=True):
        ends = {"repeat": (wide, wide), "mirror": (wide.flip(axis), wide.flip(axis))}.get(mode)
        if ends is None:
            first, last = (wide.narrow(axis, place, 1) for place in (0, wide.shape[axis] - 1))
            ends = first.expand_as(wide), last.expand_as(wide)
        wide = torch.cat((ends[0], wide, ends[1]), axis)
    expected = nr.sample_texture(wide, (at + 1) / 3, wrap="clamp")
    # Places are some roundings of 21 texels off, times differences of texels of at most 1.
    torch.testing.assert_close(nr.sample_texture(image, at, wrap=wrap), expected, rtol=0, atol=21 * 8 * 2**-23)


def test_the_transform_is_that_of_the_extension() -> None:
    """The extension's own example shows the lower left quarter, and its corners say how it is turned."""
    texture = nr.Texture(torch.zeros(1, 1, 1), offset=(0.0, 1.0), rotation=math.pi / 2, scale=(0.5, 0.5))
    corners = torch.tensor([[0.0, 1.0], [1.0, 1.0], [0.0, 0.0], [1.0, 0.0]])  # v up
    expected = torch.tensor([[0.0, 0.0], [0.0, 0.5], [0.5, 0.0], [0.5, 0.5]])
    torch.testing.assert_close(texture.transformed(corners), expected, rtol=0, atol=1e-6)


def test_gradients_reach_image_and_transform() -> None:
    """They are those of `sample_texture`, through the matrix of the extension."""
    parts: dict[str, Tensor] = {
        "offset": torch.tensor([0.1, 0.2]),
        "scale": torch.tensor([1.5, 0.7]),
        "rotation": torch.tensor(0.4),
    }
    image = torch.rand(4, 4, 3, requires_grad=True)
    texture = nr.Texture(image, **{name: value.requires_grad_() for name, value in parts.items()})
    uv = torch.rand(1, 6, 6, 2)
    texture.sample(uv).square().sum().backward()
    other = image.detach().clone().requires_grad_()
    offset, scale, rotation = (value.detach().clone().requires_grad_() for value in parts.values())
    down = torch.stack((uv[..., 0], 1 - uv[..., 1]), -1) * scale  # v of the extension grows down
    turn = torch.stack((rotation.cos(), rotation.sin(), -rotation.sin(), rotation.cos())).view(2, 2)
    moved = down @ turn.T + offset
    nr.sample_texture(other, torch.stack((moved[..., 0], 1 - moved[..., 1]), -1)).square().sum().backward()
    torch.testing.assert_close(image.grad, other.grad, rtol=0, atol=1e-4)
    for name, value in {"offset": offset, "scale": scale, "rotation": rotation}.items():
        torch.testing.assert_close(parts[name].grad, value.grad, rtol=1e-4, atol=1e-3)
        assert value.grad is not None and value.grad.abs().max() > 0.1


def test_factors_become_tensors_that_keep_gradients() -> None:
    opacity = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
    material = nr.Material(opacity=opacity, base_color=(1, 0.5, 0))
    assert material.base_color.dtype == material.opacity.dtype == torch.float32
    material.to("cpu").opacity.backward()
    assert opacity.grad == 1


@pytest.mark.parametrize(
    ("message", "attributes"),
    [
        ("base_color: expected shape", {"base_color": (1.0, 2.0)}),
        ("opacity: expected a number", {"opacity": "half"}),
        ("opacity: expected finite", {"opacity": float("nan")}),
        ("alpha_mode: expected one of OPAQUE, MASK, BLEND, got 'mask'", {"alpha_mode": "mask"}),
        ("emissive_texture: expected a Texture or None", {"emissive_texture": torch.zeros(4, 4, 3)}),
        ("emissive_texture: expected", {"emissive_texture": nr.Texture(torch.zeros(4, 4, 1))}),
        ("double_sided: expected", {"double_sided": 1.5}),
    ],
)
def test_what_does_not_fit_a_material(message, attributes) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        nr.Material(**attributes)


@pytest.mark.parametrize(
    ("message", "attributes"),
    [
        ("image: expected shape", {"image": torch.zeros(4, 4)}),
        ("image: expected at least one pixel", {"image": torch.zeros(0, 4, 3)}),
        ("wrap: expected one of", {"wrap": ("repeat", "border")}),
        ("offset: expected shape", {"offset": (0.0, 0.0, 0.0)}),
        ("uv_set: expected at least 0, got -1", {"uv_set": -1}),
    ],
)
def test_what_does_not_fit_a_texture(message, attributes) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        nr.Texture(**{"image": torch.zeros(4, 4, 3), **attributes})


@pytest.mark.parametrize(
    ("message", "attributes"),
    [
        ("normals: expected shape", {"normals": torch.zeros(4, 3)}),
        ("tangents: expected shape", {"tangents": torch.zeros(2, 3, 3)}),
        ("materials: expected a Material each", {"materials": (None,)}),
        ("material_index: expected one of 1 materials or -1, got 1", {"material_index": torch.tensor([0, 1])}),
        ("material_index: expected", {"materials": (nr.Material(), nr.Material())}),
    ],
)
def test_what_does_not_fit_a_mesh(message, attributes, tmp_path) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        square(**{"materials": (nr.Material(),), **attributes}).save(tmp_path / "mesh.obj")


def test_parts_of_a_mesh_keep_their_attributes() -> None:
    index, normals = torch.tensor([-1, 0]), torch.rand(2, 3, 3)
    mesh = square(materials=(nr.Material("a"),), material_index=index, normals=normals)
    part = mesh.submesh([1])
    assert part.materials[0].name == "a" and part.material_index.tolist() == [0]
    torch.testing.assert_close(part.normals, normals[1:])
    assert part.tangents is None and mesh.to("cpu").materials[0].name == "a"
