"""Packed pixels: images of one row hold what shows the mesh, and go back to its place."""

from __future__ import annotations

import torch

import neural_renderer as nr
from neural_renderer.shading.pixels.shown import ShownPixels


def _face_index(counts: list[int], pixels: int = 1024) -> torch.Tensor:
    random = torch.Generator().manual_seed(0)
    rows = [torch.randperm(pixels, generator=random).argsort() < count for count in counts]
    return torch.stack(rows).view(len(counts), 32, -1).int() - 1


def test_pixels_return_to_their_place_with_one_gradient_each() -> None:
    face_index = _face_index([0, 1, 63, 64, 65, 700])
    shown = ShownPixels(face_index)
    values = torch.randn(*face_index.shape, 3).requires_grad_()
    packed = shown.pack(values)
    assert packed.shape == (6, 1, 704, 3)
    whole = shown.spread(packed)
    mask = (face_index >= 0)[..., None]
    assert torch.equal(torch.where(mask, whole, 0), torch.where(mask, values, 0))
    # The background's pixels stand for the places that are left; `composite` ignores them.
    (grad,) = torch.autograd.grad(torch.where(mask, whole, 0).sum(), values)
    assert torch.equal(grad, mask.expand_as(values).float())


def test_full_images_stay_as_they_are() -> None:
    for counts in ([1024, 3], [900, 3]):
        assert ShownPixels(_face_index(counts)).index is None


def test_images_equal_those_of_a_model_that_sees_all_pixels() -> None:
    class Whole:
        def shade(self, surface, albedo, lights):
            assert surface.points.shape[1:3] == (128, 128)
            return nr.PBR(0.3, 0.4).shade(surface, albedo, lights)

    mesh = nr.Mesh.icosphere(2)
    mesh.vertices.requires_grad_()
    camera = nr.Camera.look_at(((0.4, 0.6, -2.7), (2.0, -0.5, -5.0)))
    lights = [nr.Light(0.3, 0.4), nr.PointLight((1.0, 2.0, -2.0), 3.0)]
    results = []
    for model in (nr.PBR(0.3, 0.4), Whole()):
        rgb = nr.render(mesh, camera, 64, light=lights, shading=model).rgb
        results.append((rgb, *torch.autograd.grad(rgb.square().sum(), mesh.vertices)))
    for packed, whole in zip(*results, strict=True):
        # Sums of gradients over pixels run in the same order; numbers may differ where vectors are not whole.
        torch.testing.assert_close(packed, whole, rtol=1e-5, atol=1e-5 * whole.abs().max().item())
