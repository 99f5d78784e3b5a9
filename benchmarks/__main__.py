"""Times of the renderer, forward and backward, for several batches, sizes, faces and threads: ``python -m benchmarks``.

Prints two tables with the name of the hardware; ``--json`` writes the numbers to a file. The first table shows times of
the public function without anti-aliasing, with "nmr": medians over ``--repeats`` runs after a warm-up. The cases take
turns. The second table has the ratios of `benchmarks.ratios` and `benchmarks.colors`, as Markdown.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import warp as wp
from rich.console import Console
from rich.table import Table

import neural_renderer as nr

from . import colors
from .ratios import all_ratios
from .scenes import noisy_icospheres

GRADIENT = "nmr"  # the estimator of all cases
# (output, images, side, icosphere level, both sides)
CASES = [
    ("silhouettes", 64, 128, 3, False),
    ("silhouettes", 8, 256, 3, False),
    ("silhouettes", 1, 512, 6, False),
    ("silhouettes", 4, 448, 4, True),
    ("rgb", 4, 448, 4, True),
    ("depth", 8, 256, 3, False),
    ("silhouettes", 1, 1024, 1, False),
]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--threads", type=int, nargs="*", help="CPU threads to try (default: 1 and all)")
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument(
        "--large", action="store_true", help="also 1.3 million faces with both estimators: minutes more"
    )
    parser.add_argument("--only-ratios", action="store_true", help="without the first table")
    parser.add_argument("--json", type=Path, help="also write the JSON here")
    parser.add_argument("--before", type=Path, help="JSON of an earlier version, whose ratios stand beside these")
    options = parser.parse_args()
    report = {"hardware": hardware(options.device), "versions": versions(), "cases": [], "ratios": []}
    if not options.only_ratios:
        time_cases(report, options.device, options.threads, options.repeats)
    if options.device == "cpu":
        print(f"\n{report['hardware']['name']}, {report['hardware']['cores']} cores\n")
        known = json.loads(options.before.read_text())["ratios"] if options.before else []
        before = {subject: measured for subject, measured, _ in known}
        print("| what | before | measured | asked for |\n|---|---:|---:|---:|")
        rounds = max(2, options.repeats // 2)
        for row in itertools.chain(all_ratios(rounds, options.large), colors.rows(rounds)):
            cells = row[0], before.get(row[0], "–"), *row[1:]
            print("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |", flush=True)
            report["ratios"].append(row)
    text = json.dumps(report, indent=2)
    if options.json:
        options.json.write_text(text + "\n")


def time_cases(report: dict[str, Any], device: str, threads: list[int] | None, repeats: int) -> None:
    """Measure CASES, add them to the report, and print their table."""
    all_threads = torch.get_num_threads()
    threads = threads or ([all_threads] if device != "cpu" else sorted({1, all_threads}))
    console = Console()
    table = Table(title=f'neural_renderer {nr.__version__} on {report["hardware"]["name"]}, "{GRADIENT}", milliseconds')
    for column in ("drawn", "images", "size", "faces", "sides", "threads", "forward", "forward + backward"):
        table.add_column(column, justify="right")
    started = time.perf_counter()
    work(*CASES[0], device)[1]()
    synchronize(device)
    report["first_call_s"] = round(time.perf_counter() - started, 2)
    both_ways = [work(*case, device) for case in CASES]
    for (case, count), (forward, both) in zip(
        ((case, count) for case in CASES for count in threads),
        measure(both_ways, threads, device, repeats),
        strict=True,
    ):
        drawn, batch, size, level, two_sided = case
        row = {
            "drawn": drawn, "images": batch, "size": size, "faces": 20 * 4**level, "two_sided": two_sided,
            "threads": count, "forward_ms": round(forward, 2), "forward_backward_ms": round(both, 2),
        }  # fmt: skip
        report["cases"].append(row)
        sides = "2" if two_sided else "1"
        cells = (drawn, batch, f"{size}²", row["faces"], sides, count, f"{forward:.1f}", f"{both:.1f}")
        table.add_row(*map(str, cells))
    torch.set_num_threads(all_threads)
    console.print(table)
    console.print(f"first call, compilation or cache included: {report['first_call_s']} s")
    if sys.platform != "win32":
        import resource

        report["peak_memory_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


Work = Callable[[], object]


def work(drawn: str, batch: int, size: int, level: int, two_sided: bool, device: str) -> tuple[Work, Work]:
    """Make two functions: the forward pass without gradients, and forward and backward."""
    faces = noisy_icospheres(batch, level, device=device).requires_grad_()
    options = {
        "outputs": (OUTPUT[drawn],),
        "two_sided": two_sided,
        "anti_aliasing": False,
        "eps": 1e-3,
        "gradient": GRADIENT,
    }
    leaves = [faces]
    if drawn == "rgb":
        leaves.append(torch.rand(batch, faces.shape[1], 4, 4, 4, 3, device=device, requires_grad=True))
        options["textures"] = leaves[1]
    generator = torch.Generator().manual_seed(1)
    shape = (batch, 3, size, size) if drawn == "rgb" else (batch, size, size)
    grad = torch.randn(shape, generator=generator).to(device)

    def draw() -> torch.Tensor:
        return getattr(nr.rasterize_images(faces, size, **options), OUTPUT[drawn])

    def forward() -> None:
        with torch.no_grad():
            draw()

    def both() -> None:
        for leaf in leaves:
            leaf.grad = None
        draw().backward(grad)

    return forward, both


OUTPUT = {"silhouettes": "alpha", "rgb": "rgb", "depth": "depth"}


def measure(works: list[tuple[Work, Work]], threads: list[int], device: str, repeats: int) -> list[tuple[float, float]]:
    """Measure the median milliseconds of each work with each number of threads.

    Every round runs all works once, so that other programs on the machine slow all of them alike, and ratios hold.
    """
    times: list[list[list[float]]] = [[[], []] for _ in works for _ in threads]
    for turn in range(repeats + 1):
        slots = iter(times)
        for both_ways in works:
            for count in threads:
                torch.set_num_threads(count)
                for once, taken in zip(both_ways, next(slots), strict=True):
                    synchronize(device)
                    started = time.perf_counter()
                    once()
                    synchronize(device)
                    if turn > 0:  # the first warms up
                        taken.append(1000 * (time.perf_counter() - started))
    return [(statistics.median(forward), statistics.median(both)) for forward, both in times]


def synchronize(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize()


def hardware(device: str) -> dict[str, object]:
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = [
            line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        name = models[0] if models else name
    if device != "cpu":
        name = torch.cuda.get_device_name(device)
    return {"name": name, "cores": os.cpu_count(), "system": platform.system()}


def versions() -> dict[str, str]:
    return {
        "neural_renderer": nr.__version__, "torch": torch.__version__, "warp": wp.config.version,
        "python": platform.python_version(),
    }  # fmt: skip


if __name__ == "__main__":
    main()
