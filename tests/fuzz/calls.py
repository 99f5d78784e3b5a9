"""Random calls of the interface of nvdiffrast, as JSON: sizes, kinds of numbers, and what is done with the results."""

from __future__ import annotations

import json
import random
from typing import Any

import torch
from torch import Tensor

import neural_renderer.nvdiffrast as dr

NUMBERS = ("rand", "rand", "randn", "clip", "zero", "one", "nan", "inf", "huge", "tiny", "mixed")
DTYPES = ("float32",) * 12 + ("float64", "float16", "int32", "int64")
INDICES = ("good",) * 8 + ("same", "negative", "large", "last")
STEPS = ("interpolate", "texture", "antialias", "peel", "mipmaps")


def draw(rng: random.Random) -> bytes:
    """A call as JSON."""
    side = lambda: rng.choice((1, 2, 3, 5, 8, 17))  # noqa: E731
    call = {
        "seed": rng.randrange(1 << 30),
        "batch": rng.choice((0, 1, 1, 2, 3)),
        "vertices": rng.choice((0, 1, 3, 4, 9)),
        "faces": rng.choice((0, 1, 2, 7)),
        "size": [side(), side()],
        "channels": rng.choice((0, 1, 3, 7)),
        "ranged": rng.random() < 0.2,
        "numbers": {name: rng.choice(NUMBERS) for name in ("pos", "attr", "tex", "uv", "color")},
        "dtypes": {name: rng.choice(DTYPES) for name in ("pos", "attr", "tex", "uv", "color")},
        "indices": rng.choice(INDICES),
        "index_dtype": rng.choice(("int32",) * 8 + ("int64", "float32", "uint8")),
        "wrong": rng.choice(("",) * 12 + ("pos", "tri", "size", "attr", "tex", "color")),
        "filter": rng.choice(("auto", "nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear", "cubic")),
        "boundary": rng.choice(("wrap", "clamp", "zero", "cube", "mirror")),
        "steps": rng.sample(STEPS, rng.randint(0, 3)),
        "strided": rng.random() < 0.2,
    }
    return json.dumps(call, sort_keys=True).encode()


def numbers(kind: str, shape: list[int], dtype: str, generator: torch.Generator) -> Tensor:
    """A tensor of some kind of numbers."""
    value = torch.rand(shape, generator=generator)
    if kind == "randn":
        value = torch.randn(shape, generator=generator)
    elif kind == "clip":
        value = value * 4 - 2
    elif kind in ("zero", "one"):
        value = torch.full(shape, float(kind == "one"))
    elif kind in ("nan", "inf", "mixed") and value.numel():
        value.view(-1)[:: 1 if kind == "nan" else 3] = float("nan" if kind == "nan" else "inf")
        if kind == "mixed":
            value.view(-1)[::2] = -0.0
    elif kind in ("huge", "tiny"):
        value = (value - 0.5) * (1e38 if kind == "huge" else 1e-40)
    return value.to(getattr(torch, dtype))


def run(data: bytes) -> None:
    """Do a call twice: it works, equally both times, or raises TypeError or ValueError; its arguments stay."""
    call = json.loads(data)
    first, second = _done(call), _done(call)
    assert first == second, "another result"


def _done(call: dict[str, Any]) -> Any:
    generator = torch.Generator().manual_seed(call["seed"])
    batch, points, faces, (height, width) = call["batch"], call["vertices"], call["faces"], call["size"]

    def made(name: str, *shape: int) -> Tensor:
        shape = (*shape[:-1], shape[-1] + 1) if call["wrong"] == name else shape
        value = numbers(call["numbers"][name], list(shape), call["dtypes"][name], generator)
        if call["strided"] and value.dim() > 1:
            value = value.transpose(0, 1).contiguous().transpose(0, 1)
        return value.requires_grad_() if value.is_floating_point() else value

    pos = made("pos", points, 4) if call["ranged"] else made("pos", batch, points, 4)
    high = {"good": max(points, 1), "same": 1, "negative": max(points, 1), "large": points + 9, "last": points + 1}
    tri = torch.randint(0, high[call["indices"]], (faces, 4 if call["wrong"] == "tri" else 3), generator=generator)
    tri = (tri - (call["indices"] == "negative") * 3).to(getattr(torch, call["index_dtype"]))
    ranges = torch.tensor([[0, faces], [faces // 2, faces - faces // 2]], dtype=torch.int32) if call["ranged"] else None
    attr, color = made("attr", 1, points, call["channels"]), made("color", batch, height, width, call["channels"])
    cube = call["boundary"] == "cube"
    tex = made("tex", 1, *((6, 4, 4) if cube else (4, 8)), call["channels"])
    uv = made("uv", batch, height, width, 3 if cube else 2)
    arguments = [pos, tri, attr, color, tex, uv]
    before = [value.detach().clone() for value in arguments]
    found: list[Tensor] = []
    try:
        _steps(call, found, (height, width), ranges, *arguments)
        total = sum(value.sum() for value in found if value.requires_grad)
        if isinstance(total, Tensor):
            total.backward()
            found += [value.grad for value in arguments if value.grad is not None]
    except (TypeError, ValueError) as error:
        assert len(str(error)) < 1000 and ":" in str(error), error
        return str(error)
    finally:
        for one, other in zip(arguments, before, strict=True):
            assert torch.equal(one.detach().nan_to_num(7.0), other.nan_to_num(7.0)), "an argument has changed"
    return [value.detach().numpy().tobytes() for value in found]


def _steps(
    call: dict[str, Any],
    found: list[Tensor],
    size: tuple[int, int],
    ranges: Tensor | None,
    *arguments: Tensor,
) -> None:
    pos, tri, attr, color, tex, uv = arguments
    context = dr.RasterizeCudaContext()
    rast, change = dr.rasterize(context, pos, tri, (size[0], 0) if call["wrong"] == "size" else size, ranges)
    found += [rast, change]
    for step in call["steps"]:
        if step == "interpolate":
            found += dr.interpolate(attr, rast, tri, change, "all")
        elif step == "texture":
            found.append(
                dr.texture(tex, uv, filter_mode=call["filter"].partition("-")[0], boundary_mode=call["boundary"])
            )
        elif step == "mipmaps":
            around = torch.rand(*uv.shape[:3], 2 * uv.shape[3], generator=torch.Generator().manual_seed(call["seed"]))
            found.append(dr.texture(tex, uv, around, filter_mode=call["filter"], boundary_mode=call["boundary"]))
        elif step == "antialias":
            found.append(dr.antialias(color, rast, pos, tri))
        else:
            with dr.DepthPeeler(context, pos, tri, size, ranges) as peeler:
                for _ in range(2):
                    found += peeler.rasterize_next_layer()
