"""`rasterize_meshes`: the K nearest faces at each pixel, from vertices in NDC; `MeshRasterizer` of cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from ....raster.ops.draw import Drawing
from ....raster.ops.peel import draw_behind
from ....raster.settings import FARTHEST
from ...common.comparators.soft_silhouettes import at_pairs, near_pairs, signed_squares
from .meshes import Meshes

_STEP = 1 + 2.0**-20  # a layer begins behind this multiple of the previous layer's depth, a few roundings


@dataclass
class Fragments:
    """Faces at pixels, the nearest first; -1 where there is none.

    ``pix_to_face`` counts the faces of all meshes of the batch; ``dists`` are squared distances to a face's outline in
    NDC, below zero inside.
    """

    pix_to_face: Tensor  # [N, H, W, K] int64
    zbuf: Tensor  # [N, H, W, K]
    bary_coords: Tensor  # [N, H, W, K, 3]
    dists: Tensor  # [N, H, W, K]

    def detach(self) -> Fragments:
        return Fragments(self.pix_to_face, self.zbuf.detach(), self.bary_coords.detach(), self.dists.detach())


@dataclass
class RasterizationSettings:
    """Arguments of `rasterize_meshes`; None leaves the choice to the camera."""

    image_size: int | tuple[int, int] = 256
    blur_radius: float = 0.0
    faces_per_pixel: int = 1
    bin_size: int | None = None
    max_faces_opengl: int = 10_000_000
    max_faces_per_bin: int | None = None
    perspective_correct: bool | None = None
    clip_barycentric_coords: bool | None = None
    cull_backfaces: bool = False
    z_clip_value: float | None = None
    cull_to_frustum: bool = False


def rasterize_meshes(
    meshes: Meshes, image_size: Any = 256, blur_radius: float = 0.0, faces_per_pixel: int = 8, bin_size: Any = None,
    max_faces_per_bin: Any = None, perspective_correct: bool = False, clip_barycentric_coords: bool = False,
    cull_backfaces: bool = False, z_clip_value: float | None = None, cull_to_frustum: bool = False,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    """Find the faces at pixels: `Fragments` as a tuple, differentiable in the vertices.

    Without blur, the rasteriser of this package draws K layers; a centre on an edge is covered. With it, faces that
    reach a pixel's centre within √blur_radius are listed; those with a corner behind the camera are left out.
    """
    height, width = (image_size, image_size) if isinstance(image_size, int) else map(int, image_size)
    corners, counts = meshes.verts_packed()[meshes.faces_packed()].float(), meshes.num_faces_per_mesh().tolist()
    view = _View(height, width, perspective_correct, clip_barycentric_coords, cull_backfaces, z_clip_value or 0.0)
    with torch.no_grad():
        parts = corners.detach().split(counts)
        if blur_radius <= 0:
            found = view.layers(parts, faces_per_pixel)
        else:
            found = torch.stack([view.within(part, faces_per_pixel, blur_radius) for part in parts])
        first = meshes.mesh_to_faces_packed_first_idx().view(-1, 1, 1, 1)
        faces = torch.where(found < 0, -1, found + first)
    return view.measured(corners, faces)


@dataclass(frozen=True)
class _View:
    """Size of the images, and options."""

    height: int
    width: int
    perspective: bool
    clip: bool
    front_only: bool
    near: float

    def layers(self, meshes: tuple[Tensor, ...], count: int) -> Tensor:
        """Draw the ``count`` nearest faces of each mesh without blur, [N, H, W, count]."""
        device = meshes[0].device
        corners = nn.utils.rnn.pad_sequence([*meshes], batch_first=True, padding_value=math.nan)
        corners = (corners * self._to_screen(corners)).contiguous()
        options = Drawing(self.near, FARTHEST, not self.front_only, self.perspective)
        found = torch.full((count, len(meshes), self.height, self.width), -1, dtype=torch.int32, device=device)
        floor = torch.full(found.shape[1:], self.near, device=device)
        for layer in found:
            floor = draw_behind(corners, layer, options, floor, _STEP)
            if not (layer >= 0).any():
                break
        return found.movedim(0, -1).long()

    def within(self, corners: Tensor, count: int, radius: float) -> Tensor:
        """List the ``count`` nearest faces of one mesh within √radius of each pixel's centre, [H, W, count]."""
        area = _area(corners.permute(2, 1, 0))
        left_out = (area >= -1e-8) if self.front_only else (area.abs() <= 1e-8)
        screen = (corners * self._to_screen(corners)).masked_fill(left_out[:, None, None], math.nan)
        face, row, column = near_pairs(screen[None], self.height, self.width, math.sqrt(radius))
        _, z, distance = self._at(corners, face, row, column)
        kept = ((distance < radius) & (z >= 0)).nonzero()[:, 0]
        pixel, bits = (row * self.width + column)[kept], (z[kept] + 0.0).view(torch.int32)  # ordered as z is, if z ≥ 0
        key, order = torch.sort(pixel << 32 | bits, stable=True)
        pixel = key >> 32
        number = torch.bincount(pixel, minlength=self.height * self.width)
        rank = torch.arange(len(pixel), device=pixel.device) - (number.cumsum(0) - number)[pixel]
        found = face.new_full((self.height * self.width, count + 1), -1)
        found.view(-1)[pixel * (count + 1) + rank.clamp(max=count)] = face[kept[order]]  # the last takes what is over
        return found[:, :count].reshape(self.height, self.width, count)

    def measured(self, corners: Tensor, faces: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the faces [N, H, W, K] with their depths, weights and distances, -1 where there is none."""
        place = (faces.flatten() >= 0).nonzero()[:, 0]
        pixel = place // faces.shape[-1] % (self.height * self.width)
        weights, z, distance = self._at(corners, faces.flatten()[place], pixel // self.width, pixel % self.width)
        empty = corners.new_full((faces.numel(),), -1)
        zbuf, dists, *bary = (empty.scatter(0, place, each).view_as(faces) for each in (z, distance, *weights))
        return faces, zbuf, torch.stack(bary, -1), dists

    def _at(self, corners: Tensor, face: Tensor, row: Tensor, column: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Compute weights [3, M], depths and signed squared distances [M] of pixels in faces of corners [F, 3, 3]."""
        square, side = signed_squares(corners[..., :2], face, self._centers(row, column))
        depth = corners[..., 2].T
        factor = 1 / _nonzero(_area(corners.permute(2, 1, 0))).expand(3, -1)
        if self.perspective:
            factor = factor / _nonzero(depth)
        weights = side.roll(-1, 0) * at_pairs(factor, face)
        if self.perspective:
            weights = weights / _nonzero(weights.sum(0))
        if self.clip:
            weights = weights.clamp(min=0)
            weights = weights / weights.sum(0).clamp(min=1e-5)
        return weights, (weights * at_pairs(depth, face)).sum(0), -square

    def _centers(self, row: Tensor, column: Tensor) -> Tensor:
        """Return the centres of pixels in NDC, x to the left, y up; the shorter side of the image is [-1, 1]."""
        x, y = self.width - 1 - 2 * column, self.height - 1 - 2 * row
        return torch.stack((x, y)).float() / min(self.height, self.width)

    def _to_screen(self, like: Tensor) -> Tensor:
        """Return the factors of NDC to the screen, x to the right and y up in [-1, 1] over the image."""
        short = min(self.height, self.width)
        return like.new_tensor([-short / self.width, short / self.height, 1.0])


class MeshRasterizer(nn.Module):
    """Projects meshes by cameras, and rasterises them."""

    def __init__(self, cameras: Any = None, raster_settings: RasterizationSettings | None = None) -> None:
        super().__init__()
        self.cameras = cameras
        self.raster_settings = RasterizationSettings() if raster_settings is None else raster_settings

    def to(self, device: Any) -> Any:  # type: ignore[override]
        self.cameras = None if self.cameras is None else self.cameras.to(device)
        return self

    def transform(self, meshes_world: Meshes, **kwargs: Any) -> Meshes:
        """Return the meshes with x and y in NDC, and the depth of the view as z."""
        cameras = kwargs.get("cameras", self.cameras)
        if cameras is None:
            raise ValueError("cameras: expected those of MeshRasterizer or of this call, got none")
        if len(cameras) not in (1, len(meshes_world)):
            raise ValueError(f"cameras: expected 1 or {len(meshes_world)} like meshes, got {len(cameras)}")
        eps, verts = kwargs.get("eps"), meshes_world.verts_padded()
        view = cameras.get_world_to_view_transform(**kwargs).transform_points(verts, eps=eps)
        to_ndc = cameras.get_projection_transform(**kwargs).compose(cameras.get_ndc_camera_transform(**kwargs))
        ndc = to_ndc.transform_points(view, eps=eps)
        return meshes_world.update_padded(torch.cat((ndc[..., :2], view[..., 2:]), -1))

    def forward(self, meshes_world: Meshes, **kwargs: Any) -> Fragments:
        projected = self.transform(meshes_world, **kwargs)
        cameras, settings = kwargs.get("cameras", self.cameras), kwargs.get("raster_settings", self.raster_settings)
        perspective, clip, near = settings.perspective_correct, settings.clip_barycentric_coords, settings.z_clip_value
        perspective = cameras.is_perspective() if perspective is None else perspective
        if near is None and perspective and (znear := cameras.get_znear()) is not None:
            near = float(torch.as_tensor(znear).min()) / 2
        return Fragments(
            *rasterize_meshes(
                projected,
                settings.image_size,
                settings.blur_radius,
                settings.faces_per_pixel,
                perspective_correct=perspective,
                clip_barycentric_coords=settings.blur_radius > 0 if clip is None else clip,
                cull_backfaces=settings.cull_backfaces,
                z_clip_value=near,
            )
        )


def _area(corners: Tensor) -> Tensor:
    """Compute twice the signed areas of faces [2, 3, N], above zero where corners run clockwise in the image."""
    (ax, bx, cx), (ay, by, cy) = corners[:2]
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def _nonzero(value: Tensor) -> Tensor:
    return torch.where(value == 0, 1e-8, value)
