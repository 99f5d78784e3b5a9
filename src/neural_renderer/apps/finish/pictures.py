"""Pictures: looks and silhouettes of the original, the reference for those of the small mesh, and a preview."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from ...camera import Camera
from ...meshes.uv_mesh import UVMesh
from ...rendering.deferred import fragments
from ...rendering.forward import render
from ..common.pictures.photograph import photograph
from ..common.pictures.sheet import sheet
from .source import CHANNELS, Source

_VIEWS_PER_PASS = 8  # views that are drawn together: a limit of the memory
_FINER = 3  # silhouettes of the original are drawn larger and averaged: faces smaller than a pixel alias
_AZIMUTHS, _MARGIN = (150.0, 270.0, 30.0), 1.3  # of the preview; a corner of the box is farther than its sides


@dataclass(frozen=True, eq=False)
class Target:
    """What a camera sees of the original.

    Attributes:
        camera: The camera.
        looks: [C, S, S] looks, 0 behind.
        coverage: [S, S], in [0, 1].
    """

    camera: Camera
    looks: Tensor
    coverage: Tensor


@torch.no_grad()
def draw_target(source: Source, camera: Camera, size: int) -> Target:
    """Draw the look of the original, anti-aliased, in a picture of ``size``² pixels."""
    visible = fragments((source.vertices, source.faces.int()), camera, size)
    index = visible.face_index[0].flatten()
    covered = torch.nonzero(index >= 0)[:, 0]
    values = torch.zeros(len(index), CHANNELS + 1)
    values[covered, :CHANNELS] = source.look(index[covered].long(), visible.weights[0].reshape(-1, 3)[covered])
    values[covered, CHANNELS] = 1
    drawn = visible.composite(values.view(*visible.face_index.shape, -1))[0]
    return Target(camera, drawn[:CHANNELS].contiguous(), drawn[CHANNELS])


class Outlines:
    """Silhouettes of a surface, vertices [V, 3] and faces [F, 3], from B cameras, in pictures of ``pixels``²."""

    def __init__(self, vertices: Tensor, faces: Tensor, cameras: Camera, pixels: int) -> None:
        self._cameras, self._pixels = cameras, pixels
        with torch.no_grad():
            rows = torch.arange(len(cameras)).split(_VIEWS_PER_PASS)
            drawn = [functional.avg_pool2d(self._drawn(vertices, faces, row, _FINER), _FINER) for row in rows]
            self._silhouettes = torch.cat(drawn)

    def __len__(self) -> int:
        return len(self._silhouettes)

    def error(self, vertices: Tensor, faces: Tensor, views: Tensor | None = None) -> Tensor:
        """Sum the squared differences of silhouettes from some views [N], or from all: the mean of the views."""
        views = torch.arange(len(self)) if views is None else views
        drawn = self._drawn(vertices, faces, views)
        return (drawn - self._silhouettes[views]).square().sum() / len(views)

    def _drawn(self, vertices: Tensor, faces: Tensor, views: Tensor, finer: int = 1) -> Tensor:
        camera, pixels = self._cameras[views], finer * self._pixels
        return render((vertices, faces.int()), camera, pixels, light=None, outputs="alpha").alpha


@torch.no_grad()
def preview(mesh: UVMesh, size: int = 256) -> Tensor:
    """Draw a mesh from three sides, [size, 3 · size, 3] uint8."""
    unit = mesh.normalize()
    return sheet([[picture.cpu() for picture in photograph(unit, _AZIMUTHS, size=size, distance=4.2 * _MARGIN)]])
