"""Times on a GPU: ``python -m benchmarks.on_cuda``, with ``--json`` into a file.

Each row is a scene and what is drawn: without anti-aliasing, checks of values off. Milliseconds:

- forward, step: by events around each call, the median; a step is forward and backward.
- loop: calls in a row, as a training does. host: until they are enqueued; about the loop where Python bounds it.
- graph: replays of a captured call (`torch.cuda.CUDAGraph`).
- kernels: the GPU's time in a step by kernel, from torch's profiler.

"smooth" balls have small bumps, lower than an edge is long. "rough" ones have spikes of 3 % of the diameter, many edges
long, so that most edges are visible outlines: the worst case.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import warp as wp
from torch import Tensor

import neural_renderer as nr

Work = Callable[[], object]

# (faces, images, side, kind of ball)
SMOOTH, ROUGH = "smooth", "rough"
SCENES = [
    (1280, 64, 128, SMOOTH),
    (1280, 8, 256, SMOOTH),
    (81920, 1, 512, SMOOTH),
    (81920, 8, 1024, SMOOTH),
    (327680, 1, 1024, SMOOTH),
    (327680, 1, 1024, ROUGH),
    (1310720, 1, 1024, SMOOTH),
    (1310720, 1, 1024, ROUGH),
    (10**7, 1, 2048, SMOOTH),
    (10**7, 1, 2048, ROUGH),
]
DRAWN = [
    ("silhouettes", "edge"),
    ("silhouettes", "nmr"),
    ("vertex colours", "edge"),
    ("texture image, lit", "edge"),
    ("texture cubes, lit", "nmr"),
]
_FEW = 2_000_000  # faces, above which only silhouettes are drawn


def ball(faces: int, kind: str, device: str) -> tuple[Tensor, Tensor]:
    """Make a closed ball of about so many faces: an icosphere, or a grid above a million faces."""
    if faces < 10**6:
        vertices, index = nr.icosphere(round(math.log(faces / 20, 4)))
        vertices, index = vertices.to(device), index.to(device)
    else:
        n = math.isqrt(faces // 2)
        places = torch.linspace(0, 1, n + 1, device=device)
        around, down = torch.meshgrid(2 * math.pi * places[:n], math.pi * places, indexing="ij")
        vertices = torch.stack((down.sin() * around.cos(), down.cos(), down.sin() * around.sin()), -1).reshape(-1, 3)
        i, j = torch.meshgrid(torch.arange(n, device=device), torch.arange(n, device=device), indexing="ij")
        a, b = i * (n + 1) + j, (i + 1) % n * (n + 1) + j
        index = torch.stack((torch.stack((a, b, a + 1), -1), torch.stack((b, b + 1, a + 1), -1)), 2).reshape(-1, 3)
    bumps = 0.05 if kind == ROUGH else 0.5 / math.sqrt(faces)
    generator = torch.Generator(device).manual_seed(0)
    push = 1 + bumps * torch.rand(len(vertices), 1, generator=generator, device=device)
    return 0.7 * vertices * push, index.int()


def calls(scene: tuple[int, int, int, str], drawn: str, gradient: str, device: str) -> tuple[Work, Work]:
    """Make two functions: the forward pass without gradients, and forward and backward."""
    faces, images, size, kind = scene
    vertices, index = ball(faces, kind, device)
    vertices.requires_grad_()
    eyes = nr.get_points_from_angles(2.732, 20.0, torch.arange(images) * (360.0 / images))
    camera = nr.Camera.look_at(eyes.to(device), viewing_angle=20.0)
    mesh: Any = (vertices, index)
    options: dict[str, Any] = {"outputs": ("rgb",), "gradient": gradient, "anti_aliasing": False}
    if drawn == "silhouettes":
        options["outputs"] = ("alpha",)
    elif drawn == "vertex colours":
        mesh, options["light"] = nr.Mesh(vertices, index, vertex_colors=torch.rand_like(vertices)), None
    elif drawn == "texture cubes, lit":
        mesh = (vertices, index, torch.rand(len(index), 2, 2, 2, 3, device=device))
    else:
        uv = (vertices.detach()[:, :2] * 0.7 + 0.5)[index.long()]
        mesh = nr.UVMesh(vertices, index, uv, image=torch.rand(512, 512, 3, device=device))
    output = options["outputs"][0]
    weights = torch.randn_like(getattr(nr.render(mesh, camera, size, **options), output))

    def forward() -> None:
        with torch.no_grad():
            nr.render(mesh, camera, size, **options)

    def step() -> None:
        vertices.grad = None
        getattr(nr.render(mesh, camera, size, **options), output).backward(weights)

    return forward, step


def by_events(work: Work, seconds: float) -> dict[str, float]:
    """Measure a call in milliseconds: "ms", "loop" and "host", as the module says."""
    started = time.perf_counter()
    for _ in range(3):
        work()
    torch.cuda.synchronize()
    count = max(5, min(50, int(1.5 * seconds / (time.perf_counter() - started))))
    each = []
    for _ in range(count):
        before, after = (torch.cuda.Event(enable_timing=True) for _ in range(2))
        before.record()
        work()
        after.record()
        after.synchronize()
        each.append(before.elapsed_time(after))
    began = time.perf_counter()
    for _ in range(count):
        work()
    host = time.perf_counter() - began
    torch.cuda.synchronize()
    loop = time.perf_counter() - began
    found = {"ms": statistics.median(each), "loop": 1e3 * loop / count, "host": 1e3 * host / count}
    return {name: round(value, 4) for name, value in found.items()}


def replayed(work: Work, seconds: float) -> float:
    """Capture a call, and measure its replay in milliseconds."""
    stream = torch.cuda.Stream()
    with torch.cuda.stream(stream):
        work()
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, stream=stream):
        work()
    return by_events(graph.replay, seconds)["ms"]


def by_kernel(work: Work, repeats: int = 4) -> dict[str, float]:
    """Measure the GPU's milliseconds in a call by kernel, the longest first; those of torch as one."""
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profiled:
        for _ in range(repeats):
            work()
        torch.cuda.synchronize()
    found: dict[str, float] = {}
    for event in profiled.key_averages():
        own = re.match(r"(\w+)_[0-9a-f]{8}_cuda_kernel_forward", event.key)
        name = own[1] if own else "torch"
        found[name] = found.get(name, 0.0) + event.self_device_time_total / repeats / 1e3
    return {name: round(ms, 4) for name, ms in sorted(found.items(), key=lambda item: -item[1])}


