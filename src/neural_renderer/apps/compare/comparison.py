"""`compare`: numbers that say how different two meshes are, and a picture of both and their difference."""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...camera import Camera
from ...io import save_image
from ...io.trimesh_meshes import is_trimesh
from ...meshes.batch import mesh_parts
from ...meshes.mesh import Mesh
from ...meshes.normals import vertex_normals
from ...meshes.uv_mesh import UVMesh
from ...shading.lights import CameraLight
from ..common.geometry.extent import extent
from ..common.pictures.outputs import GREY
from ..common.pictures.sheet import captioned, sheet
from .options import CompareOptions
from .stage import Stage, ViewErrors
from .surfaces import count_holes, surface_distance

_COLUMNS = 8  # most views of a sheet
_CONTRAST = 4  # factor on the differences of colours that a sheet shows
_TILE = 256  # largest side of a picture of a sheet, in pixels


@dataclass(frozen=True)
class Comparison:
    """How different two meshes are. Pairs are those of the first and of the second mesh.

    Attributes:
        psnr: Peak signal-to-noise ratio of the pictures in dB, over the pixels of all views that either silhouette
            covers; infinite for equal pictures.
        worst_psnr: The lowest PSNR of a view.
        iou: Intersection over union of the silhouettes, in [0, 1].
        ms_ssim: Multi-scale structural similarity of the pictures where either mesh is, 1 for equal ones (Wang,
            Simoncelli and Bovik, 2003); None for pictures below 11².
        normal_angle: Mean angle of the visible normals in degrees, [0, 180]; None if no pixel shows both meshes.
        distance: Mean distance of the surfaces in both directions, relative to the longest side of the first mesh.
        largest_distance: The largest distance of a sampled point, in the same unit.
        holes: Connected borders of each surface.
        vertices, faces: Numbers of each.
        texels: Pixels of the images of base colours, or texels of texture cubes; 0 for other colours.
        views: Number of views.
        size: Height and width of the pictures in pixels.

    Example:
        >>> comparison = nr.compare(nr.Mesh.icosphere(2), nr.Mesh.icosphere(3), views=4, size=64)
        >>> comparison.iou > 0.95, comparison.faces
        (True, (320, 1280))
        >>> comparison.failures(iou=0.9, angle=0.0)[0].partition(",")[0]
        'angle: expected at most 0 degrees'
        >>> comparison.as_dict()["holes"]
        [0, 0]
    """

    psnr: float
    worst_psnr: float
    iou: float
    ms_ssim: float | None
    normal_angle: float | None
    distance: float
    largest_distance: float
    holes: tuple[int, int]
    vertices: tuple[int, int]
    faces: tuple[int, int]
    texels: tuple[int, int]
    views: int
    size: tuple[int, int]

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers by name, for JSON.

        Returns:
            Lists in place of pairs, and None in place of an infinite PSNR.
        """
        values = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
        return {name: None if value == math.inf else value for name, value in values.items()}

    def failures(
        self,
        psnr: float | None = None,
        iou: float | None = None,
        angle: float | None = None,
        distance: float | None = None,
        new_holes: int | None = None,
        ms_ssim: float | None = None,
    ) -> list[str]:
        """Compare the numbers with limits; None is no limit.

        Args:
            psnr, iou, ms_ssim: The least of each.
            angle: The largest `normal_angle`.
            distance: The largest `distance`.
            new_holes: How many holes the second mesh may have more than the first.

        Returns:
            A sentence for each limit that is not kept.
        """
        added = self.holes[1] - self.holes[0]
        checks = (
            ("psnr", self.psnr, psnr, True, " dB"),
            ("iou", self.iou, iou, True, ""),
            ("ms_ssim", self.ms_ssim, ms_ssim, True, ""),
            ("angle", self.normal_angle, angle, False, " degrees"),
            ("distance", self.distance, distance, False, " of the longest side"),
            ("new_holes", added, new_holes, False, ""),
        )
        found = []
        for name, value, limit, is_least, unit in checks:
            if limit is None or (value is not None and (value >= limit if is_least else value <= limit)):
                continue
            missing = "no pixel that shows both meshes" if name == "angle" else "pictures that are too small"
            got = missing if value is None else f"{value:.6g}"
            found.append(f"{name}: expected at {'least' if is_least else 'most'} {limit:g}{unit}, got {got}")
        return found

    def table(self) -> list[str]:
        """Describe the numbers in lines of text.

        Returns:
            A line for each, with a name, two spaces or more, and the text.

        Example:
            >>> nr.compare(nr.Mesh.icosphere(1), nr.Mesh.icosphere(1), views=1, size=32).table()[5]
            'faces           80 and 80'
        """
        angle = "none" if self.normal_angle is None else f"{self.normal_angle:.2f} degrees"
        decibels = f"{self.psnr:.2f} dB, the worst view {self.worst_psnr:.2f} dB"
        rows = [
            ("PSNR", "equal pictures" if self.psnr == math.inf else decibels),
            ("silhouette IoU", f"{self.iou:.4f}"),
            ("MS-SSIM", "none" if self.ms_ssim is None else f"{self.ms_ssim:.4f}"),
            ("normals", angle),
            ("distance", f"{self.distance:.3%} of the longest side, at most {self.largest_distance:.3%}"),
        ]
        rows += [(name, "{:,} and {:,}".format(*getattr(self, name))) for name in ("faces", "holes", "texels")]
        return [f"{name:<15} {text}" for name, text in rows]


def compare(
    first: Any,
    second: Any,
    *,
    views: int = CompareOptions.views,
    size: int | tuple[int, int] = CompareOptions.size,
    cameras: Camera | None = None,
    light: Any = CameraLight(),  # noqa: B008 (immutable)
    shading: Any = None,
    layers: int | None = None,
    samples: int = CompareOptions.samples,
    output: str | os.PathLike[str] | None = None,
) -> Comparison:
    """Measure how different two meshes look, and how far apart their surfaces are.

    Both are drawn from the same views in the same light, over white. The meshes stay where they are: a mesh of another
    place, size or orientation is a different one.

    Args:
        first: `Mesh`, `UVMesh`, the path of a mesh file, a mesh of trimesh, or (vertices, faces, …) as `Mesh` takes
            them. The views show all of this mesh.
        second: The mesh to compare with it, in any of these forms.
        views: Number of views, evenly over the sphere, ≥ 1.
        size: Side of the pictures, or (height, width), in pixels.
        cameras: B cameras in place of these views.
        light, layers: As in `render`.
        shading: As in `render`, the same for both. None is "smooth" if the first mesh has normals or few creases, else
            "flat".
        samples: Number of points on each surface for the distance, ≥ 1.
        output: Picture to write, .png or .jpg: rows with the first mesh, the second, and their difference.

    Returns:
        The numbers.

    Raises:
        OSError: A file cannot be read or written.
        TypeError, ValueError: A mesh cannot be read, has no face or no area, no view shows a mesh, or an argument does
            not fit.

    Example:
        >>> ball, coarse = nr.Mesh.icosphere(3), nr.Mesh.icosphere(2)
        >>> comparison = nr.compare(ball, coarse, views=6, size=64, output="balls.png")
        >>> comparison.psnr > 20, comparison.distance < 0.01
        (True, True)
    """
    a, b = _as_mesh("first", first), _as_mesh("second", second)
    length, _ = (2 * extent(mesh.vertices.detach())[1] for mesh in (a, b))
    mean, largest = surface_distance(a, b, validate.whole("samples", samples, 1))
    if cameras is None:
        stage = Stage.around(a, views, size, light=light, shading=shading, layers=layers)
    else:
        stage = Stage.around(a, 1, size, light=light, shading=shading, layers=layers).seen_from(cameras)
    drawn, other = (mesh if stage.shading == "flat" else _with_normals(mesh) for mesh in (a, b))
    errors = stage.errors(drawn, other)
    found = Comparison(
        errors.psnr,
        float(errors.psnrs.min()),
        errors.iou,
        errors.ms_ssim,
        errors.normal_angle,
        mean / length,
        largest / length,
        holes=(count_holes(a.vertices, a.faces), count_holes(b.vertices, b.faces)),
        vertices=(len(a.vertices), len(b.vertices)),
        faces=(len(a.faces), len(b.faces)),
        texels=(texels_of(a), texels_of(b)),
        views=len(errors.psnrs),
        size=stage.pixels,
    )
    if output is not None:
        save_image(output, comparison_sheet(drawn, other, stage, errors, found.table()))
    return found


def comparison_sheet(first: Any, second: Any, stage: Stage, errors: ViewErrors, lines: list[str]) -> Tensor:
    """Draw the worst view and others: a row for each mesh, one for the difference, and lines of text below.

    Args:
        first, second: Meshes as in `Stage.draw`.
        stage, errors: The stage, and what its `errors` returned.
        lines: The text.

    Returns:
        [height, width, 3] uint8 on the CPU.
    """
    order = errors.psnrs.argsort().tolist()
    chosen = [order[number] for number in _spread(len(order), min(_COLUMNS, len(order)))]
    rows: list[list[Tensor]] = [[], [], []]
    for view in chosen:
        a, b = (_shrunk(stage.draw(mesh, view).rgb.clamp(0, 1))[0].cpu() for mesh in (first, second))
        for row, picture in zip(rows, (a, b, (_CONTRAST * (a - b).abs()).clamp(max=1)), strict=True):
            row.append(picture)
    return captioned(sheet(rows, ("first", "second", f"difference x {_CONTRAST}")), lines)


def texels_of(mesh: Mesh | UVMesh) -> int:
    """Count the texels that hold a mesh's base colours."""
    if isinstance(mesh, UVMesh):
        return sum(image.shape[0] * image.shape[1] for image in mesh.images)
    is_cubes = mesh.vertex_colors is None and mesh.face_colors is None
    return math.prod(mesh.textures.shape[:-1]) if is_cubes else 0


