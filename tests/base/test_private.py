"""The private names of torch and Warp: in one file, all there, and the same results without each."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.run.cuda_on_cpu import cuda_on_cpu
from neural_renderer.base import private
from neural_renderer.raster.warp import kernel_cache, launch

SOURCE = Path(nr.__file__).parent

VERTICES, FACES = nr.icosphere(1)
CAMERA = nr.Camera.look_at((0.2, 0.4, -2.7))
TEXTURES = torch.rand(len(FACES), 2, 2, 2, 3, generator=torch.Generator().manual_seed(0))


def private_names(code: str) -> list[str]:
    """List the private names of torch and Warp in a file: imported, of an imported one, of a tensor, in a string."""
    if not re.search(r"(?<!\bself)\._(?!_)|import .*\b_(?!_)|(?:torch|warp)[\w.]*:_|getattr\(", code):
        return []
    nodes, found, known = list(ast.walk(ast.parse(code))), [], set()
    for node in nodes:
        if isinstance(node, ast.Import):
            paths = [(name.asname or name.name.partition(".")[0], name.name) for name in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            paths = [(name.asname or name.name, f"{node.module}.{name.name}") for name in node.names]
        else:
            continue
        paths = [(name, path) for name, path in paths if path.partition(".")[0] in ("torch", "warp")]
        known |= {name for name, _ in paths}
        found += [path for _, path in paths if re.search(r"\._(?!_)", path)]
    of_tensors = {name for name in dir(Tensor) if re.match("_(?!_)", name)}
    for node in nodes:
        if isinstance(node, ast.Attribute) and re.match("_(?!_)", node.attr):
            owner: Any = node.value
            while isinstance(owner, ast.Attribute):
                owner = owner.value
            name = owner.id if isinstance(owner, ast.Name) else ""
            if name in known or (node.attr in of_tensors and name not in ("self", "cls")):
                found.append(ast.unparse(node))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "getattr":
            owner, name = ast.unparse(node.args[0]).partition(".")[0], getattr(node.args[1], "value", "")
            found += [ast.unparse(node)] if owner in known and re.match("_(?!_)", str(name)) else []
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += re.findall(r"\b(?:torch|warp)[\w.:]*[.:]_(?!_)[\w.]+", node.value)
    return found


def test_private_names_stand_in_one_file() -> None:
    own = Path(private.__file__)
    found = {path: private_names(path.read_text("utf-8")) for path in SOURCE.rglob("*.py") if path != own}
    assert not {path: names for path, names in found.items() if names}
    said = private_names(own.read_text("utf-8"))
    assert len(said) > len(private.NAMES)
    for code in (
        "import torch._dynamo",
        "from torch.utils._device import DeviceContext",
        "from torch.overrides import _get_mode",
        "import torch\ntorch._C.f()",
        "import warp as wp\nwp.context._src",
        "def f(tensor): return tensor.x._version",
        "find('torch:_C.f')",
        "import torch\ngetattr(torch.cpu, '_f', None)",
    ):
        assert private_names(code), code


@pytest.mark.parametrize("name", private.NAMES)
def test_the_name_is_there(name: str) -> None:
    if name == private.STREAM and torch.version.cuda is None:
        pytest.skip("this torch is built without CUDA")
    assert private.find(name) is not None, f"{name}: missing; a slower way replaces it (see {private.__file__})"


def test_a_name_that_is_not_there() -> None:
    assert private.find("torch:_C._no_such_name") is None and private.find("torch._no_such_module:name") is None


@pytest.fixture
def hidden(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The package finds its private names again, without the one that is the parameter."""
    module, name = request.param.split(":")
    *path, last = name.split(".")
    owner = importlib.import_module(module)
    for part in path:
        owner = getattr(owner, part)
    with pytest.MonkeyPatch.context() as patch:  # a short one: torch needs its own names
        if owner is Tensor:
            patch.setattr(Tensor, last, None)  # the name is of a class in C++ above it
        elif last == "AutogradFunctionality":
            patch.setattr(private.torch._C, "DispatchKey", object())
        else:
            patch.delattr(owner, last, raising=request.param != private.STREAM)
        importlib.reload(private)
    find = private.find
    monkeypatch.setattr(private, "find", lambda path: None if path == request.param else find(path))
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
    with pytest.raises(ValueError, match=r"^vertices: expected finite numbers"):
        loss(VERTICES * torch.nan)
    with torch.device("meta"):
        assert private.default_device() == torch.device("meta")
    assert private.default_device() is None
    image = torch.rand(2, 4, 4, 3)
    assert private.base_of(image[0]) is not None and private.base_of(image) is image
    with cuda_on_cpu(always=True):
        assert torch.ones(1, device="cuda", requires_grad=True).sum().backward() is None


def test_the_stream_of_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    module, path = private.STREAM.split(":")
    owner, name = importlib.import_module(f"{module}.{path.partition('.')[0]}"), path.partition(".")[2]
    monkeypatch.setattr(owner, name, lambda index: 7 + index, raising=False)
    monkeypatch.setattr(torch.cuda, "current_stream", lambda index: SimpleNamespace(cuda_stream=index))
    assert private.cuda_stream()(1) == 8
    monkeypatch.delattr(owner, name)
    assert private.cuda_stream()(1) == 1


EXPECTED = in_all_modes()
