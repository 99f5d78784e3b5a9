"""Scan lines in memory, against slices of the image. `test_nmr` tests the sums along them."""

from __future__ import annotations

import pytest
import torch
import warp as wp

from neural_renderer.raster.visibility.scanlines import WIDE, copy_lines, copy_pixels, empty_lines
from neural_renderer.raster.warp.launch import array, launch, no_array
from neural_renderer.raster.warp.layout import concurrent, pixel_tasks
from neural_renderer.raster.warp.queue import queue_arrays

HEIGHT, WIDTH = 5, 37  # columns come in groups of WIDE, of which the last is not full


def stored(
    image: torch.Tensor, grad: torch.Tensor, planes: int, index: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    batch, device = len(image), image.device
    rows = empty_lines(batch, HEIGHT, WIDTH, planes, device)
    columns = empty_lines(batch, WIDTH, HEIGHT, planes, device)
    spans = torch.zeros((batch, HEIGHT + WIDTH, 2), dtype=torch.int32, device=device)
    index = torch.empty((batch, HEIGHT, WIDTH), dtype=torch.int32, device=device) if index is None else index
    maps = [array(image), array(grad), array(index), array(rows), array(columns), array(spans, wp.vec2i)]
    if concurrent(device):
        tasks, each = pixel_tasks(batch * HEIGHT, WIDTH, device)
        no_queue = [no_array(4, device), no_array(3, device), no_array(2, device), *queue_arrays(None, device), 8, 4]
        launch(copy_pixels, tasks, [*maps, *no_queue, each], device)
    else:
        tasks = batch * (-(-HEIGHT // WIDE) - (-WIDTH // WIDE))
        launch(copy_lines, tasks, [*maps, WIDE], device)
        assert not rows[..., :WIDE].any() and not columns[..., :WIDE].any()
    return rows, columns, spans


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
    assert torch.equal(rows[..., WIDE:], planes.transpose(1, 2))
    assert torch.equal(columns[..., WIDE:], planes.permute(0, 3, 1, 2))
    pulls = (grad != 0).any(1).flip(1).cpu()
    for b in range(2):
        assert spans[b].tolist() == expected_spans(pulls[b]) + expected_spans(pulls[b].T)


def test_silhouettes(device: str) -> None:
    """The one plane holds what changing a pixel gains: covering it counts above 0, uncovering it below."""
    image, grad = scene(device, 1)
    rows, columns, spans = stored(image, grad, 1, image[:, 0].int() - 1)
    gain = (-grad).clamp(min=0) * (1 - image) + (-grad).clamp(max=0) * image
    assert torch.equal(rows[..., WIDE:], gain.flip(2).transpose(1, 2))
    assert torch.equal(columns[..., WIDE:], gain.flip(2).permute(0, 3, 1, 2))
    pulls = (gain > 0)[:, 0].flip(1).cpu()
    for b in range(2):
        assert spans[b].tolist() == expected_spans(pulls[b]) + expected_spans(pulls[b].T)