def hardware() -> dict[str, Any]:
    """Name the GPU, its driver and the versions."""
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    driver = subprocess.run(query, capture_output=True, text=True, check=False).stdout.strip()
    return {
        "gpu": torch.cuda.get_device_name(),
        "driver": driver,
        "torch": torch.__version__,
        "warp": wp.__version__,
        "neural_renderer": nr.__version__,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="also write the numbers here")
    parser.add_argument("--seconds", type=float, default=0.2, help="for each number")
    options = parser.parse_args()
    if not torch.cuda.is_available():
        parser.error("expected a GPU, found none")
    nr.check_values(False)
    report: dict[str, Any] = {"hardware": hardware(), "rows": []}
    print("| scene | drawn | gradient | forward | step | loop | host | graph, forward | graph, step | kernels |")
    print("|---|---|---|---:|---:|---:|---:|---:|---:|---:|")
    for scene in SCENES:
        for drawn, gradient in DRAWN:
            if scene[0] > _FEW and drawn != "silhouettes":
                continue
            forward, step = calls(scene, drawn, gradient, "cuda")
            row: dict[str, Any] = dict(zip(("faces", "images", "size", "kind"), scene, strict=True))
            row |= {"drawn": drawn, "gradient": gradient}
            row |= {"forward": by_events(forward, options.seconds), "step": by_events(step, options.seconds)}
            row |= {"kernels": by_kernel(step)}
            row |= {"graph_forward": replayed(forward, options.seconds), "graph_step": replayed(step, options.seconds)}
            report["rows"].append(row)
            timed = row["step"]
            numbers = [row["forward"]["ms"], timed["ms"], timed["loop"], timed["host"]]
            numbers += [row["graph_forward"], row["graph_step"], sum(row["kernels"].values())]
            name = f"{scene[1]} × {scene[2]}², {scene[0]:,} faces, {scene[3]}"
            print(f"| {name} | {drawn} | {gradient} | " + " | ".join(f"{n:.3g}" for n in numbers) + " |", flush=True)
            del forward, step
    if options.json:
        options.json.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
