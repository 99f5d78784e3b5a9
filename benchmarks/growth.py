"""Growth of time and memory with faces, pixels and images: ``python -m benchmarks.growth``.

Every row is a process of its own, with one thread: a noisy sphere with colours of vertices, unlit, anti-aliased, in
one image unless the row says otherwise. It prints processor seconds of `render` and of a step (the second one, with
``"edge"``, gradients to vertices), the peak memory of the process, torch included, and the slope: the exponent p of
time ~ workᵖ between a row and the one above. Images above 10⁷ pixels are drawn in strips, forward alone.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import time

import torch

# (what grows, icosphere level, side, images)
ROWS = (
    [("faces", level, 512, 1) for level in (3, 4, 5, 6, 7, 8, 9)]
    + [("pixels", 6, side, 1) for side in (100, 316, 1000, 3162, 10000)]
    + [("images", 4, 128, count) for count in (1, 4, 16, 64, 256)]
)
MOST_LEVELS = 8  # of an icosphere
STRIPS_FROM = 3000  # side from which images are drawn in strips, without gradients


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--row", help=argparse.SUPPRESS)
    row = parser.parse_args().row
    if row:
        print(json.dumps(measured(*json.loads(row))))
        return
    print("| grows | faces | pixels | images | forward, s | slope | with backward, s | slope | GB |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    before: tuple[str, float, list[float]] = ("", 0.0, [])
    for kind, level, side, count in ROWS:
        command = [sys.executable, "-m", "benchmarks.growth", "--row", json.dumps([level, side, count])]
        *times, memory = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        faces = 20 * 4 ** min(level, MOST_LEVELS) * (8 if level > MOST_LEVELS else 1)
        work = {"faces": faces, "pixels": side**2, "images": count}[kind]
        slopes = [""] * 2
        if kind == before[0]:
            pairs = zip(times, before[2], strict=False)
            slopes = [f"{math.log(now / then) / math.log(work / before[1]):.2f}" for now, then in pairs]
        before = kind, work, times
        cells = [cell for pair in zip((f"{t:.3g}" for t in times), slopes, strict=False) for cell in pair]
        cells += [""] * (4 - len(cells))
        print(f"| {kind} | {faces:,} | {side}² | {count} | {' | '.join(cells)} | {memory:.2f} |", flush=True)


def measured(level: int, side: int, count: int) -> list[float]:
    """Return processor seconds forward, and with backward unless in strips, and the peak memory in GB."""
    import neural_renderer as nr

    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    sphere, faces = nr.icosphere(min(level, MOST_LEVELS))
    if level > MOST_LEVELS:  # eight spheres of the finest, in a cube
        places = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5])] * 3)
        faces = torch.cat([faces + len(sphere) * n for n in range(8)])
        sphere = torch.cat([0.5 * sphere + place for place in places])
    vertices = 0.7 * sphere * (1 + 0.1 * torch.rand(len(sphere), 1, generator=generator))
    colors = torch.rand(len(sphere), 3, generator=generator)
    eyes = nr.get_points_from_angles(2.732, 20.0, torch.arange(count) * (360.0 / count))
    camera = nr.Camera.look_at(eyes, viewing_angle=20.0)
    options = {"light": None, "outputs": ("rgb",), "tile": 2048 if side >= STRIPS_FROM else None}

    def render(vertices: torch.Tensor) -> torch.Tensor:
        image: torch.Tensor = nr.render(nr.Mesh(vertices, faces, vertex_colors=colors), camera, side, **options).rgb
        return image

    def seconds(backward: bool) -> float:
        least = math.inf
        for _ in range(2):
            started = time.process_time()
            if backward:
                torch.autograd.grad(render(leaf).sum(), leaf)
            else:
                render(vertices)
            least = min(least, time.process_time() - started)
        return least

    leaf = vertices.clone().requires_grad_()
    times = [seconds(backward) for backward in ((False,) if options["tile"] else (False, True))]
    return [*times, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6]


if __name__ == "__main__":
    main()
