"""The private names of torch and Warp: all there, and the same results without each."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.raster.warp import kernel_cache, launch, private

VERTICES, FACES = nr.icosphere(1)
CAMERA = nr.Camera.look_at((0.2, 0.4, -2.7))
TEXTURES = torch.rand(len(FACES), 2, 2, 2, 3, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("name", private.NAMES)
def test_the_name_is_there(name: str) -> None:
    assert private.find(name) is not None, f"{name}: missing; a slower way replaces it (see {private.__file__})"


def test_a_name_that_is_not_there() -> None:
    assert private.find("torch:_C._no_such_name") is None and private.find("torch._no_such_module:name") is None


@pytest.fixture
def hidden(request: pytest.FixtureRequest) -> Iterator[None]:
    """The package finds its private names again, without the one that is the parameter."""
    module, name = request.param.split(":")
    *path, last = name.split(".")
    owner = importlib.import_module(module)
    for part in path:
        owner = getattr(owner, part)
    with pytest.MonkeyPatch.context() as patch:  # a short one: torch needs its own names
        if last == "AutogradFunctionality":
            patch.setattr(private.torch._C, "DispatchKey", object())
        else:
            patch.delattr(owner, last)
        importlib.reload(private)
        ways = dict(vars(private))
    yield
    assert vars(private) == ways
    importlib.reload(private)


def loss(vertices: Tensor, outputs: tuple[str, ...] = ("rgb", "alpha", "depth")) -> Tensor:
    images = nr.render((vertices, FACES, TEXTURES), CAMERA, 24, outputs=outputs, gradient="edge")
    return sum((image * torch.linspace(-1, 1, 24)).sum() for image in images if image is not None)


def in_all_modes() -> list[Tensor]:
    """Values and derivatives of images: eager, by `torch.func`, in forward mode, in batches, in inference mode."""
    along = torch.stack([VERTICES.roll(1, 1), VERTICES.flip(0)])
    leaf = VERTICES.clone().requires_grad_()
    value = loss(leaf)
    found = [value.detach(), *torch.autograd.grad(value, leaf), torch.func.grad(loss)(VERTICES)]
    found += torch.func.vjp(loss, VERTICES)[1](torch.tensor(1.0))  # after its transformation has ended
    found += torch.func.jvp(loss, (VERTICES,), (along[0],))
    found.append(torch.func.vmap(lambda v: torch.func.jvp(loss, (VERTICES,), (v,))[1])(along))
    found.append(torch.func.vmap(loss)(torch.stack([VERTICES, 0.9 * VERTICES])))
    with torch.autograd.forward_ad.dual_level():
        dual = torch.autograd.forward_ad.make_dual(VERTICES, along[0])
        found.append(torch.autograd.forward_ad.unpack_dual(loss(dual, ("rgb",))).tangent)
    with torch.inference_mode():
        found.append(loss(VERTICES))
    return [each.detach() for each in found]


@pytest.mark.parametrize("hidden", private.NAMES, indirect=True)
def test_the_same_without_it(hidden: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to rounding: without some, the gradient of an image is that of pixels, not of blocks of them."""
    monkeypatch.setattr(launch, "_entries", {})
    kernel = next(iter(launch._ready))[0] if launch._ready else None
    found = in_all_modes()
    if kernel is not None:
        kernel_cache.load_module(kernel, "cpu")
    for own, other in zip(found, EXPECTED, strict=True):
        torch.testing.assert_close(own, other, rtol=0, atol=1e-5 * float(other.abs().max()))


EXPECTED = in_all_modes()
