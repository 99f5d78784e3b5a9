"""Soft silhouettes against their formula, and their derivatives."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from tests.raster.scenes import Scene


def silhouettes_reference(faces, height, width, sigma):
    """Every face at every pixel, without a list of pairs."""
    x = (2 * torch.arange(width, dtype=torch.float64) + 1 - width) / width
    y = ((2 * torch.arange(height, dtype=torch.float64) + 1 - height) / height).flip(0)
    point = torch.stack(torch.broadcast_tensors(x[None], y[:, None]), -1)[None, None]  # [1, 1, H, W, 2]
    ends = [(faces[:, :, k, None, None, :2], faces[:, :, (k + 1) % 3, None, None, :2]) for k in range(3)]
    squares, sides = [], []
    for p, q in ends:
        share = (((point - p) * (q - p)).sum(-1) / (q - p).square().sum(-1)).clamp(0, 1)[..., None]
        squares.append((point - p - share * (q - p)).square().sum(-1))
        sides.append((q - p)[..., 0] * (point - p)[..., 1] - (q - p)[..., 1] * (point - p)[..., 0])
    square = torch.stack(squares).amin(0)
    side = torch.stack(sides)
    inside = (side > 0).all(0) | (side < 0).all(0)
    chance = torch.sigmoid(torch.where(inside, square, -square) / sigma)
    return 1 - torch.where(chance > 1e-4, 1 - chance, 1.0).prod(1)


@pytest.mark.parametrize("sigma", [1e-5, 1e-3, 0.1])
def test_random_faces(device, sigma):
    for seed in range(3):
        faces = Scene(seed, 2, 9, 13, 10, True, True, ("plain", "tiny", "outside")).faces.double().to(device)
        found = nr.soft_silhouettes(faces, (13, 10), sigma=sigma)
        torch.testing.assert_close(found.cpu(), silhouettes_reference(faces.cpu(), 13, 10, sigma), rtol=0, atol=1e-12)


def test_a_small_sigma_gives_the_exact_silhouette(device):
    """At centres that are ten roots of sigma away from all edges."""
    faces = Scene(4, 1, 5, 20, 27, True, True, ("plain",)).faces.to(device)
    exact = nr.rasterize_images(faces, (20, 27), outputs="alpha", anti_aliasing=False, two_sided=True, near=0).alpha
    found = nr.soft_silhouettes(faces, (20, 27), sigma=1e-10)
    sharp = (found < 1e-6) | (found > 1 - 1e-6)
    assert sharp.float().mean() > 0.99
    torch.testing.assert_close(found[sharp], exact[sharp], rtol=0, atol=1e-6)


def test_first_and_second_derivatives(device):
    faces = Scene(0, 1, 2, 6, 5, True, True, ("plain",)).faces.double().to(device).requires_grad_()

    def draw(faces):
        return nr.soft_silhouettes(faces, (6, 5), sigma=0.02)

    assert torch.autograd.gradcheck(draw, faces, fast_mode=True)
    assert torch.autograd.gradgradcheck(draw, faces, fast_mode=True)


def test_what_is_not_drawn(device):
    """Faces with a corner behind the camera, and no faces at all."""
    face = torch.tensor([[[[-0.5, -0.5, 1.0], [0.5, -0.5, 1], [0, 0.5, -1]]]], device=device, requires_grad=True)
    image = nr.soft_silhouettes(face, 8)
    image.sum().backward()
    assert not image.any() and not face.grad.any()
    assert not nr.soft_silhouettes(face[:, :0], 8).any()
    assert nr.soft_silhouettes(face[:0], 8).shape == (0, 8, 8)


def test_points_and_lines_have_finite_gradients(device):
    """Faces whose corners are equal or on a line."""
    point = torch.tensor([[0.1, 0.2, 1.0]]).expand(3, 3)
    line = torch.tensor([[-0.5, -0.5, 1.0], [0, 0, 1], [0.5, 0.5, 1]])
    faces = torch.stack((point, line))[None].to(device).requires_grad_()
    nr.soft_silhouettes(faces, 16, sigma=1e-2).sum().backward()
    assert faces.grad.isfinite().all()


def test_bad_arguments():
    faces = torch.zeros(1, 2, 3, 3)
    with pytest.raises(ValueError, match="sigma: expected"):
        nr.soft_silhouettes(faces, 8, sigma=0.0)
    with pytest.raises(ValueError, match="faces: expected"):
        nr.soft_silhouettes(faces[0], 8)
