"""`view_sheet`: orthographic views of a mesh from the front, right, top, back and a corner, with its dimensions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from torch.nn import functional

from ...camera import Camera
from ...io.formats import read_mesh
from ...io.images import pictures_reduced
from ...meshes.uv_mesh import UVMesh
from ...rendering.forward import render
from ..common.geometry.edges import areas
from ..common.pictures.outputs import GREY, averaged
from ..common.pictures.sheet import captioned, sheet

# Name, direction towards the camera, up, and the axes of the world across and up the picture.
_VIEWS = (
    ("front", (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0, 1)),
    ("right", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (2, 1)),
    ("top", (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0, 2)),
    ("back", (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (0, 1)),
    ("isometric", (1.0, 1.0, 1.0), (0.0, 1.0, 0.0), None),
)
_SIDE, _DIAGONAL = 1.3, 1.9  # most screen units of the longest side and of the diagonal; a picture has 2
_FINEST = 8  # texels for a pixel of the picture along each axis; finer images are averaged while they are read
_FINER = 2.0  # texels that a pixel of a sheet keeps along each axis
_SCARCE = 0.02  # share of the area whose texels may be larger
_GAP = 1 / 24  # between the mesh and its measures, relative to the picture
_INK = (70, 76, 88)


@torch.no_grad()
def view_sheet(mesh: Any, size: int, lines: list[str], **look: Any) -> Tensor:
    """Draw the five views of a mesh at one scale, in a row, and lines of text below.

    Args:
        mesh: `Mesh` or `UVMesh`, in its own units, y up and z towards the front.
        size: Side of each picture in pixels.
        lines: The text, without the sizes.
        **look: Arguments of `render`.

    Returns:
        [height, 5 size, 3] uint8 on the CPU.

    Raises:
        ValueError: All vertices coincide.
    """
    vertices = mesh.vertices.detach()
    low, high = vertices.amin(0).double().cpu(), vertices.amax(0).double().cpu()
    center, extent = (low + high) / 2, high - low
    diagonal = float(extent.norm())
    if not diagonal > 0:
        raise ValueError(f"vertices: expected vertices that differ, got {len(vertices)} that all coincide")
    scale = min(_SIDE / float(extent.max()), _DIAGONAL / diagonal)
    towards = torch.nn.functional.normalize(torch.tensor([view[1] for view in _VIEWS], dtype=torch.float64), dim=1)
    camera = Camera.look_at(
        (center + diagonal * towards).to(vertices),
        center.to(vertices),
        torch.tensor([view[2] for view in _VIEWS]).to(vertices),
        orthographic=True,
        scale=scale,
    )
    images = render(mesh, camera, size, outputs="rgb", **look).rgb.clamp(0, 1).cpu()
    pixels = sheet([list(images)])
    image = Image.fromarray(pixels.numpy())
    for column, (name, _, _, axes) in enumerate(_VIEWS):
        _measure(ImageDraw.Draw(image), column * size, size, name, axes, extent.tolist(), scale)
    sizes = " x ".join(f"{side:.4g}" for side in extent.tolist())
    drawn = torch.frombuffer(bytearray(image.tobytes()), dtype=torch.uint8).view(pixels.shape)
    return captioned(drawn, [f"size  {sizes} (x, y, z)", *lines])


def load_for_sheet(path: Path, size: int, allow_outside: bool) -> UVMesh:
    """Read a mesh; average the texels of images that are much smaller than the pixels of a sheet of this size.

    To fill the gutters of a large image, and to make its mipmaps, takes more time than all the rest.
    """
    with pictures_reduced(_FINEST * size):
        vertices, faces, surface, _ = read_mesh(path, allow_outside, materials=True)
    if surface is not None and surface.images:
        area = areas(torch.from_numpy(vertices[faces]).double())
        pixel = 2 * float(np.ptp(vertices, axis=0).max()) / (_SIDE * size)
        for number, image in enumerate(surface.images):
            shown = surface.image == number
            texels = torch.from_numpy(surface.uv[shown] * image.shape[1::-1]).double()
            density = _low_density(areas(functional.pad(texels, (0, 1))).numpy(), area[torch.from_numpy(shown)].numpy())
            fits = (n for n in (8, 4, 2) if pixel * density >= _FINER * n and not any(s % n for s in image.shape[:2]))
            surface.images[number] = averaged(torch.from_numpy(image), next(fits, 1)).numpy()
    return UVMesh._of_surface(vertices, faces, surface, GREY)


def _low_density(texels: np.ndarray, area: np.ndarray) -> float:
    """Compute the texels along a unit of length, where they are scarce: all but a small share of the area has more."""
    density = np.sqrt(texels / area.clip(1e-30))
    order = np.argsort(density)
    covered = np.cumsum(area[order])
    return float(density[order][np.searchsorted(covered, _SCARCE * covered[-1])]) if len(order) else 0.0


def _measure(
    draw: ImageDraw.ImageDraw,
    left: int,
    size: int,
    name: str,
    axes: tuple[int, int] | None,
    extent: list[float],
    scale: float,
) -> None:
    """Write the name of a view, and draw the dimensions along two axes next to the mesh."""
    small = max(size // 22, 10)
    font = ImageFont.load_default(small)
    draw.text((left + size / 32, size / 32), name, _INK, ImageFont.load_default(max(size // 16, 10)))
    if axes is None:
        return
    middle, gap, tick = size / 2, size * _GAP, size / 80
    half = [extent[axis] * scale * size / 4 for axis in axes]
    row = middle + half[1] + gap
    draw.line((left + middle - half[0], row, left + middle + half[0], row), _INK)
    for end in (-half[0], half[0]):
        draw.line((left + middle + end, row - tick, left + middle + end, row + tick), _INK)
    draw.text((left + middle, row + tick), f"{'xyz'[axes[0]]} {extent[axes[0]]:.4g}", _INK, font, anchor="ma")
    column = left + middle - half[0] - gap
    draw.line((column, middle - half[1], column, middle + half[1]), _INK)
    for end in (-half[1], half[1]):
        draw.line((column - tick, middle + end, column + tick, middle + end), _INK)
    text = f"{'xyz'[axes[1]]} {extent[axes[1]]:.4g}"
    if draw.textlength(text, font) < column - left - 2 * tick:
        draw.text((column - tick, middle), text, _INK, font, anchor="rm")
    else:  # above the line
        draw.text((column - tick, middle - half[1] - tick), text, _INK, font, anchor="lb")
