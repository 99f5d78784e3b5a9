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
from .kept import KeptCharts, has_charts
from .layout import Layout
from .source import Source, seen_from_both_sides
from .surface.clean import CleanMesh, clean
from .surface.parts import Reduced, reduced
from .transfer import MARGIN, Surroundings, kinds_of_faces, textured, transfer, with_frames

SIZE = 2048
"""Side of new images in pixels, without another wish."""
_LEAST_AREA = 0.8  # share of the area below which the light mesh is a part of the original
Report = Callable[..., None]
"""Function of the name of a step, the parts that are done, the number of parts, and a note."""


def silent(*_: Any) -> None:
    """Report nothing."""


@dataclass(frozen=True, eq=False)
class Level:
    """A mesh with fewer faces, before its improvement.

    Attributes:
        mesh: The mesh with the images of the original's look, or with its own images.
        painted: The look of the original at the texels of new images; None if those of the original are kept.
        numbers: Measures of the steps.
    """

    mesh: UVMesh
    painted: Painted | None
    numbers: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Painted:
    """The look of the original at the texels of new images.

    Attributes:
        layout: Texels of the images.
        looks: [N, C] look of the original at each texel.
        kinds: [F] materials of the original.
    """

    layout: Layout
    looks: Tensor
    kinds: Tensor


class Workshop:
    """The original, clean, with all that is needed to make levels of it.

    ``keep_uv`` keeps its charts and images, shrunk to ``size`` if it is given; else new ones are made, of `SIZE`²
    pixels without ``size``.
    """

    def __init__(
        self,
        mesh: Mesh | UVMesh,
        *,
        inside: bool,
        pieces: float,
        holes: float,
        size: int | None,
        gutter: int,
        keep_uv: bool = False,
    ) -> None:
        start = time.process_time()
        if keep_uv and not has_charts(mesh):
            raise ValueError("keep_uv: expected a mesh with texture coordinates and an image, got one without")
        mesh = mesh.to("cpu")
        self.original, self.size, self.gutter = mesh, size or SIZE, gutter
        vertices, faces = mesh.vertices.detach().float(), mesh.faces.long()
        self.clean: CleanMesh = clean(vertices, faces, inside=inside, pieces=pieces, holes=0.0 if keep_uv else holes)
        self._defects = count_defects(self.clean.faces.numpy())
        self.center, self.half = bounding_box(self.clean.vertices.double())
        shown = mesh.submesh(self.clean.kept) if len(self.clean.kept) < len(faces) else mesh
        if isinstance(shown, UVMesh):
            shown = seen_from_both_sides(shown, self.clean.both_sides)
        self._area = area_of(self.clean.vertices, self.clean.faces)
        detail = (self._area / (0.6 * self.size**2)) ** 0.5  # side of a texel, where charts use 60 % of the image
        self.source = Source(shown, 0.0 if keep_uv else detail)
        self._kept = KeptCharts(self.source, self.clean, (self.center, self.half), size) if keep_uv else None
        self._around = None if keep_uv else Surroundings(self.source, self.center, self.half)
        self.seconds = {"clean": time.process_time() - start}

    def level(self, count: int, report: Report = silent) -> Level:
        """Make a mesh of about ``count`` faces with the look of the original."""
        seconds = dict(self.seconds)
        clock = _Clock()
        report("decimate", 0, 1)
        if self._kept is None:
            found = reduced(self.clean.vertices, self.clean.faces, count)
        else:
            kept = self._kept.reduced(count)
            found = Reduced(kept.vertices, kept.faces.long(), kept.vertices)
        vertices, faces = found.vertices, found.faces
        report("decimate", 1, 1, f"{len(self.clean.faces):,} → {len(faces):,} faces")
        seconds["decimate"] = clock()
        left = area_of(found.moved, faces) / self._area
        if left < _LEAST_AREA:
            warn(f"mesh: expected the area of the surface, got {left:.0%} of it in {len(faces):,} faces")
        if self._kept is None:
            report("charts", 0, 1)
            uv = make_charts(vertices, faces, self.size, self.gutter)
            report("charts", 1, 1)
            seconds["charts"] = clock()
            level = self._painted(vertices, faces, uv, report)
            if found.moved is not vertices:
                level = replace(level, mesh=level.mesh.replace(vertices=found.moved))
            seconds["transfer"] = clock()
        else:
            level = Level(kept, None)
        borders, tangles = zip(self._defects, count_defects(faces.numpy()), strict=True)
        numbers = {
            "faces": len(faces),
            "area": round(left, 4),
            "vertices": len(vertices),
            "border_edges": list(borders),
            "edges_of_many_faces": list(tangles),
            "charts": chart_report(level.mesh.replace(vertices=vertices)),
            "processor_seconds": {name: round(value, 1) for name, value in seconds.items()},
        }
        return replace(level, numbers=numbers)

    def _painted(self, vertices: Tensor, faces: Tensor, uv: Tensor, report: Report = silent) -> Level:
        """Transfer the look of the original to a mesh with charts."""
        frames = with_frames(vertices, faces, uv)
        layout = Layout.of(uv, self.size, MARGIN)
        around: Surroundings = self._around  # type: ignore[assignment]  # is there where charts are not kept
        looks = transfer(frames, layout, around, lambda done, total: report("transfer", done, total))
        painted = Painted(layout, looks, kinds_of_faces(frames, around))
        return Level(textured(frames, layout, looks, self.source.mesh, painted.kinds), painted)

    def moved(self, level: Level, vertices: Tensor) -> Level:
        """Move the vertices of a level, and transfer the look again."""
        if self._kept is not None:
            return replace(level, mesh=self._kept.framed(level.mesh, vertices))
        return replace(self._painted(vertices, level.mesh.faces.long(), level.mesh.uv), numbers=level.numbers)

    def corrected(self, level: Level, looks: Tensor) -> Level:
        """Make the new images of a level of other looks."""
        if level.painted is None:
            return level
        painted = replace(level.painted, looks=looks)
        mesh = textured(level.mesh, painted.layout, looks, self.source.mesh, painted.kinds)
        return replace(level, mesh=mesh, painted=painted)


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
