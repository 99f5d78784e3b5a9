"""Scan lines in memory, against slices of the image. `test_nmr` tests the sums along them."""

from __future__ import annotations

import pytest
import torch

from neural_renderer.raster.ops.visible_faces import scene_of
from neural_renderer.raster.visibility.nmr import PADDING, empty_lines, store_lines
from neural_renderer.raster.warp.layout import concurrent

HEIGHT, WIDTH = 5, 37  # columns come in groups of PADDING, of which the last is not full


def stored(
    image: torch.Tensor, grad: torch.Tensor, planes: int, index: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    batch, device = len(image), image.device
    lines = empty_lines(batch, HEIGHT, WIDTH, planes, device)
    index = torch.full((batch, HEIGHT, WIDTH), -1, dtype=torch.int32, device=device) if index is None else index
    scene = scene_of(torch.zeros((batch, 1, 3, 3), device=device), index)
    call, _ = store_lines(scene, image if planes > 1 else None, grad, lines)
    if not concurrent(device):
        assert not lines.rows[..., :PADDING].any() and not lines.columns[..., :PADDING].any()
    spans = next(each for each in call.kept.values() if getattr(each, "dtype", None) == torch.int32)
    return lines.rows, lines.columns, spans.view(batch, HEIGHT + WIDTH, 2)


def expected_spans(pulls: torch.Tensor) -> list[list[int]]:
    """Count pixels from the first True of each line [L, length] to its end, and from its start to the last True."""
    found = [line.nonzero().flatten().tolist() for line in pulls]
    return [[pulls.shape[1] - line[0], line[-1] + 1] if line else [0, 0] for line in found]


def scene(device: str, channels: int) -> tuple[torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(0)
    image = (torch.rand(2, channels, HEIGHT, WIDTH, generator=random) < 0.5).float()
    grad = torch.randint(-2, 3, (2, channels, HEIGHT, WIDTH), generator=random).float()  # sums are exact
    grad[:, :, 1] = 0  # a row without gradient
    return image.to(device), grad.to(device)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_colors(device: str, channels: int) -> None:
    """Plane 0 holds the sum of value times gradient, the others the gradients; lines count from the bottom left."""
    image, grad = scene(device, channels)
    rows, columns, spans = stored(image, grad, 1 + channels)
    planes = torch.cat(((image * grad).sum(1, keepdim=True), grad), 1).flip(2)
    assert torch.equal(rows[..., PADDING:], planes.transpose(1, 2))
    assert torch.equal(columns[..., PADDING:], planes.permute(0, 3, 1, 2))
    pulls = (grad != 0).any(1).flip(1).cpu()
    for b in range(2):
        assert spans[b].tolist() == expected_spans(pulls[b]) + expected_spans(pulls[b].T)


def test_silhouettes(device: str) -> None:
    """The one plane holds what changing a pixel gains: covering it counts above 0, uncovering it below."""
    image, grad = scene(device, 1)
    rows, columns, spans = stored(image, grad, 1, image[:, 0].int() - 1)
    gain = (-grad).clamp(min=0) * (1 - image) + (-grad).clamp(max=0) * image
    assert torch.equal(rows[..., PADDING:], gain.flip(2).transpose(1, 2))
    assert torch.equal(columns[..., PADDING:], gain.flip(2).permute(0, 3, 1, 2))
    pulls = (gain > 0)[:, 0].flip(1).cpu()
    for b in range(2):
        assert spans[b].tolist() == expected_spans(pulls[b]) + expected_spans(pulls[b].T)
