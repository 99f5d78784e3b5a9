"""Measure, and write the report; see the package. Each renderer may run in an environment of its own.

``--json FILE`` keeps the numbers. A second run adds its renderers to the file, or replaces theirs, so that peers with
requirements of their own are measured one after the other. ``--report`` only prints what the file holds.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
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
    parser.add_argument("--parts", nargs="*", default=["triangles", "scenes", "practice"])
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
            measure(adapter, report, options.parts, options.quick)
            if options.json:
                options.json.write_text(json.dumps(report, indent=1) + "\n")
    print(table(report))
    if options.plot:
        plot(report, options.plot)


def measure(adapter: Adapter, report: dict[str, Any], parts: list[str], quick: bool) -> None:
    """Measure a renderer and replace its numbers in the report."""
    shifts = min(64 if quick else 256, adapter.most_shifts)
    slow = adapter.most_shifts < 1000
    report["machine"] = f"{platform.machine()}, {platform.system()}, torch {torch.__version__}, one thread"
    if "triangles" in parts:
        for side in SIDES[:-2] if slow else SIDES[:-1] if quick else SIDES:
            count = shifts if side < 256 else min(shifts, 64)
            for wish in WISHES:
                began = time.process_time()
                found = triangle_quality(side, wish, adapter, count)
                _add(report, adapter, f"triangle of {side} px", wish, found, (time.process_time() - began) / count)
    if "scenes" in parts:
        for title, scene in scenes(quick).items():
            began = time.process_time()
            samples = estimates(scene, adapter, shifts)
            seconds = (time.process_time() - began) / shifts
            for name in scene.parameters:
                order, truth = _truth(report, title, name, scene, quick)
                _add(report, adapter, title, name, Quality.of(samples[name][:, order], truth), seconds)
    if "practice" in parts:
        for kind in ("poses", "shapes"):
            report[kind] = [row for row in report[kind] if row["renderer"] != adapter.name]
        starts = (2 if slow else 10) if quick else 4 if slow else 50
        for name in meshes():
            report["poses"].append({"renderer": adapter.name, **pose(adapter, name, starts)})
        seconds = 5.0 if quick else 20.0
        report["shapes"].append({"renderer": adapter.name, **silhouettes(adapter, seconds)})


_truths: dict[tuple[str, str], tuple[torch.Tensor, torch.Tensor]] = {}


def _truth(report: dict[str, Any], title: str, name: str, scene: Any, quick: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute finite differences once."""
    key = title, name
    if key not in _truths:
        _truths[key] = difference(scene, name, 16 if quick else 32, 12 if quick else 24)
    return _truths[key]


def _add(report: dict[str, Any], adapter: Adapter, scene: str, of: str, found: Quality, seconds: float) -> None:
    key = {"scene": scene, "of": of, "renderer": adapter.name}
    report["rows"] = [row for row in report["rows"] if {name: row[name] for name in key} != key]
    report["rows"].append({**key, **vars(found), "seconds": seconds})
    print(f"{adapter.name}: {scene}, {of}: size {found.size:.3f} ± {found.interval:.3f}, cosine {found.cosine:.4f}, "
          f"noise {found.noise:.3f}, {1e3 * seconds:.1f} ms", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
