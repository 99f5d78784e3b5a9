"""The table of the benchmark as Markdown, and its figure."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

COLORS = {
    "edge": "tab:blue",
    "nmr": "tab:red",
    "opendr": "tab:green",
    "reinforce": "tab:gray",
    "nvdiffrast AA (ours)": "tab:cyan",
    "DEODR": "tab:orange",
    "DRTK": "tab:brown",
    "PyTorch3D hard": "tab:pink",
    "PyTorch3D soft": "tab:olive",
    "Mitsuba 3": "tab:purple",
}
ORDER = tuple(COLORS)


def table(report: dict[str, Any]) -> str:
    """Make the tables: size ± interval, cosine, noise and time of each renderer; then practice."""
    rows = report["rows"]
    every = [*rows, *report.get("poses", []), *report.get("shapes", [])]
    names = [name for name in ORDER if any(row["renderer"] == name for row in every)]
    lines = ["| scene | of | " + " | ".join(names) + " |", "|---|---|" + "---:|" * len(names)]
    cases = list(dict.fromkeys((row["scene"], row["of"]) for row in rows))
    for scene, of in cases:
        cells = []
        for name in names:
            found = [r for r in rows if (r["scene"], r["of"], r["renderer"]) == (scene, of, name)]
            cells.append(_cell(found[0]) if found else "")
        lines.append(f"| {scene} | {of} | " + " | ".join(cells) + " |")
    lines += ["", *_practice(report, names)]
    return "\n".join(lines)


def _cell(row: dict[str, Any]) -> str:
    if abs(row["size"]) < 1e-6:
        return "0"
    digits = 2 if abs(row["size"]) < 10 else 0
    return f"{row['size']:.{digits}f} ± {row['interval']:.{digits}f}, {row['cosine']:.2f}, {row['noise']:.2g}"


def _practice(report: dict[str, Any], names: list[str]) -> list[str]:
    poses, shapes = report.get("poses", []), report.get("shapes", [])
    if not poses and not shapes:
        return []
    titles = list(dict.fromkeys(row["mesh"] for row in poses))
    lines = [
        "| renderer | "
        + " | ".join(f"pose of the {title}" for title in titles)
        + " | seconds a pose | IoU, steps | ms |"
    ]
    lines.append("|---|" + "---:|" * (len(titles) + 3))
    for name in names:
        own = {row["mesh"]: row for row in poses if row["renderer"] == name}
        cells = [_pose(own[t]) if t in own else "" for t in titles]
        mean = f"{sum(row['seconds'] for row in own.values()) / len(own):.2f}" if own else ""
        shape = [row for row in shapes if row["renderer"] == name]
        overlap = f"{shape[0]['iou']:.3f}, {shape[0]['steps']}" if shape else ""
        scenes = _of_scenes(report["rows"], name)
        time = f"{_mean([1e3 * row['seconds'] for row in scenes]):.0f}" if scenes else ""
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {mean} | {overlap} | {time} |")
    return lines


def _pose(row: dict[str, Any]) -> str:
    steps = f", {row['steps']:.0f}" if row["success"] else ""
    return f"{row['success']:.0%} of {row['starts']}{steps}"


def plot(report: dict[str, Any], path: Path) -> None:
    """Plot size against the size of triangles, and noise and direction against time over the scenes."""
    import matplotlib.pyplot as plt

    rows = report["rows"]
    names = [name for name in ORDER if any(row["renderer"] == name for row in rows)]
    colors = COLORS
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4))
    for n, name in enumerate(names):
        own = [r for r in rows if r["renderer"] == name and r["scene"].startswith("triangle") and r["of"] == "shrink"]
        # Side by side, for several are right.
        sides = [float(row["scene"].split()[2]) * 1.06 ** (n - len(names) / 2) for row in own]
        sizes = [row["size"] for row in own]
        left.errorbar(sides, sizes, [row["interval"] for row in own], marker="o", color=colors[name], label=name)
        scenes = [
            r
            for r in rows
            if r["renderer"] == name and r["of"] in ("vertices", "places", "eye", "move") and abs(r["size"]) > 1e-6
        ]
        if not scenes:
            continue
        time = _mean([row["seconds"] * 1e3 for row in scenes])
        middle.scatter(time, _mean([row["noise"] for row in scenes]), 90, color=colors[name])
        middle.annotate(
            name,
            (time, _mean([row["noise"] for row in scenes])),
            (-4, 9) if time > 100 else (8, -14 if name == "DEODR" else 6),
            textcoords="offset points",
            ha="right" if time > 100 else "left",
        )
        places = [names.index(name)] * len(scenes)
        right.plot(places, [row["cosine"] for row in scenes], "o", color=colors[name], alpha=0.5)
    left.set(
        xscale="log", yscale="log", xlabel="side of a lone triangle, pixels", ylabel="size of the gradient (1 is right)"
    )
    left.axhline(1, color="black", linewidth=0.8, zorder=0)
    left.set_ylim(0.1, 100)
    left.legend(frameon=False, ncols=2, loc="upper right")
    middle.set(xscale="log", yscale="log", xlabel="milliseconds, forward and backward", ylabel="noise of one sample")
    middle.margins(0.25)
    right.set_xticks(range(len(names)), names, rotation=30, ha="right")
    right.set_ylabel("cosine with the truth, one dot for each scene")
    right.axhline(1, color="black", linewidth=0.8, zorder=0)
    for axes in (left, middle, right):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def _of_scenes(rows: list[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """Choose a renderer's rows of scenes whose shape or camera moves, without those that it does not see at all."""
    moving = ("vertices", "places", "eye", "move")
    return [row for row in rows if row["renderer"] == name and row["of"] in moving and abs(row["size"]) > 1e-6]


def _mean(values: list[float]) -> float:
    """Compute the geometric mean."""
    return math.exp(sum(math.log(max(value, 1e-9)) for value in values) / len(values))
