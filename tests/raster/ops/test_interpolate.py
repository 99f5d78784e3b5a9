"""Attributes at every pixel, and their gradients, against the same in plain torch."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from neural_renderer.raster.ops.barycentrics import barycentrics
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.ops.interpolate import interpolate
from tests.raster.scenes import FAR, NEAR, examples, scenes
from tests.rounding import rounding


@examples(30)
@given(scene=scenes(empty=False), channels=st.integers(1, 9), shared=st.booleans())
def test_random_scenes(device, scene, channels, shared):
    faces = scene.faces.to(device)
    index = coverage(faces, scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective)
    weights = barycentrics(faces, index, NEAR, FAR, scene.perspective)[0].requires_grad_()
    attributes = scene.noise(1 if shared else scene.batch, scene.count, 3, channels).to(device).requires_grad_()
    found = interpolate(attributes, faces, index, weights)
    image = torch.arange(scene.batch, device=device)[:, None, None]
    own = attributes.double().expand(scene.batch, -1, -1, -1)[image, index.clamp(min=0).long()]
    expected = (own * weights.double()[..., None]).sum(-2) * (index >= 0)[..., None]
    # Three products of normal numbers, which hardly exceed 5.
    torch.testing.assert_close(found.double(), expected, **rounding(8, 5))
    grad = scene.noise(*found.shape).to(device)
    ours = torch.autograd.grad(found, (attributes, weights), grad)
    theirs = torch.autograd.grad(expected, (attributes, weights), grad.double())
    for a, b in zip(ours, theirs, strict=True):
        # Each is a sum over at most all pixels, or over nine channels, of products of such numbers; that of terms of
        # both signs is far within the bound, so that its tenth is held to.
        terms = max(scene.height * scene.width, 9)
        torch.testing.assert_close(a, b, **rounding(terms // 10 + 8, 5 * 5))


def test_operator_is_well_formed(device):
    faces = (torch.rand(2, 7, 3, 3) * torch.tensor([2.0, 2, 3]) + torch.tensor([-1.0, -1, 1])).to(device)
    index = coverage(faces, 10, 12, NEAR, FAR, True, True)
    weights = barycentrics(faces, index, NEAR, FAR, True)[0].requires_grad_()
    attributes = torch.randn(2, 7, 3, 4, device=device, requires_grad=True)
    torch.library.opcheck(interpolate.operator, (attributes, faces, index, weights))
