"""Image quality of finished meshes, beside decimation with the closest colours at the same number of faces.

    python -m benchmarks.finish_quality banana.obj scissors.obj --shares 0.2 0.05 0.01 --size 1024 --steps 0 60

Prints for each mesh and method: PSNR of 24 views in two lights that no step used, over the pixels that either
silhouette covers; its parts, from errors inside of both silhouettes and at outlines; intersection over union of the
silhouettes; border edges before and after; median texels of a face; processor seconds, and the peak memory so far.

The comparators weld vertices and decimate, by fast-simplification with its defaults (as trimesh does) or by MeshLab's
quadrics (`pip install pymeshlab`), get charts by xatlas, in each texel the colour of the original at the closest point,
and smooth normals. Pictures are matt, so that materials do not matter, and drawn three times as large, then averaged:
faces smaller than a pixel alias, in the original above all. ``--mitsuba`` draws eight views by Mitsuba
(`pip install mitsuba`), in one light with shadows and a white sky.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fast_simplification
import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

import neural_renderer as nr
from neural_renderer.apps.common.geometry.defects import count_defects
from neural_renderer.apps.common.geometry.nearest import NearestFaces
from neural_renderer.apps.common.geometry.unwrap import chart_coordinates
from neural_renderer.apps.common.pictures.outputs import GREY
from neural_renderer.apps.compare.stage import Stage
from neural_renderer.apps.finish.charts import chart_report
from neural_renderer.apps.finish.layout import Layout
from neural_renderer.apps.finish.source import COLOR, Source
from neural_renderer.apps.finish.transfer import filled

LIGHTS = (nr.Light(0.35, 0.65, direction=(0.2, 0.9, -0.4)), nr.Light(0.5, 0.5, direction=(-0.8, 0.1, 0.6)))
VIEWS, MITSUBA_VIEWS = 24, 8
_WHOLE = 1 - 1e-4
_FINER = 3  # pictures are drawn larger by it and averaged

Pictures = list[tuple[Tensor, Tensor]]
"""Colours [1, 3, S, S] and coverage [1, S, S] of each view."""


def simplified(points: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Decimate by fast-simplification, with its defaults."""
    found: tuple[np.ndarray, np.ndarray] = fast_simplification.simplify(points, faces, target_count=count)
    return found


