"""Tables of scores in the layout of the paper's Table 1: a row per method, blocks of seven classes, the mean last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich import box
from rich.table import Table

from .evaluate import Scores

_COLUMNS = 7
_BETTER = {"voxel_iou": max, "silhouette_iou": max, "chamfer": min}
TITLES = {
    "voxel_iou": "Voxel IoU at 32³ (higher is better)",
    "silhouette_iou": "Silhouette IoU at 64 pixels (higher is better)",
    "chamfer": "Chamfer distance of surfaces, longest side 1 (lower is better)",
}


def blocks(
    methods: Mapping[str, Scores], measure: str = "voxel_iou", columns_each: int = _COLUMNS
) -> list[list[list[str]]]:
    """Lay out a table in blocks of classes; each has rows of cells: a header, then a row per method.

    The best value of a column is marked with ``**``.
    """
    classes = list(next(iter(methods.values())).objects)
    columns = [(name, {label: scores.of_class(name, measure) for label, scores in methods.items()}) for name in classes]
    columns.append(("mean", {label: scores.mean(measure) for label, scores in methods.items()}))
    parts = [columns[begin : begin + columns_each] for begin in range(0, len(columns), columns_each)]
    if len(parts) > 1 and len(parts[-1]) == 1:  # the mean is not alone in a block, as in the paper
        parts[-2:] = [parts[-2] + parts[-1]]
    return [
        [["", *(name for name, _ in part)]]
        + [[label, *(_cell(values, label, measure) for _, values in part)] for label in methods]
        for part in parts
    ]


def _cell(values: Mapping[str, float], label: str, measure: str) -> str:
    """Format the value of a method; the best one gets ``**``."""
    text = f"{values[label]:.4f}"
    best = f"{_BETTER[measure](values.values()):.4f}"
    return f"**{text}**" if len(values) > 1 and text == best else text


def markdown(methods: Mapping[str, Scores], measures: Sequence[str] = tuple(TITLES)) -> str:
    """Format tables of all measures as Markdown."""
    text = []
    for measure in measures:
        text.append(f"{TITLES[measure]}\n")
        for header, *rows in blocks(methods, measure):
            lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
            text.append("".join("| " + " | ".join(line) + " |\n" for line in lines))
    return "\n".join(text)


def terminal(methods: Mapping[str, Scores], measure: str = "voxel_iou", width: int = 80) -> list[Table]:
    """Format one measure for a terminal of ``width`` characters, a table per block."""
    for columns_each in range(_COLUMNS, 0, -1):
        parts = blocks(methods, measure, columns_each)
        if all(
            sum(max(len(c.strip("*")) for c in column) + 3 for column in zip(*p, strict=True)) <= width for p in parts
        ):
            break
    tables = []
    for number, (header, *rows) in enumerate(parts):
        title = TITLES[measure] if number == 0 else None
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
        for index, name in enumerate(header):
            table.add_column(name, justify="right" if index else "left", no_wrap=True)
        for row in rows:
            table.add_row(*(f"[bold]{cell[2:-2]}[/bold]" if cell.startswith("**") else cell for cell in row))
        tables.append(table)
    return tables
