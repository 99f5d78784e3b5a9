"""`neural-renderer info`: versions, devices, extras, the kernel cache, and a self-check of rendering."""

from __future__ import annotations

import platform
import time
from pathlib import Path

import numpy as np
import torch
import warp as wp
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ...base.extras import EXTRAS, advice, missing
from ...meshes.primitives import icosphere
from ...raster import rasterize_images, vertices_to_faces
from ...version import __version__
from .options import InfoOptions

# Two test cases of the first package. Each has the corners (x, y) of a triangle, a pixel (row, column) of its 64 × 64
# silhouette, the target of the loss |I − target| at this pixel, and the gradient of the loss in the corners.
_CASES = (
    ([[0.8, 0.8], [0.0, -0.5], [0.2, -0.4]], (25, 35), 1.0,
     [[1.6725862, -0.26021874], [1.41986704, -1.64284933], [0.0, 0.0]]),
    ([[0.8, 0.8], [-0.5, -0.8], [0.8, -0.8]], (40, 50), 0.0,
     [[0.98646867, 1.04628897], [-1.03415668, -0.10403691], [3.00094461, -1.55173182]]),
)  # fmt: skip
_MOMENTS = (205.0, 2437.0, 2410.0)  # pixels of a sphere, and the sums of their columns and of their rows
_SUMS = (1671.3331, -28.3181, 1671.3331, 708.2685)  # x and y of the gradients of its corners, and of their absolutes


def run(_: InfoOptions) -> int:
    """Print a table of versions, devices and checks; return 0 if all checks passed, else 1."""
    devices = ["cpu", *(f"cuda:{i}" for i in range(torch.cuda.device_count()))]
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("neural-renderer", __version__)
    table.add_row("python", f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    table.add_row("torch", str(torch.__version__))
    table.add_row("warp", wp.__version__)
    table.add_row("numpy", np.__version__)
    table.add_row("CPU threads", str(torch.get_num_threads()))
    for device in devices[1:] or ["none"]:
        table.add_row("CUDA device", device if device == "none" else f"{device} {torch.cuda.get_device_name(device)}")
    for extra, libraries in EXTRAS.items():
        table.add_row(f"extra {extra}", _availability(extra, libraries))
    passed = True
    for device in devices:
        start = time.perf_counter()
        problems = self_check(torch.device(device))
        passed = passed and not problems
        seconds = f" ({time.perf_counter() - start:.1f} s)"
        table.add_row(
            f"check on {device}", "[red]" + "; ".join(problems) if problems else f"[green]ok[/green]{seconds}"
        )
    table.add_row("kernel cache", _cache())  # Warp chooses the folder at its first kernel
    Console().print(table, highlight=False, soft_wrap=True)
    return 0 if passed else 1


def self_check(device: torch.device) -> list[str]:
    """Check an image, a silhouette and gradients on a device; return descriptions of the failures."""
    try:
        return [*_check_image(device), *_check_sphere(device), *_check_gradient(device)]
    except Exception as error:  # reported in the table
        return [f"{type(error).__name__}: {error}"]


def _check_image(device: torch.device) -> list[str]:
    """Check colours and depth of a red square in front of a blue one; both end at borders of pixels."""

    def square(left: float, right: float, z: float) -> list[list[list[float]]]:
        a, b, c, d = [left, -0.5, z], [right, -0.5, z], [right, 0.5, z], [left, 0.5, z]
        return [[a, b, c], [a, c, d]]

    faces = torch.tensor([square(-0.5, 0.25, 2.0) + square(-0.25, 0.5, 3.0)], device=device)
    textures = torch.zeros(1, 4, 2, 2, 2, 3, device=device)
    textures[:, :2, ..., 0] = textures[:, 2:, ..., 2] = 1
    images = rasterize_images(faces, 16, textures=textures, anti_aliasing=False)
    rgb = torch.zeros(1, 3, 16, 16)
    rgb[:, 0, 4:12, 4:10] = rgb[:, 2, 4:12, 10:12] = 1
    depth = torch.full((1, 16, 16), 100.0)
    depth[:, 4:12, 4:10], depth[:, 4:12, 10:12] = 2, 3
    expected = {"rgb": rgb, "alpha": rgb.sum(1), "depth": depth}
    return [problem for name in expected for problem in _compare(name, getattr(images, name), expected[name], 1e-4)]


def _check_sphere(device: torch.device) -> list[str]:
    """Check sums over a sphere's silhouette and its gradient against those of the kernels' float64 reference."""
    vertices, index = icosphere(1, 0.7)
    screen = (vertices + torch.tensor([0.03, -0.02, 2.0]))[None].to(device)
    faces = vertices_to_faces(screen, index.to(device)).requires_grad_()
    images = rasterize_images(faces, 24, outputs="alpha", anti_aliasing=False, gradient="nmr", eps=1e-3)
    weight = torch.linspace(-1, 1, 24, device=device).expand(1, 24, 24)
    (found,) = torch.autograd.grad((images.alpha * weight).sum(), faces)
    place = torch.arange(24.0, device=device)
    moments = torch.stack([(images.alpha * one).sum() for one in (torch.ones_like(place), place, place[:, None])])
    sums = torch.cat([part.sum((0, 1, 2))[:2] for part in (found, found.abs())])
    return _compare("sphere", moments, torch.tensor(_MOMENTS), 0) + _compare(
        "sphere's gradient", sums, torch.tensor(_SUMS), 1e-3
    )


def _check_gradient(device: torch.device) -> list[str]:
    """Check the published gradients of two triangles."""
    problems: list[str] = []
    for number, (corners, (row, column), target, gradient) in enumerate(_CASES, 1):
        screen = torch.tensor(corners, device=device).requires_grad_()
        faces = torch.cat((screen, torch.ones(3, 1, device=device)), dim=1)[None, None]
        images = rasterize_images(
            faces, 64, outputs="alpha", anti_aliasing=False, two_sided=True, perspective=False, gradient="nmr"
        )
        loss = (images.alpha[0, row, column] - target).abs()
        (found,) = torch.autograd.grad(loss, screen)
        problems += _compare(f"gradient {number}", found, torch.tensor(gradient), 1e-2)
    return problems


def _compare(name: str, found: torch.Tensor, expected: torch.Tensor, tolerance: float) -> list[str]:
    """Describe the largest difference of numbers that differ by more than a relative tolerance."""
    found = found.detach().cpu()
    # A small sum of large terms has the absolute error of its terms.
    if torch.allclose(found, expected, rtol=tolerance, atol=1e-5 * max(1.0, expected.abs().max().item())):
        return []
    worst = (found - expected).abs().max().item()
    return [f"{name}: expected agreement within {tolerance:g}, got a difference of {worst:.3g}"]


def _availability(extra: str, libraries: tuple[str, ...]) -> str:
    """Say which libraries of an extra are installed, and how to install the others."""
    absent = missing(extra)
    if not absent:
        return f"[green]installed[/green]: {', '.join(libraries)}"
    command = escape(advice(absent[0]))
    return f"[yellow]missing[/yellow]: {', '.join(absent)} ({command})"


def _cache() -> str:
    folder = Path(wp.config.kernel_cache_dir or "")
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) if folder.is_dir() else 0
    return f"{folder} ({size / 2**20:.1f} MiB)"