def simplified_by_meshlab(points: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Decimate by MeshLab, keeping borders, topology and normals."""
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, faces))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=count, preservenormal=True, preservetopology=True, preserveboundary=True
    )
    found = meshes.current_mesh()
    return found.vertex_matrix(), found.face_matrix()


def decimated(mesh: nr.UVMesh, count: int, size: int, simplify: Callable[..., Any]) -> nr.UVMesh:
    """Decimate a mesh; each texel has the colour of the closest point."""
    joined = mesh.merge_vertices()
    points, faces = simplify(joined.vertices.double().numpy(), joined.faces.int().numpy(), count)
    vertices, corners = torch.from_numpy(points).float(), torch.from_numpy(faces).long()
    uv = chart_coordinates(vertices, corners, size, 4)
    layout = Layout.of(uv, size, 0)
    texels = torch.einsum("nk,nkc->nc", layout.weights, vertices[corners[layout.faces]])
    low, high = mesh.vertices.amin(0), mesh.vertices.amax(0)
    half = float((high - low).max()) / 2
    search = NearestFaces((mesh.vertices - (low + high) / 2) / half, mesh.faces)
    face, weights = search.closest((texels - (low + high) / 2) / half)
    return nr.UVMesh(
        vertices, corners.int(), uv, filled(layout, Source(mesh).look(face, weights)[:, COLOR]), wrap="clamp"
    )


class Judge:
    """Pictures of an original, which are drawn once, and the errors of other meshes against them."""

    def __init__(self, mesh: nr.UVMesh, pixels: int, by_mitsuba: bool) -> None:
        side = _FINER * pixels
        self._stages = [Stage.around(mesh, VIEWS, side, shading="smooth", light=light) for light in LIGHTS]
        self._pixels, self._original = pixels, mesh
        self._pictures = list(self._drawn(mesh))
        self._by_mitsuba: Pictures = list(self._drawn_by_mitsuba(mesh)) if by_mitsuba else []

    def errors(self, mesh: nr.UVMesh) -> dict[str, float]:
        """Measure PSNR, its parts, and silhouettes."""
        found = _errors(self._pictures, self._drawn(mesh))
        if self._by_mitsuba:
            other = _errors(self._by_mitsuba, self._drawn_by_mitsuba(mesh))
            found["mitsuba"] = other["psnr"]
        return found

    def _drawn(self, mesh: nr.UVMesh) -> Iterator[tuple[Tensor, Tensor]]:
        for stage in self._stages:
            for view in range(VIEWS):
                images = stage.draw(mesh, view)
                yield avg_pool2d(images.rgb.clamp(0, 1), _FINER), avg_pool2d(images.alpha, _FINER)

    def _drawn_by_mitsuba(self, mesh: nr.UVMesh) -> Iterator[tuple[Tensor, Tensor]]:
        from .finish_mitsuba import drawn_by_mitsuba

        yield from drawn_by_mitsuba(mesh, self._original, MITSUBA_VIEWS, self._pixels)


def _errors(first: Pictures, second: Iterator[tuple[Tensor, Tensor]]) -> dict[str, float]:
    inside, outside, values, shared, united = 0.0, 0.0, 0, 0.0, 0.0
    for (a, alpha_a), (b, alpha_b) in zip(first, second, strict=True):
        low, high = torch.minimum(alpha_a, alpha_b), torch.maximum(alpha_a, alpha_b)
        square = (a - b).double().square().sum(1)
        whole, covered = low > _WHOLE, high > 0
        inside, outside = inside + float(square[whole].sum()), outside + float(square[covered & ~whole].sum())
        values += 3 * int(covered.sum())
        shared, united = shared + float(low.sum()), united + float(high.sum())
    decibels = [-10 * math.log10(max(part, 1e-9) / values) for part in (inside + outside, inside, outside)]
    return dict(zip(("psnr", "inside", "outlines"), decibels, strict=True)) | {"iou": shared / united}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--shares", nargs="*", type=float, default=[0.2, 0.05, 0.01])
    parser.add_argument("--faces", nargs="*", type=int, default=[], help="numbers of faces beside the shares")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument(
        "--steps", nargs="*", type=int, default=[0, 60], help="of finish; -1: fast-simplification, -2: MeshLab"
    )
    parser.add_argument("--pixels", type=int, default=256)
    parser.add_argument("--mitsuba", action="store_true")
    parser.add_argument("--keep-uv", action="store_true", help="of finish: charts and images of the mesh remain")
    parser.add_argument("--output", type=Path, help="folder for the meshes")
    parser.add_argument("--json", type=Path, help="add a line for each row to this file")
    options = parser.parse_args()
    torch.set_num_threads(1)
    for path in options.meshes:
        mesh = nr.UVMesh.load(path, GREY)
        judge = Judge(Source(mesh).drawn, options.pixels, options.mitsuba)
        borders = count_defects(mesh.merge_vertices().faces.long().numpy())[0]
        counts = [max(4, round(share * mesh.num_faces)) for share in options.shares] + options.faces
        for count in counts:
            for steps in options.steps:
                name = {-1: "fast-simplification", -2: "MeshLab"}.get(steps, f"finish {steps}")
                start = time.process_time()
                result = _result(mesh, count, options.size, steps, options.keep_uv)
                seconds = time.process_time() - start
                charts = chart_report(result)
                row = {
                    "mesh": f"{path.parent.name}/{path.stem}",
                    "method": name,
                    "source": mesh.num_faces,
                    "faces": result.num_faces,
                    **judge.errors(result),
                    "borders": [borders, count_defects(result.merge_vertices().faces.long().numpy())[0]],
                    "texels": charts["texels_of_a_face"],
                    "seconds": seconds,
                    "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
                }
                print(
                    "  ".join(f"{value:.4f}" if isinstance(value, float) else str(value) for value in row.values()),
                    flush=True,
                )
                if options.json is not None:
                    with options.json.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                if options.output is not None:
                    options.output.mkdir(parents=True, exist_ok=True)
                    short = f"{path.parent.name}_{count}_{name.replace(' ', '_')}.glb"
                    result.save(options.output / short, overwrite=True)


def _result(mesh: nr.UVMesh, count: int, size: int, steps: int, keep_uv: bool) -> nr.UVMesh:
    if steps < 0:
        return decimated(mesh, count, size, simplified if steps == -1 else simplified_by_meshlab)
    side = None if keep_uv else size
    finished: nr.UVMesh = nr.finish(mesh, count, size=side, keep_uv=keep_uv, steps=steps, holes=0.0).mesh
    return finished


if __name__ == "__main__":
    main()
