"""Processor seconds and peak memory of `finish` against the number of faces.

    python -m benchmarks.finish_cost armadillo.obj --faces 10000 100000 1000000 5000000 --to 10000

Each number of faces is a process of its own: it subdivides a mesh, or decimates it, colours its vertices by a pattern,
and finishes it without improvement. Memory is the peak of that process, with the mesh and the libraries.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import time
from pathlib import Path

import torch

import neural_renderer as nr
from neural_renderer.apps.finish.surface.decimate import decimate


def heavy(path: Path, count: int) -> nr.Mesh:
    """Make a mesh of about ``count`` faces with colours of vertices: fewer faces first, then each split into four."""
    mesh = nr.Mesh.load(path).normalize()
    vertices, faces = mesh.vertices, mesh.faces.long()
    levels = max(0, math.ceil(math.log(0.95 * count / len(faces), 4)))
    vertices, faces = decimate(vertices, faces, round(count / 4**levels))
    mesh = nr.Mesh(vertices, faces.int(), vertex_colors=vertices)
    for _ in range(levels):
        mesh = mesh.subdivide()
    return nr.Mesh(mesh.vertices, mesh.faces, vertex_colors=0.5 + 0.5 * torch.sin(25 * mesh.vertices))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--faces", nargs="+", type=int, default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--to", type=int, default=10_000)
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--here", action="store_true", help="measure in this process")
    options = parser.parse_args()
    if not options.here:
        for count in options.faces:
            line = [sys.executable, "-m", "benchmarks.finish_cost", str(options.mesh), "--faces", str(count), "--here"]
            subprocess.run([*line, "--to", str(options.to), "--size", str(options.size)], check=True)
        return
    torch.set_num_threads(1)
    mesh = heavy(options.mesh, options.faces[0])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    start = time.process_time()
    report = nr.finish(mesh, options.to, size=options.size, steps=0).report
    row = {
        "source": mesh.num_faces,
        "faces": report["faces"],
        "seconds": round(time.process_time() - start, 1),
        **report["processor_seconds"],
        "gigabytes": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, 2),
        "before": round(before, 2),
    }
    print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
