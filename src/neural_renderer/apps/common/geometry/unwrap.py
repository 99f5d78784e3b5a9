"""`unwrap`: conversion of texture cubes to a texture image, with charts by the library xatlas."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ....base import validate
from ....io.files import import_library
from ....meshes.mesh import Mesh
from ....meshes.uv_mesh import UVMesh
from ....raster.rasterize import rasterize_images
from ....textures.gutters import pull_push

LEAST_SIZE, MOST_SIZE = 16, 8192
"""Pixels of a side of the image."""
_SAMPLES = 2  # samples of a texel along each axis


def unwrap(mesh: Mesh, size: int = 1024, *, gutter: int = 4, uv: Tensor | None = None) -> UVMesh:
    """Unwrap a mesh into charts, and bake its texture cubes into one image.

    The library xatlas makes the charts (extra "fit"; there is no wheel for Python 3.14). The gutters between
    them continue the colours of the charts, so that bilinear filters and mipmaps draw no seams.

    Args:
        mesh: The mesh, with texture cubes.
        size: Side of the square image in pixels, 16 to 8192.
        gutter: Least distance between charts in pixels, ≥ 1. Each doubling allows one more mipmap level without
            bleeding.
        uv: [F, 3, 2] in [0, 1], texture coordinates of the faces' corners, v up, of charts that do not overlap. None
            makes charts.

    Returns:
        A mesh with the same vertices and faces, texture coordinates, and one image; on the device of the mesh, without
        gradients.

    Raises:
        ModuleNotFoundError: xatlas is not installed, and ``uv`` is None.
        TypeError, ValueError: An argument does not fit, or the mesh has no faces.

    Example:
        >>> cube = nr.Mesh(*nr.cube(), face_colors=torch.rand(12, 3))
        >>> cells = torch.cartesian_prod(torch.arange(4), torch.arange(4))[:12, None] / 4
        >>> uv = cells + torch.tensor([[0.02, 0.02], [0.23, 0.02], [0.23, 0.23]])
        >>> unwrapped = nr.unwrap(cube, size=64, uv=uv)  # or without uv, with xatlas
        >>> unwrapped.save("cube.glb")
        >>> unwrapped.images[0].shape
        torch.Size([64, 64, 3])
    """
    if not isinstance(mesh, Mesh):
        raise TypeError(f"mesh: expected a Mesh, got {type(mesh).__name__}")
    size, gutter = validate.whole("size", size, LEAST_SIZE), validate.whole("gutter", gutter, 1)
    if size > MOST_SIZE:
        raise ValueError(f"size: expected at most {MOST_SIZE}, got {size}")
    if not len(mesh.faces):
        raise ValueError("mesh: expected at least one face, got none")
    vertices, faces = mesh.vertices.detach(), mesh.faces
    if uv is None:
        uv = chart_coordinates(vertices, faces, size, gutter)
    else:
        validate.finite("uv", validate.floating("uv", uv, (len(faces), 3, 2)))
        if bool(((uv < 0) | (uv > 1)).any()):
            raise ValueError("uv: expected coordinates in [0, 1], got values outside")
        uv = uv.detach().to(vertices)
    return UVMesh(vertices, faces, uv, bake(mesh.colors_of_faces().detach(), uv, size), wrap="clamp")


@torch.no_grad()
def bake(textures: Tensor, uv: Tensor, size: int) -> Tensor:
    """Bake texture cubes, or colours of corners, into an image, [size, size, 3] float32, row 0 at the top.

    Texture coordinates [F, 3, 2] of the faces' corners are in [0, 1], v up, and faces do not overlap. Texels that no
    face covers continue the colours around them.
    """
    corners = functional.pad(2 * uv - 1, (0, 1), value=1.0)
    fine = (size * _SAMPLES, size * _SAMPLES)
    drawn = rasterize_images(
        corners[None],
        fine,
        textures=textures[None].to(corners),
        outputs=("rgb", "alpha"),
        two_sided=True,  # charts may be mirrored
        perspective=False,
        anti_aliasing=False,
        near=0.5,
        far=2.0,
    )
    # A texel on the border of a chart gets the mean of its covered samples only.
    coverage = functional.avg_pool2d(drawn.alpha[:, None], _SAMPLES)
    image = functional.avg_pool2d(drawn.rgb * drawn.alpha[:, None], _SAMPLES) / coverage.clamp(min=1e-6)
    return pull_push(image, coverage > 0)[0].permute(1, 2, 0).clamp(0, 1).contiguous()


def load_xatlas() -> Any:
    """Import xatlas."""
    return import_library("xatlas", "to make charts")


def chart_coordinates(vertices: Tensor, faces: Tensor, size: int, gutter: int) -> Tensor:
    """Cut a surface into charts and pack them into a square; return uv of the faces' corners, [F, 3, 2] in [0, 1].

    Two charts are at least ``gutter`` pixels apart in an image of ``size`` pixels a side. Raises ModuleNotFoundError
    without xatlas.
    """
    xatlas = load_xatlas()
    atlas = xatlas.Atlas()
    positions = vertices.detach().cpu().double().numpy()
    low = positions.min(0)
    longest = max(float((positions.max(0) - low).max()), 1e-30)
    # Normalised, because the library discards tiny faces as degenerate.
    atlas.add_mesh(((positions - low) / longest * 100).astype(np.float32), faces.cpu().numpy().astype(np.uint32))
    options = xatlas.PackOptions()
    options.resolution, options.padding = size, gutter
    atlas.generate(xatlas.ChartOptions(), options)
    if atlas.atlas_count != 1:  # charts that do not fit go to a second image: pack again, with any size
        options.resolution, options.texels_per_unit = 0, 0.9 * atlas.texels_per_unit
        atlas.generate(xatlas.ChartOptions(), options)
    _, corners, uv = atlas[0]
    side = max(atlas.width, atlas.height)  # the image is square
    scaled = uv * np.array([atlas.width / side, atlas.height / side], dtype=np.float32)
    return torch.from_numpy(scaled[corners.astype(np.int64)]).float().to(vertices.device)
