"""The matrix as a table in Markdown and as a figure, and the cells that fail."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from .limits import limit
from .measure import OUTPUTS, Cell

Row = dict[str, Any]


def cell_of(row: Row) -> Cell:
    """Make the cell of a row of the file."""
    return Cell(*(row[name] for name in ("ratio", "noise", "cosine", "spread", "shifts")))


def columns(rows: list[Row]) -> list[tuple[str, bool, str]]:
    """List estimators with their modes: (estimator, anti-aliased, mode)."""
    return list(dict.fromkeys((row["estimator"], row["anti_aliased"], row["mode"]) for row in rows))


def title(column: tuple[str, bool, str]) -> str:
    """Name a column."""
    estimator, anti_aliased, mode = column
    if estimator != "edge":
        return estimator
    return ("anti-aliased" if anti_aliased else "plain") + (", forward" if mode == "forward" else "")


def table(rows: list[Row]) -> str:
    """Make a table: ratio ± standard error and cosine; a cell that fails has an exclamation mark."""
    kinds = columns(rows)
    lines = ["| case | output | " + " | ".join(map(title, kinds)) + " |", "|---|---|" + "---:|" * len(kinds)]
    for case, output in dict.fromkeys((row["case"], row["output"]) for row in rows):
        found = {
            (r["estimator"], r["anti_aliased"], r["mode"]): r
            for r in rows
            if (r["case"], r["output"]) == (case, output)
        }
        lines.append(f"| {case} | {output} | " + " | ".join(_text(found.get(kind)) for kind in kinds) + " |")
    return "\n".join(lines)


def _text(row: Row | None) -> str:
    if row is None or math.isnan(row["ratio"]):
        return ""
    mark = "!" if row["estimator"] == "edge" and fails(row) else ""
    return f"{row['ratio']:.3f} ± {row['noise']:.3f}, {row['cosine']:.4f}{mark}"


def fails(row: Row) -> bool:
    """Test whether a cell is off by more than its noise and its limit allow."""
    bound = limit(row["case"], row["output"], row["anti_aliased"])
    return not math.isnan(row["ratio"]) and cell_of(row).fails(bound.error, bound.turn, bound.size)


def failures(rows: list[Row]) -> list[str]:
    """Say which cells of "edge" fail."""
    return [
        f"fails: {row['case']}, {row['output']}, {title((row['estimator'], row['anti_aliased'], row['mode']))}"
        for row in rows
        if row["estimator"] == "edge" and fails(row)
    ]


def plot(rows: list[Row], path: Path) -> None:
    """Draw a square for each cell in the colour of its ratio, with a ring if it fails without limits."""
    import matplotlib.pyplot as plt

    kinds = columns(rows)
    names = list(dict.fromkeys(row["case"] for row in rows))
    known = {(r["case"], r["output"], r["estimator"], r["anti_aliased"], r["mode"]): r for r in rows}
    figure, axes = plt.subplots(1, len(kinds), figsize=(1.6 + 1.55 * len(kinds), 0.34 * len(names) + 1.5), sharey=True)
    for axis, kind in zip(axes, kinds, strict=True):
        ratios = [[_ratio(known.get((name, output, *kind))) for output in OUTPUTS] for name in names]
        shown = axis.imshow(ratios, cmap="RdBu", vmin=0.8, vmax=1.2, aspect="equal")
        axis.set_facecolor("0.85")
        for y, name in enumerate(names):
            for x, output in enumerate(OUTPUTS):
                row = known.get((name, output, *kind))
                if row is None or math.isnan(row["ratio"]):
                    continue
                if row["ratio"] < 0.5 or row["ratio"] > 1.5:
                    axis.text(x, y, f"{row['ratio']:.1f}", ha="center", va="center", fontsize=5, color="white")
                elif cell_of(row).fails():
                    axis.plot(x, y, "o", color="black", markersize=4, markerfacecolor="none")
        axis.set_xticks(range(len(OUTPUTS)), OUTPUTS, rotation=90, fontsize=7)
        axis.set_yticks(range(len(names)), names, fontsize=7)
        axis.set_title(title(kind).replace(", ", "\n").replace(" (ours)", "\n(ours)"), fontsize=8)
        axis.tick_params(length=0)
    bar = figure.colorbar(shown, ax=axes, shrink=0.6, pad=0.01, extend="both")
    bar.set_label("size of the gradient (1 is right)", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    figure.savefig(path, dpi=150, bbox_inches="tight")
    plt.close(figure)


def _ratio(row: Row | None) -> float:
    return math.nan if row is None else row["ratio"]
