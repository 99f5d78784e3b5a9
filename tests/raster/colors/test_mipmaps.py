"""Mipmapped sampling, held to a reference in float64 torch, in value and in gradient."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.nn import functional

from neural_renderer.raster.colors.mipmaps import all_levels, cached_pyramid, level_sizes, pyramid, sample_mipmaps
from tests.raster.scenes import examples
from tests.rounding import rounding


def bilinear(image, uv, repeats):
    """image [C, h, w], uv [P, 2] → [P, C], texel by texel."""
    height, width = image.shape[1:]
    at = torch.stack((uv[:, 0], 1 - uv[:, 1]), -1)
    size = at.new_tensor([width, height])
    clamped = (at * size - 0.5).clamp(min=at.new_zeros(2), max=size - 1)
    at = torch.where(torch.tensor(repeats), (at - at.floor()) * size - 0.5, clamped)
    low = at.detach().floor()
    part = at - low
    result = 0
    for down in (0, 1):
        for right in (0, 1):
            x, y = low[:, 0].long() + right, low[:, 1].long() + down
            x = x % width if repeats[0] else x.clamp(0, width - 1)
            y = y % height if repeats[1] else y.clamp(0, height - 1)
            share = (part[:, 0] if right else 1 - part[:, 0]) * (part[:, 1] if down else 1 - part[:, 1])
            result = result + share[:, None] * image[:, y, x].T
    return result


def reference(texels, height, width, uv, face_index, levels, *repeats):
    """`sample_mipmaps` in float64, pixel by pixel for the level."""
    sizes = level_sizes(height, width)[:levels]
    batch, rows, columns = face_index.shape
    result = []
    for b in range(batch):
        own = texels[min(b, len(texels) - 1)]
        images = [own[s : s + h * w].T.reshape(-1, h, w) for s, h, w in sizes]
        for j in range(rows):
            for i in range(columns):
                f = int(face_index[b, j, i])
                if f < 0:
                    result.append(own.new_zeros(own.shape[1]))
                    continue
                longest = 0.0
                for down, right in ((0, 1), (1, 0)) if levels > 1 else ():
                    for y, x, sign in ((j + down, i + right, 1), (j - down, i - right, -1)):
                        if 0 <= y < rows and 0 <= x < columns and face_index[b, y, x] == f:
                            step = (uv[b, y, x] - uv[b, j, i]).detach() * sign
                            longest = max(longest, float((step * step.new_tensor([width, height])).norm()))
                            break
                level = min(max(0.0, torch.tensor(longest).clamp(min=1).log2().item()), len(sizes) - 1)
                color = 0
                for n, image in enumerate(images):
                    share = max(0.0, 1 - abs(level - n))
                    if share:
                        color = color + share * bilinear(image, uv[b, j, i][None], repeats)[0]
                result.append(color)
    return torch.stack(result).view(batch, rows, columns, -1)


@examples(20)
@given(
    seed=st.integers(0, 2**31),
    size=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    channels=st.integers(1, 4),
    shared=st.booleans(),
    most=st.integers(1, 4),
    repeats=st.tuples(st.booleans(), st.booleans()),
)
def test_reference(seed, size, channels, shared, most, repeats):
    generator, levels = torch.Generator().manual_seed(seed), min(most, all_levels(*size))
    image = torch.rand(1 if shared else 2, channels, *size, generator=generator)
    # Away from the centres of texels, where the slope of the blend jumps.
    uv = (
        0.2 * torch.rand(2, 5, 6, 1, 1, generator=generator)
        + torch.rand(2, 1, 1, 2, generator=generator)[:, :, :, None]
    )
    uv = (3 * uv - 1 + 0.1 * torch.rand(2, 5, 6, 1, 2, generator=generator))[..., 0, :]
    face_index = torch.randint(-1, 2, (2, 5, 6), generator=generator, dtype=torch.int32)
    weight = torch.rand(2, 5, 6, channels, generator=generator)
    results = []
    for dtype in (torch.float32, torch.float64):
        texels = pyramid(image.to(dtype), levels)
        texels, at = texels.detach().requires_grad_(), uv.detach().to(dtype).requires_grad_()
        sample = sample_mipmaps if dtype == torch.float32 else reference
        colors = sample(texels, *size, at, face_index, levels, *repeats)
        (colors * weight).sum().backward()
        results.append((colors.detach(), texels.grad, at.grad))
    # A place is a few roundings of 3 x 9 texels off, which the blend's slopes, up to 9 times the colours, multiply; the
    # level of detail, a logarithm, takes a share of as much.
    for got, expected in zip(*results, strict=True):
        torch.testing.assert_close(got.double(), expected, **rounding(9 * 3 * 9 * 8, float(expected.abs().max() + 1)))


@pytest.mark.parametrize("size", [(8, 8), (5, 9), (1, 7), (1, 1)])
def test_pyramid(size):
    image = torch.rand(2, 3, *size, generator=torch.Generator().manual_seed(0))
    texels, sizes = pyramid(image, all_levels(*size)), level_sizes(*size)
    assert sizes[-1][1:] == (1, 1) and texels.shape == (2, sizes[-1][0] + 1, 3)
    for before, height, width in sizes:
        level = texels[:, before : before + height * width].transpose(1, 2).reshape(2, 3, height, width)
        above = image if before == 0 else functional.adaptive_avg_pool2d(above, (height, width))  # noqa: F821
        torch.testing.assert_close(level, above)


@pytest.mark.parametrize("repeats", [(True, True), (False, True), (False, False)])
def test_coordinates_that_are_no_numbers_draw_nothing_out_of_bounds(repeats, device):
    """They draw colours of the texture, with weights whose sum is 1, as the gradient to texels shows."""
    texels = pyramid(torch.rand(1, 3, 8, 8), 4).to(device).requires_grad_()
    uv = torch.tensor([float("nan"), float("inf"), -float("inf"), 1e30], device=device)[None, None, :, None]
    uv = uv.expand(1, 4, 4, 2).contiguous().requires_grad_()
    face_index = torch.zeros(1, 4, 4, dtype=torch.int32, device=device)
    colors = sample_mipmaps(texels, 8, 8, uv, face_index, 4, *repeats)
    colors.sum().backward()
    assert (colors >= texels.min() - 1e-6).all() and (colors <= texels.max() + 1e-6).all()
    torch.testing.assert_close(texels.grad.sum((0, 1)), torch.full((3,), 16.0, device=device))
    assert (texels.grad >= 0).all() and uv.grad.isfinite().all()


def test_compiles():
    texels, face_index = pyramid(torch.rand(1, 3, 8, 8), 4), torch.zeros(1, 4, 4, dtype=torch.int32)
    uv = torch.rand(1, 4, 4, 2)
    torch.library.opcheck(
        torch.ops.neural_renderer.sample_mipmaps.default,
        (texels.requires_grad_(), 8, 8, uv.requires_grad_(), face_index, 4, True, True),
        test_utils=("test_schema", "test_faketensor"),
    )


def test_cached_mipmaps_are_never_stale():
    image = torch.rand(8, 6, 3)

    def check(image, levels=4):
        found = cached_pyramid(image[None], levels)
        assert torch.equal(found, pyramid(image[None].permute(0, 3, 1, 2), levels))
        return found

    assert check(image) is check(image)
    assert len(check(image, 2)[0]) == 8 * 6 + 4 * 3  # not those of four levels
    for change in (lambda: image.mul_(2), lambda: image[3].zero_(), lambda: image.data.add_(1)):
        change()  # torch does not count the last one
        assert check(image) is check(image)
    shared = image.numpy()
    shared[2, 2] = 7
    check(image)
    image[0, 0] = float("nan")
    assert cached_pyramid(image[None], 4)[0, 0].isnan().all()
    image[0, 0] = 0
    # Gradients flow, and what inference mode caches serves a graph.
    leaf = image.clone().requires_grad_()
    assert cached_pyramid(leaf[None], 4).requires_grad
    with torch.no_grad():
        assert not check(leaf).requires_grad
    with torch.inference_mode():
        assert not check(torch.rand(4, 4, 3)).is_inference()
        check(image)
    assert not check(image).is_inference()
    halves = torch.rand(2, 4, 4, 3)
    assert not torch.equal(check(halves[0]), check(halves[1]))


def test_cached_mipmaps_in_threads():
    images = [torch.full((16, 16, 3), float(n)) for n in range(4)]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda n: cached_pyramid(images[n % 4][None], 5), range(200)))
    assert all((texels == n % 4).all() for n, texels in enumerate(found))