def _as_mesh(name: str, mesh: Any) -> Mesh | UVMesh:
    """Read or convert a mesh; raise TypeError or ValueError that calls it by its name."""
    if isinstance(mesh, (str, os.PathLike)):
        mesh = UVMesh.load(Path(mesh), GREY)
    elif is_trimesh(mesh):
        mesh = UVMesh.from_trimesh(mesh, GREY)
    elif isinstance(mesh, tuple):
        mesh = Mesh(*mesh)
    if not isinstance(mesh, (Mesh, UVMesh)):
        raise TypeError(f"{name}: expected a mesh or the path of one, got {type(mesh).__name__}")
    vertices, faces, _ = mesh_parts(mesh)
    validate.finite(name, vertices, always=True)
    if vertices.dim() != 2 or not len(faces):
        raise ValueError(f"{name}: expected one mesh with at least one face, got {validate.shape_of(faces)}")
    return mesh


def _with_normals(mesh: Mesh | UVMesh) -> Mesh | UVMesh:
    """Give a mesh the smooth normals that it is drawn with, so that they are computed once for all views."""
    if not isinstance(mesh, UVMesh) or mesh.normals is not None:
        return mesh
    return mesh.replace(normals=vertex_normals(mesh.vertices.detach().float(), mesh.faces)[0][mesh.faces.long()])


def _spread(count: int, wanted: int) -> list[int]:
    """Choose numbers from 0 to count − 1, the first and the last among them."""
    return torch.linspace(0, count - 1, wanted).round().long().tolist()


def _shrunk(picture: Tensor) -> Tensor:
    """Shrink a picture [1, 3, H, W] to a tile."""
    factor = min(1.0, _TILE / max(picture.shape[2:]))
    size = [max(1, round(side * factor)) for side in picture.shape[2:]]
    return torch.nn.functional.interpolate(picture, size, mode="bilinear", antialias=True).clamp(0, 1)
