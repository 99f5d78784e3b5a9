"""Image quality of finished meshes, beside decimation with the closest colours at the same number of faces.

    python -m benchmarks.finish_quality banana.obj scissors.obj --shares 0.2 0.05 0.01 --size 1024 --steps 60

Prints for each: PSNR over the pixels that either silhouette covers, of 24 views in two lights that no step used, the
silhouettes' intersection over union, and processor seconds. The comparator: fast-simplification with its defaults,
charts by xatlas, in each texel the colour of the original at the closest point, and smooth normals. Pictures are matt,
so that materials do not matter.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import fast_simplification
import torch

import neural_renderer as nr
from neural_renderer.apps.common.geometry.unwrap import chart_coordinates
from neural_renderer.apps.common.pictures.outputs import GREY
from neural_renderer.apps.compare.stage import Stage
from neural_renderer.apps.finish.layout import Layout
from neural_renderer.apps.finish.source import COLOR, Source
from neural_renderer.apps.finish.transfer import filled

LIGHTS = (nr.Light(0.35, 0.65, direction=(0.2, 0.9, -0.4)), nr.Light(0.5, 0.5, direction=(-0.8, 0.1, 0.6)))


def decimated(mesh: nr.UVMesh, count: int, size: int) -> nr.UVMesh:
    """Decimate a mesh; each texel has the colour of the closest point."""
    joined = mesh.merge_vertices()
    points, faces = fast_simplification.simplify(
        joined.vertices.double().numpy(), joined.faces.int().numpy(), target_count=count
    )
    vertices, corners = torch.from_numpy(points).float(), torch.from_numpy(faces).long()
    uv = chart_coordinates(vertices, corners, size, 4)
    layout = Layout.of(uv, size, 0)
    texels = torch.einsum("nk,nkc->nc", layout.weights, vertices[corners[layout.faces]])
    near = nr.closest_points((mesh.vertices, mesh.faces), texels)
    colors = Source(mesh).look(near.face_index, near.weights)[:, COLOR]
    return nr.UVMesh(vertices, corners.int(), uv, filled(layout, colors), wrap="clamp")


def errors(mesh: nr.UVMesh, other: nr.UVMesh, size: int) -> tuple[float, float]:
    """Measure PSNR in dB and intersection over union."""
    stages = [Stage.around(mesh, 24, size, shading="smooth", light=light) for light in LIGHTS]
    found = [stage.errors(mesh, other) for stage in stages]
    mean = sum(10 ** (-one.psnr / 10) for one in found) / len(found)
    return float(-10 * torch.tensor(mean).log10()), found[0].iou


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", nargs="+", type=Path)
    parser.add_argument("--shares", nargs="+", type=float, default=[0.2, 0.05, 0.01])
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--steps", nargs="+", type=int, default=[0, 60])
    parser.add_argument("--pixels", type=int, default=384)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    for path in options.meshes:
        mesh = nr.UVMesh.load(path, GREY)
        drawn = Source(mesh).drawn
        for share in options.shares:
            count = max(4, round(share * mesh.num_faces))
            for steps in (None, *options.steps):
                name = "decimated" if steps is None else f"finish {steps}"
                start = time.process_time()
                if steps is None:
                    result = decimated(mesh, count, options.size)
                else:
                    result = nr.finish(mesh, count, size=options.size, steps=steps, holes=0.0).mesh
                seconds = time.process_time() - start
                psnr, iou = errors(drawn, result, options.pixels)
                memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
                print(
                    f"{path.parent.name}/{path.stem}  {result.num_faces:>8,} faces  {name:<10}  {psnr:6.2f} dB  "
                    f"IoU {iou:.4f}  {seconds:6.1f} s  {memory:.1f} GiB",
                    flush=True,
                )
                if options.output is not None:
                    file = options.output / f"{path.parent.name}_{result.num_faces}_{name.replace(' ', '_')}.glb"
                    result.save(file)


if __name__ == "__main__":
    main()
