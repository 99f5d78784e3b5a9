"""`Stage`: cameras and light in which two meshes are drawn alike, and the errors of one drawing against the other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...camera import Camera
from ...meshes.batch import mesh_parts
from ...meshes.bounds import bounding_box
from ...raster.outputs import Images
from ...raster.settings import image_size
from ...rendering.forward import render
from ...shading.lights import CameraLight
from ..common.pictures.outputs import distance_to_see, looks_smooth
from .options import CompareOptions
from .structure import multi_scale_similarity

_LIGHT = CameraLight()
VIEWING_ANGLE = 20.0
"""Half of the vertical field of view in degrees."""
_GOLDEN = math.pi * (3 - math.sqrt(5))  # turn from one point of a spiral to the next
_TOGETHER = 2**19  # pixels that are drawn in one call: a limit of the memory
_WHOLE = 1 - 1e-4  # a pixel with more coverage shows no background


@dataclass(frozen=True, eq=False)
class ViewErrors:
    """Errors of pictures of a mesh against those of another, from the same cameras.

    Attributes:
        psnr: Peak signal-to-noise ratio in dB, over the pixels of all views that either silhouette covers; infinite for
            equal pictures.
        psnrs: The same for each view, [B] float64.
        iou: Intersection over union of the silhouettes, Σ min / Σ max over the pixels of all views, in [0, 1].
        normal_angle: Mean angle of the normals in degrees, over the pixels that both meshes cover wholly; None if there
            is none.
        ms_ssim: Multi-scale structural similarity (Wang, Simoncelli and Bovik, 2003), 1 for equal pictures: the mean of
            the views, over windows around pixels that either silhouette covers. None for pictures below 11².

    Example:
        >>> from neural_renderer.apps.compare.stage import Stage
        >>> errors = Stage.around(mesh, views=2, size=32).errors(mesh, mesh)
        >>> errors.psnr, errors.iou, errors.worst_view
        (inf, 1.0, 0)
    """

    psnr: float
    psnrs: Tensor
    iou: float
    normal_angle: float | None
    ms_ssim: float | None = None

    @property
    def worst_view(self) -> int:
        """Index of the view with the lowest PSNR."""
        return int(self.psnrs.argmin())


@dataclass(frozen=True, eq=False)
class Stage:
    """Cameras, light and shading that draw several meshes alike.

    Attributes:
        cameras: B cameras.
        size: Side of the pictures, or (height, width), in pixels.
        light, shading, layers: As in `render`.
        background: Number or colour [3].

    Raises:
        TypeError, ValueError: In drawing, a value that `render` does not take.

    Example:
        >>> from neural_renderer.apps.compare.stage import Stage
        >>> stage = Stage.around(mesh, views=6, size=64)
        >>> stage.draw(mesh, 0).rgb.shape
        torch.Size([1, 3, 64, 64])
        >>> smaller = nr.Mesh.icosphere(1, radius=0.9)
        >>> stage.errors(mesh, smaller).iou < 0.9
        True
    """

    cameras: Camera
    size: int | tuple[int, int] = CompareOptions.size
    light: Any = _LIGHT
    shading: Any = "smooth"
    layers: int | None = None
    background: Any = 1.0

    @classmethod
    def around(
        cls,
        mesh: Any,
        views: int = CompareOptions.views,
        size: int | tuple[int, int] = CompareOptions.size,
        **drawing: Any,
    ) -> Stage:
        """Place cameras around a mesh, evenly over the sphere, each of which shows all of it.

        Args:
            mesh: `Mesh`, `UVMesh` or (vertices, faces, …).
            views: Number of cameras, ≥ 1.
            size: As the attribute.
            **drawing: The other attributes, except the cameras. The shading is "smooth" by default for a mesh with
                normals or few creases, else "flat".

        Returns:
            The stage.

        Raises:
            TypeError, ValueError: A number is out of range, or the mesh has no vertices.
        """
        vertices = mesh_parts(mesh)[0].detach()
        if not len(vertices):
            raise ValueError("mesh: expected at least one vertex, got none")
        center, _ = bounding_box(vertices)
        radius = max(float((vertices - center).norm(dim=1).max()), 1e-6)
        height, width = image_size("size", size)
        distance = distance_to_see(radius, VIEWING_ANGLE, width / height)
        directions = sphere_points(validate.whole("views", views, 1)).to(vertices)
        cameras = Camera.look_at(center + distance * directions, center, viewing_angle=VIEWING_ANGLE)
        drawing.setdefault("shading", None)
        if drawing["shading"] is None:
            drawing["shading"] = "smooth" if looks_smooth(mesh) else "flat"
        return cls(cameras, size, **drawing)

    @property
    def pixels(self) -> tuple[int, int]:
        """Height and width of the pictures."""
        return image_size("size", self.size)

    def seen_from(self, cameras: Camera) -> Stage:
        """Copy the stage with other cameras.

        Args:
            cameras: B cameras.

        Returns:
            The copy.

        Raises:
            TypeError: An argument of another type.

        Example:
            >>> from neural_renderer.apps.compare.stage import Stage
            >>> front = Stage.around(mesh, size=64).seen_from(nr.Camera.look_at((0.0, 0.0, 3.0)))
            >>> front.draw(mesh, slice(0, 1)).alpha.shape
            torch.Size([1, 64, 64])
        """
        if not isinstance(cameras, Camera):
            raise TypeError(f"cameras: expected a Camera, got {type(cameras).__name__}")
        return replace(self, cameras=cameras)

    @torch.no_grad()
    def draw(self, mesh: Any, views: int | slice) -> Images:
        """Draw a mesh from some of the cameras.

        Args:
            mesh: `Mesh`, `UVMesh` or (vertices, faces, …).
            views: Number of a camera, or a range of B of them.

        Returns:
            Images with rgb [B, 3, H, W], alpha [B, H, W] and normal [B, 3, H, W].

        Raises:
            TypeError, ValueError: As `render`.
        """
        camera = self.cameras[views]
        scene = {"light": self.light, "shading": self.shading, "background": self.background}
        if self.layers is None:
            return render(mesh, camera, self.size, outputs=("rgb", "alpha", "normal"), **scene)
        blended = render(mesh, camera, self.size, outputs=("rgb", "alpha"), layers=self.layers, **scene)
        return blended.replace(normal=render(mesh, camera, self.size, outputs="normal", **scene).normal)

    def errors(self, first: Any, second: Any) -> ViewErrors:
        """Draw two meshes from all cameras, and measure the differences of the pictures.

        Args:
            first, second: Meshes as in `draw`.

        Returns:
            The errors.

        Raises:
            ValueError: No view shows a mesh; or as `render`.
        """
        together = max(1, _TOGETHER // math.prod(self.pixels))
        sums, similar = [], []
        for begin in range(0, len(self.cameras), together):
            views = slice(begin, begin + together)
            a, b = self.draw(first, views), self.draw(second, views)
            sums.append(sums_of_errors(a, b))
            shown = torch.maximum(a.alpha, b.alpha) > 0
            similar.append(multi_scale_similarity(a.rgb.clamp(0, 1), b.rgb.clamp(0, 1), shown))
        return errors_of_sums(torch.cat(sums), torch.cat(similar))


def errors_of_sums(sums: Tensor, similar: Tensor | None = None) -> ViewErrors:
    """Convert the sums [B, 6] of views, from `sums_of_errors`; ValueError if no view shows a mesh.

    ``similar`` is their multi-scale structural similarity [B], if it is to be reported.
    """
    squares, values, shared, united, angles, pixels = sums.cpu().unbind(1)
    if not values.sum():
        raise ValueError("meshes: expected a view that shows one of them, got none")
    angle = float(angles.sum() / pixels.sum()) if pixels.sum() else None
    psnr = float(_decibels(squares.sum(), values.sum()))
    alike = math.nan if similar is None else float(similar.cpu()[values > 0].mean())
    iou = float(shared.sum() / united.sum())
    return ViewErrors(psnr, _decibels(squares, values), iou, angle, None if math.isnan(alike) else alike)


def sums_of_errors(a: Images, b: Images) -> Tensor:
    """Sum the errors of B pictures of two meshes, [B, 6] float64."""
    pairs = (a.rgb, b.rgb, a.alpha, b.alpha, a.normal, b.normal)
    return torch.stack([_sums(*pictures) for pictures in zip(*pairs, strict=True)])


def _sums(rgb_a: Tensor, rgb_b: Tensor, alpha_a: Tensor, alpha_b: Tensor, normal_a: Tensor, normal_b: Tensor) -> Tensor:
    """Sum over pixels: squared errors and their number, shared and united coverage, angles and their number, [6]."""
    low, high = torch.minimum(alpha_a, alpha_b), torch.maximum(alpha_a, alpha_b)
    covered, inside = high > 0, low > _WHOLE
    square = (rgb_a.clamp(0, 1) - rgb_b.clamp(0, 1))[:, covered].double().square()
    angles = _angles(normal_a[:, inside].double(), normal_b[:, inside].double())
    parts = square.sum(), square.new_tensor(square.numel()), low.double().sum(), high.double().sum()
    return torch.stack((*parts, angles.sum(), square.new_tensor(len(angles))))


def sphere_points(count: int) -> Tensor:
    """Spread points evenly over the unit sphere, on a spiral (Vogel, 1979, on a sphere), [count, 3] float64."""
    number = torch.arange(count, dtype=torch.float64)
    height = 1 - (2 * number + 1) / count
    across, azimuth = (1 - height.square()).sqrt(), _GOLDEN * number
    return torch.stack((across * azimuth.cos(), height, across * azimuth.sin()), 1)


def _angles(a: Tensor, b: Tensor) -> Tensor:
    """Compute the angles in degrees between vectors [3, N]."""
    return torch.atan2(torch.linalg.cross(a, b, dim=0).norm(dim=0), (a * b).sum(0)) * (180 / math.pi)


def _decibels(squares: Tensor, values: Tensor) -> Tensor:
    """Convert sums of squared errors of a number of values in [0, 1] to PSNR; infinite without values."""
    return -10 * (squares / values.clamp(min=1)).log10()
