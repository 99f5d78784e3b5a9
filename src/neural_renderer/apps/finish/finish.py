"""`finish`: a light mesh with the look of a heavy one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ...base import validate
from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ..common.geometry.unwrap import LEAST_SIZE, MOST_SIZE
from .improve import Improvement
from .options import LEAST_FACES, FinishOptions
from .workshop import Report, Workshop, silent


@dataclass(frozen=True, eq=False)
class Finished:
    """A light mesh with the look of a heavy one.

    Attributes:
        mesh: The mesh, with one image of base colours, and materials with images of normals and, where they vary, of
            metal and roughness, emission and opacity.
        report: Measures of each step, by name: what the cleaning removed, numbers of faces, charts, processor seconds,
            and PSNR in dB and silhouettes of views that did not improve the mesh, before and after.

    Example:
        >>> small = nr.finish(nr.Mesh.icosphere(3), 100, size=64, steps=0)
        >>> small.report["faces"], small.report["border_edges"]
        (100, [0, 0])
    """

    mesh: UVMesh
    report: dict[str, Any] = field(default_factory=dict)


def finish(
    mesh: Mesh | UVMesh,
    faces: int | Sequence[int] = FinishOptions.faces[0],
    *,
    size: int | None = FinishOptions.size,
    gutter: int = FinishOptions.gutter,
    keep_uv: bool = FinishOptions.keep_uv,
    keep_inside: bool = FinishOptions.keep_inside,
    pieces: float = FinishOptions.pieces,
    holes: float = FinishOptions.holes,
    steps: int = FinishOptions.steps,
    views: int = FinishOptions.views,
    pixels: int = FinishOptions.pixels,
    report: Report = silent,
) -> Any:
    """Make a light mesh that looks like a heavy one, or several levels of detail.

    The mesh is cleaned, its faces are reduced by quadric errors (fast-simplification, opengl_decimate), xatlas makes
    charts, and images get the look of the original: of each texel, the point along its normal, else the closest one.
    Then the gradient of the difference in drawings moves vertices and corrects the images; what does not improve views
    that are held out is dropped. Needs the extra "finish". All runs on the CPU.

    Args:
        mesh: The heavy mesh, with colours of vertices or faces, texture cubes, or images and materials.
        faces: Number of faces, ≥ 4, or several, each for a level. Without fewer faces than the mesh, its clean surface
            is kept.
        size: Side of the images in pixels, 16 to 8192; without it 2048, or with ``keep_uv`` that of the mesh's images.
        gutter: Least distance of two charts in pixels, ≥ 1.
        keep_uv: Whether charts, materials and images of the mesh remain: its vertices only move, and images larger than
            ``size`` shrink. Holes stay open.
        keep_inside: Whether connected parts that no view from outside sees remain.
        pieces: Connected parts shorter than this share of the mesh's longest side are removed, in [0, 0.5].
        holes: Holes shorter than this share of the longest side are closed, in [0, 1].
        steps: Steps of improvement, ≥ 0.
        views: Views that improve the mesh, ≥ 4.
        pixels: Side of their pictures, ≥ 64.
        report: Called with the name of a step, the parts that are done, their number, and a note.

    Returns:
        `Finished`, on the CPU; or a list of them, one for each number of faces.

    Raises:
        ModuleNotFoundError: fast-simplification, opengl_decimate or xatlas is not installed.
        TypeError, ValueError: An argument does not fit, no face has three different, finite corners, or there are no
            texture coordinates to keep.

    Example:
        >>> sphere = nr.Mesh.icosphere(4)
        >>> colored = nr.Mesh(sphere.vertices, sphere.faces, vertex_colors=sphere.vertices.abs().clamp(0, 1))
        >>> small = nr.finish(colored, 200, size=128, steps=0)
        >>> small.mesh.num_faces, small.mesh.images[0].shape
        (200, torch.Size([128, 128, 3]))
        >>> small.mesh.save("small.glb")
    """
    if not isinstance(mesh, (Mesh, UVMesh)):
        raise TypeError(f"mesh: expected a Mesh or UVMesh, got {type(mesh).__name__}")
    counts = [faces] if isinstance(faces, int) else list(faces)
    counts = [validate.whole("faces", count, LEAST_FACES) for count in counts]
    if not counts:
        raise ValueError("faces: expected at least one number, got none")
    gutter = validate.whole("gutter", gutter, 1)
    if size is not None and validate.whole("size", size, LEAST_SIZE) > MOST_SIZE:
        raise ValueError(f"size: expected at most {MOST_SIZE}, got {size}")
    steps, views = validate.whole("steps", steps, 0), validate.whole("views", views, 4)
    workshop = Workshop(
        mesh,
        inside=validate.flag("keep_inside", keep_inside),
        pieces=validate.not_negative("pieces", pieces),
        holes=validate.not_negative("holes", holes),
        size=size,
        gutter=gutter,
        keep_uv=validate.flag("keep_uv", keep_uv),
    )
    found = []
    for count in counts:
        task = Improvement(workshop, workshop.level(count, report), steps, views, validate.whole("pixels", pixels, 64))
        while not task.done:
            task.advance()
            report(task.phase, task.step, task.steps)
        found.append(finished(workshop, task))
    return found[0] if isinstance(faces, int) else found


def finished(workshop: Workshop, task: Improvement) -> Finished:
    """Return the best mesh of an improvement, with the report of all steps."""
    shown = {name: value for name, value in task.measured.items() if name != "best"}
    if task.measured:
        shown["after"] = task.measured["best"]
    report = {"source_faces": len(workshop.original.faces), "cleaned": workshop.clean.removed, **task.level.numbers}
    return Finished(task.level.mesh, report | ({"held_out": shown} if shown else {}))
