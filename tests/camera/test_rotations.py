"""Rotations: to matrices and back, in float64, with gradients."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

import neural_renderer as nr

r = nr.rotations


def random(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.00999, 0.01001, 1.0, 3.0, 3.1415, torch.pi])
def test_axis_and_angle_are_the_exponential(angle: float) -> None:
    axis = torch.nn.functional.normalize(random(2, 5, 3), dim=-1)
    vectors = angle * axis
    matrices = r.from_axis_angle(vectors)
    zero = torch.zeros(2, 5, dtype=torch.float64)
    x, y, z = vectors.unbind(-1)
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    torch.testing.assert_close(matrices, torch.matrix_exp(cross), atol=1e-14, rtol=0)
    back = r.to_axis_angle(matrices)
    if angle == torch.pi:  # either sign
        back = back * torch.sign((back * axis).sum(-1, keepdim=True))
    # The cosine of half an angle near π is a difference of numbers of size 1.
    torch.testing.assert_close(back, vectors, atol=1e-13, rtol=0)


def test_all_forms_agree_and_come_back() -> None:
    quaternions = torch.nn.functional.normalize(random(3, 7, 4), dim=-1)
    quaternions = torch.cat((quaternions, torch.eye(4, dtype=torch.float64).expand(3, 4, 4)), 1)  # half turns, too
    matrices = r.from_quaternion(3 * quaternions)
    eye = torch.eye(3, dtype=torch.float64).expand_as(matrices)
    torch.testing.assert_close(matrices @ matrices.transpose(-1, -2), eye)
    assert (torch.linalg.det(matrices) > 0).all()
    found = r.to_quaternion(matrices)
    assert (found[..., 0] >= 0).all()
    torch.testing.assert_close((found * quaternions).sum(-1).abs(), torch.ones(3, 11, dtype=torch.float64))
    for there, back in ((r.from_axis_angle, r.to_axis_angle), (r.from_6d, r.to_6d)):
        torch.testing.assert_close(there(back(matrices)), matrices)
    assert torch.equal(r.to_6d(matrices), torch.cat((matrices[..., 0], matrices[..., 1]), -1))
    # (w, x, y, z): a turn by φ around x is (cos φ/2, sin φ/2, 0, 0).
    half = torch.tensor(0.3, dtype=torch.float64)
    turn = r.from_quaternion(torch.stack((half.cos(), half.sin(), 0 * half, 0 * half)))
    torch.testing.assert_close(turn, r.from_axis_angle(torch.tensor([0.6, 0.0, 0.0], dtype=torch.float64)))
    torch.testing.assert_close(turn[:, 1], torch.stack((0 * half, (2 * half).cos(), (2 * half).sin())))


def test_gradients_also_without_a_turn() -> None:
    for scale in (0.0, 1e-3, 1.0):
        assert gradcheck(r.from_axis_angle, (scale * random(4, 3)).requires_grad_())
        there_and_back = (scale * random(4, 3)).requires_grad_()
        assert gradcheck(lambda v: r.to_axis_angle(r.from_axis_angle(v)), there_and_back)
    assert gradcheck(r.from_quaternion, random(4, 4).requires_grad_())
    assert gradcheck(r.from_6d, random(4, 6).requires_grad_())
    assert gradcheck(lambda q: r.to_quaternion(r.from_quaternion(q)), random(4, 4).requires_grad_())


def test_lists_halves_and_mistakes() -> None:
    assert torch.equal(r.from_axis_angle([0.0, 0.0, 0.0]), torch.eye(3))
    assert r.from_6d(torch.randn(2, 6).half()).dtype == torch.float32
    assert r.from_quaternion(torch.zeros(0, 4)).shape == (0, 3, 3)
    with pytest.raises(ValueError, match=r"quaternions: expected shape \[4\], got \[3\]"):
        r.from_quaternion(torch.zeros(3))
    with pytest.raises(ValueError, match="matrices: expected finite numbers"):
        r.to_axis_angle(torch.full((3, 3), torch.nan))
