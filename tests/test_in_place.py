"""Images may be changed in place before `backward`, as programs do to cut out, mask and composite them."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import neural_renderer as nr

pytestmark = pytest.mark.usefixtures("deterministic")

NAMES = ("rgb", "alpha", "depth")
OUTPUTS = [names for count in (1, 2, 3) for names in itertools.combinations(NAMES, count)]
FAR = 100.0


def leaves(device: str, batch: int) -> tuple[Tensor, Tensor, Tensor]:
    vertices, faces = nr.icosphere(1, 0.7)
    textures = torch.rand(batch, len(faces), 2, 2, 2, 3, generator=torch.Generator().manual_seed(0))
    leaf = vertices.expand(batch, -1, -1).to(device, copy=True).requires_grad_()
    return leaf, faces.to(device), textures.to(device).requires_grad_()


def check(draw: Callable[[tuple[Tensor, ...]], dict[str, Tensor]], inputs: tuple[Tensor, ...]) -> None:
    """Masked in place and by new tensors, the losses and the gradients are the same to the bit."""
    vertices, _, textures = inputs
    found = []
    for in_place in (True, False):
        images = draw(inputs)
        loss = torch.zeros((), device=vertices.device)
        for name, image in images.items():
            mask = torch.rand(image.shape, generator=torch.Generator().manual_seed(1)).to(image.device)
            if name == "depth":
                if in_place:
                    image[image == FAR] = 0
                    image[..., :3] = 0
                else:
                    left = torch.arange(image.shape[-1], device=image.device) < 3
                    image = torch.where((image == FAR) | left, 0.0, image)
            elif name == "alpha":
                image = image.mul_(mask) if in_place else image * mask
            elif in_place:
                image *= mask
                image += 0.25
            else:
                image = image * mask + 0.25
            loss = loss + (image * mask).square().sum()
        wanted = [leaf for leaf in (vertices, textures) if leaf is vertices or "rgb" in images]
        found.append((loss.detach(), *torch.autograd.grad(loss, wanted, allow_unused=True)))
    for changed, kept in zip(*found, strict=True):
        assert (changed is None) == (kept is None)
        assert changed is None or torch.equal(changed, kept)


@pytest.mark.parametrize("batch", [1, 2])
@pytest.mark.parametrize("anti_aliasing", [False, True])
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
@pytest.mark.parametrize("outputs", OUTPUTS, ids="+".join)
def test_render(device, outputs, gradient, anti_aliasing, batch):
    camera = nr.Camera.look_at((0.3, 0.8, -2.2))
    options = {"outputs": outputs, "gradient": gradient, "anti_aliasing": anti_aliasing, "far": FAR}

    def draw(inputs):
        return vars(nr.render(inputs, camera, 16, **options))

    check(draw, leaves(device, batch))


@pytest.mark.parametrize("anti_aliasing", [False, True])
@pytest.mark.parametrize("mode", [None, "rgb", "silhouettes", "depth"])
def test_renderer(device, mode, anti_aliasing):
    renderer = nr.Renderer(16, anti_aliasing=anti_aliasing, camera_mode="look_at")

    def draw(inputs):
        images = renderer(*inputs[:2], *inputs[2:] * (mode in (None, "rgb")), mode=mode)
        names = {None: ("rgb", "depth", "alpha"), "rgb": ("rgb",), "silhouettes": ("alpha",), "depth": ("depth",)}[mode]
        return dict(zip(names, images if mode is None else [images], strict=True))

    check(draw, leaves(device, 1))


@pytest.mark.parametrize("anti_aliasing", [False, True])
@pytest.mark.parametrize("gradient", ["nmr", "edge"])
@pytest.mark.parametrize("batch", [1, 2])
def test_composite(device, gradient, anti_aliasing, batch):
    camera = nr.Camera.look_at((0.3, 0.8, -2.2))

    def draw(inputs):
        vertices, faces, textures = inputs
        fragments = nr.fragments((vertices, faces), camera, 16, gradient=gradient, anti_aliasing=anti_aliasing)
        colors = textures.mean((2, 3, 4))[:, faces.new_ones(vertices.shape[1]).cumsum(0) % len(faces)]
        return {"rgb": fragments.composite(fragments.interpolate(colors), 0.5)}

    check(draw, leaves(device, batch))


def test_changing_one_image_leaves_the_others(device):
    vertices, faces, textures = leaves(device, 1)
    for options in itertools.product(("nmr", "edge"), (False, True)):
        images = [
            *nr.render(
                (vertices, faces, textures),
                nr.Camera.look_at((0, 0, -2.0)),
                8,
                gradient=options[0],
                anti_aliasing=options[1],
            )
        ]
        before = [image.clone() for image in images]
        for k, image in enumerate(images):
            image.zero_()
            assert all(torch.equal(other, was) for other, was in zip(images[k + 1 :], before[k + 1 :], strict=True))
