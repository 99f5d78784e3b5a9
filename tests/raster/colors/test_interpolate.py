"""Attributes at every pixel, and their gradients, against the same in plain torch."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from neural_renderer.raster.colors.interpolate import interpolate
from neural_renderer.raster.ops.barycentrics import barycentrics
from neural_renderer.raster.ops.coverage import coverage
from tests.raster.scenes import FAR, NEAR, examples, scenes
from tests.rounding import rounding


@examples(30)
@given(scene=scenes(empty=False), channels=st.integers(1, 9), shared=st.booleans())
def test_random_scenes(device, scene, channels, shared):
    faces = scene.faces.to(device).requires_grad_()
    index = coverage(faces.detach(), scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective)
    attributes = scene.noise(1 if shared else scene.batch, scene.count, 3, channels).to(device).requires_grad_()
    found = interpolate(attributes, faces, index, scene.perspective)
    weights = barycentrics(faces, index, NEAR, FAR, scene.perspective)[0]
    image = torch.arange(scene.batch, device=device)[:, None, None]
    own = attributes.double().expand(scene.batch, -1, -1, -1)[image, index.clamp(min=0).long()]
    expected = (own * weights.double()[..., None]).sum(-2) * (index >= 0)[..., None]
    # Three products of normal numbers, which hardly exceed 5.
    torch.testing.assert_close(found.double(), expected, **rounding(8, 5))
    grad = scene.noise(*found.shape).to(device)
    ours = torch.autograd.grad(found, (attributes, faces), grad)
    theirs = torch.autograd.grad(expected, (attributes, faces), grad.double())
    # A sum over at most all pixels of products of such numbers; that of terms of both signs is far within the bound, so
    # that its tenth is held to.
    terms = scene.height * scene.width
    torch.testing.assert_close(ours[0], theirs[0], **rounding(terms // 10 + 8, 5 * 5))
    # The weights' gradient is a sum over the channels, rounded once more on its way through an image.
    scale = theirs[1].nan_to_num().abs().amax(-1, keepdim=True)
    assert ((ours[1] - theirs[1]).nan_to_num().abs() <= 1e-4 * scale + 1e-4).all()


def test_operator_is_well_formed(device):
    faces = (torch.rand(2, 7, 3, 3) * torch.tensor([2.0, 2, 3]) + torch.tensor([-1.0, -1, 1])).to(device)
    index = coverage(faces, 10, 12, NEAR, FAR, True, True)
    attributes = torch.randn(2, 7, 3, 4, device=device, requires_grad=True)
    torch.library.opcheck(interpolate.operator, (attributes, faces.requires_grad_(), index, True))
