"""Cameras whose images are moved by parts of pixels."""

import pytest
import torch

import neural_renderer as nr

EYE = torch.tensor([[0.4, 0.5, -2.7], [1.0, 0.2, 2.0]])
K = torch.tensor([[60.0, 1.0, 22.0], [0.0, 58.0, 17.0], [0.0, 0.0, 1.0]])
CAMERAS = {
    "viewing angle": nr.Camera.look_at(EYE, viewing_angle=torch.tensor([20.0, 30.0])),
    "mirrored": nr.Camera.look_at(EYE, mirrored=True),
    "orthographic": nr.Camera.look_at(EYE, orthographic=True, scale=torch.tensor([0.8, 1.2])),
    "K": nr.Camera.projection(K, torch.eye(3), torch.tensor([[0.1, 0.2, 3.0]]), orig_size=(36, 48)),
    "fisheye": nr.Camera.fisheye(K, torch.eye(3), torch.tensor([[0.1, 0.2, 3.0]]), [0.1, 0, 0, 0], orig_size=(36, 48)),
}


@pytest.mark.parametrize("kind", CAMERAS)
@pytest.mark.parametrize("size", [(36, 48), (72, 96)])
def test_pixels_move_by_the_shift(kind, size):
    camera, shift = CAMERAS[kind], torch.tensor([0.375, -1.25])
    points = torch.rand(20, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    before, depth = camera.project(points, size)
    after, same = camera.shifted(shift, size).project(points, size)
    torch.testing.assert_close(after, before + shift, rtol=0, atol=1e-4)
    torch.testing.assert_close(same, depth)
    if camera.perspective:
        assert camera.with_K(size).orig_size == size
        torch.testing.assert_close(camera.with_K(size).project(points)[0], before, rtol=0, atol=1e-4)


def test_wrong_shifts_are_refused():
    with pytest.raises(ValueError, match="shift: expected"):
        CAMERAS["K"].shifted((1.0, 2.0, 3.0))
    with pytest.raises(ValueError, match="size: expected the side"):
        CAMERAS["viewing angle"].shifted((1.0, 2.0))
    with pytest.raises(ValueError, match="camera: expected perspective, got an orthographic lens"):
        CAMERAS["orthographic"].with_K(64)
