"""`Workshop`: the clean original, and levels of it with fewer faces and its look."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor

from ...io.files import warn
from ...meshes.bounds import bounding_box
from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ..common.geometry.defects import count_defects
from ..common.geometry.edges import areas
from .charts import chart_report, make_charts
from .clean import CleanMesh, clean
from .layout import Layout
from .parts import reduced
from .source import Source
from .transfer import MARGIN, Surroundings, kinds_of_faces, textured, transfer, with_frames

_LEAST_AREA = 0.8  # share of the area below which the light mesh is a part of the original
Report = Callable[..., None]
"""Function of the name of a step, the parts that are done, the number of parts, and a note."""


def silent(*_: Any) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class Level:
    """A mesh with fewer faces, before its improvement.

    Attributes:
        mesh: The mesh with the images of the original's look.
        layout: Texels of its images.
        looks: [N, C] look of the original at each texel.
        kinds: [F] materials of the original.
        numbers: Measures of the steps.
    """

    mesh: UVMesh
    layout: Layout
    looks: Tensor
    kinds: Tensor
    numbers: dict[str, Any] = field(default_factory=dict)


class Workshop:
    """The original, clean, with all that is needed to make levels of it."""

    def __init__(
        self, mesh: Mesh | UVMesh, *, inside: bool, pieces: float, holes: float, size: int, gutter: int
    ) -> None:
        start = time.process_time()
        mesh = mesh.to("cpu")
        self.original, self.size, self.gutter = mesh, size, gutter
        vertices, faces = mesh.vertices.detach().float(), mesh.faces.long()
        self.clean: CleanMesh = clean(vertices, faces, inside=inside, pieces=pieces, holes=holes)
        self._defects = count_defects(self.clean.faces.numpy())
        center, half = bounding_box(self.clean.vertices.double())
        self.center, self.half = center, half
        shown = mesh.submesh(self.clean.kept) if len(self.clean.kept) < len(faces) else mesh
        self._area = area_of(self.clean.vertices, self.clean.faces)
        detail = (self._area / (0.6 * size**2)) ** 0.5  # side of a texel, where charts use 60 % of the image
        self.source = Source(shown, detail)
        self.around = Surroundings(self.source, center, half)
        self.seconds = {"clean": time.process_time() - start}

    def level(self, count: int, report: Report = silent) -> Level:
        """Make a mesh of about ``count`` faces with the look of the original."""
        seconds = dict(self.seconds)
        clock = _Clock()
        report("decimate", 0, 1)
        found = reduced(self.clean.vertices, self.clean.faces, count)
        vertices, faces = found.vertices, found.faces
        report("decimate", 1, 1, f"{len(self.clean.faces):,} → {len(faces):,} faces")
        seconds["decimate"] = clock()
        left = area_of(found.moved, faces) / self._area
        if left < _LEAST_AREA:
            warn(f"mesh: expected the area of the surface, got {left:.0%} of it in {len(faces):,} faces")
        report("charts", 0, 1)
        uv = make_charts(vertices, faces, self.size, self.gutter)
        report("charts", 1, 1)
        seconds["charts"] = clock()
        level = self.painted(vertices, faces, uv, report)
        if found.moved is not vertices:
            level = replace(level, mesh=level.mesh.replace(vertices=found.moved))
        seconds["transfer"] = clock()
        borders, tangles = zip(self._defects, count_defects(faces.numpy()), strict=True)
        numbers = {
            "faces": len(faces),
            "area": round(left, 4),
            "vertices": len(vertices),
            "border_edges": list(borders),
            "edges_of_many_faces": list(tangles),
            "charts": chart_report(vertices, faces, uv, self.size),
            "processor_seconds": {name: round(value, 1) for name, value in seconds.items()},
        }
        level.numbers.update(numbers)
        return level

    def painted(self, vertices: Tensor, faces: Tensor, uv: Tensor, report: Report = silent) -> Level:
        """Transfer the look of the original to a mesh with charts."""
        frames = with_frames(vertices, faces, uv)
        layout = Layout.of(uv, self.size, MARGIN)
        looks = transfer(frames, layout, self.around, lambda done, total: report("transfer", done, total))
        kinds = kinds_of_faces(frames, self.around)
        return Level(textured(frames, layout, looks, self.source.mesh, kinds), layout, looks, kinds)

    def framed(self, level: Level, vertices: Tensor) -> Level:
        """Move the vertices of a level, with normals and tangents that fit."""
        mesh = with_frames(vertices, level.mesh.faces.long(), level.mesh.uv)
        return replace(level, mesh=mesh, kinds=kinds_of_faces(mesh, self.around))


def area_of(vertices: Tensor, faces: Tensor) -> float:
    """Compute the area of a surface."""
    return float(areas(vertices[faces]).double().sum())


class _Clock:
    """Processor seconds since the last call."""

    def __init__(self) -> None:
        self._last = time.process_time()

    def __call__(self) -> float:
        now = time.process_time()
        passed, self._last = now - self._last, now
        return passed
