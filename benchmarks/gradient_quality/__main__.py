"""Measure, and write the report; see the package. Each renderer may run in an environment of its own.

``--json FILE`` keeps the numbers. A second run adds its renderers to the file, or replaces theirs, so that peers with
requirements of their own are measured one after the other. ``--report`` only prints what the file holds.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch

from .adapters import Adapter, available
from .practice import meshes, pose, silhouettes
from .quality import Quality
from .report import plot, table
from .scenes import difference, estimates, scenes
from .triangles import SIDES, WISHES, triangle_quality


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gradient_quality", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few shifts, starts and seconds: minutes in all")
    parser.add_argument("--only", nargs="*", help="renderers, by their names in the table")
    parser.add_argument("--parts", nargs="*", default=["triangles", "scenes", "poses", "shapes"])
    parser.add_argument("--scenes", nargs="*", help="only scenes with these words in their titles")
    parser.add_argument("--shifts", type=int, help="sub-pixel shifts, as far as the time permits")
    parser.add_argument("--starts", type=int, help="poses for each mesh, as far as the time permits")
    parser.add_argument("--report", action="store_true", help="measure nothing, show the file of --json")
    parser.add_argument("--json", type=Path, help="add the numbers to this file")
    parser.add_argument("--plot", type=Path, help="draw the figure here, as PNG or SVG (needs matplotlib)")
    options = parser.parse_args()
    torch.set_num_threads(1)
    report: dict[str, Any] = {"rows": [], "poses": [], "shapes": []}
    if options.json and options.json.exists():
        report = json.loads(options.json.read_text())
    if not options.report:
        adapters, missing = available(options.only)
        for sentence in missing:
            print(sentence)
        for adapter in adapters:
            for part in options.parts:
                measure(adapter, report, part, options)
                if options.json:
                    options.json.write_text(json.dumps(report, indent=1) + "\n")
    print(table(report))
    if options.plot:
        plot(report, options.plot)


def measure(adapter: Adapter, report: dict[str, Any], part: str, options: argparse.Namespace) -> None:
    """Measure a renderer and replace its numbers in the report."""
    quick, starts = options.quick, options.starts or (10 if options.quick else 50)
    shifts, seconds = min(options.shifts or (64 if quick else 256), adapter.most_shifts), 20.0 if quick else 30.0
    report["machine"] = f"{_processor()}, {platform.system()}, torch {torch.__version__}, one thread"
    if part == "triangles":
        for side in SIDES:
            most = shifts if side < 256 else min(shifts, 64)
            count = _affordable(partial(triangle_quality, side, "shrink", adapter, 1), most, seconds)
            if count < 4:
                print(
                    f"{adapter.name}: triangle of {side} px: skipped, 4 images take longer than {seconds:.0f} seconds"
                )
                continue
            for wish in WISHES:
                began = time.process_time()
                found = triangle_quality(side, wish, adapter, count)
                _add(report, adapter, f"triangle of {side} px", wish, found, count, time.process_time() - began)
    if part == "scenes":
        for title, scene in scenes().items():
            if options.scenes and not any(word in title for word in options.scenes):
                continue
            count = _affordable(partial(estimates, scene, adapter, 1), shifts, seconds)
            if count < 4:
                print(f"{adapter.name}: {title}: skipped, 4 images take longer than {seconds:.0f} seconds")
                continue
            began = time.process_time()
            samples = estimates(scene, adapter, count)
            taken = time.process_time() - began
            for name in scene.parameters:
                order, truth = _truth(report, title, name, scene, quick)
                quality = Quality.of(samples[name][:, order], truth)
                _add(report, adapter, title, name, quality, len(samples[name]), taken)
    if part in ("poses", "shapes"):
        report[part] = [row for row in report[part] if row["renderer"] != adapter.name]
        rows = [pose(adapter, name, starts, 3 * seconds) for name in meshes()] if part == "poses" else []
        rows += [silhouettes(adapter, 5.0 if quick else 20.0)] if part == "shapes" else []
        report[part] += [{"renderer": adapter.name, **row} for row in rows]
        print(*report[part][-len(rows) :], sep="\n", flush=True)


def _affordable(measure_once: Callable[[], Any], most: int, seconds: float) -> int:
    """Compute how many measurements fit in the time, at most so many; the first one may compile."""
    measure_once()
    began = time.process_time()
    measure_once()
    return min(most, int(seconds / max(time.process_time() - began, 1e-6)))


def _truth(report: dict[str, Any], title: str, name: str, scene: Any, quick: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute finite differences, or read them from the report if they are there for this very scene."""
    supersampling, most = (16, 12) if quick else (32, 24)
    with torch.no_grad():
        picture = scene.build(**scene.parameters)
    check = float(picture.vertices.sum() + picture.colors.sum() + picture.size)
    key = {
        "scene": title,
        "of": name,
        "supersampling": min(supersampling, scene.supersampling),
        "check": round(check, 6),
    }
    for row in report.setdefault("truths", []):
        if {part: row[part] for part in key} == key and len(row["order"]) >= min(most, scene.parameters[name].numel()):
            return torch.tensor(row["order"]), torch.tensor(row["slopes"], dtype=torch.float64)
    order, slopes = difference(scene, name, supersampling, most)
    report["truths"].append({**key, "order": order.tolist(), "slopes": slopes.tolist()})
    return order, slopes


def _processor() -> str:
    """Name the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _add(
    report: dict[str, Any], adapter: Adapter, scene: str, of: str, found: Quality, shifts: int, seconds: float
) -> None:
    key = {"scene": scene, "of": of, "renderer": adapter.name}
    report["rows"] = [row for row in report["rows"] if {name: row[name] for name in key} != key]
    report["rows"].append({**key, **vars(found), "shifts": shifts, "seconds": seconds / shifts})
    print(f"{adapter.name}: {scene}, {of}: size {found.size:.3f} ± {found.interval:.3f}, cosine {found.cosine:.4f}, "
          f"noise {found.noise:.3f}, {1e3 * seconds / shifts:.1f} ms", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
