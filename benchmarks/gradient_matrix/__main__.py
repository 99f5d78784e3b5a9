"""Measure the matrix, and print it as a table; see the package.

``--json FILE`` keeps the numbers, and replaces those of cells that are measured again. ``--report`` shows the file.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import torch

from .cases import cases
from .measure import OUTPUTS, Cell, backward, differences, drawing, forward
from .others import OTHERS
from .report import failures, plot, table


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gradient_matrix", description=__doc__)
    parser.add_argument("--cases", nargs="*", help="only these cases")
    parser.add_argument("--outputs", nargs="*", default=OUTPUTS, help="only these outputs")
    parser.add_argument("--side", type=int, default=8, help="root of the number of shifts in each of four groups")
    parser.add_argument("--fine", type=int, default=16, help="root of the number of shifts of differences")
    parser.add_argument("--estimators", nargs="*", default=["edge", *OTHERS], help="only these estimators")
    parser.add_argument("--json", type=Path, help="add the numbers to this file")
    parser.add_argument("--plot", type=Path, help="draw the figure here (needs matplotlib)")
    parser.add_argument("--report", action="store_true", help="measure nothing, show the file of --json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows: list[dict[str, Any]] = []
    if options.json and options.json.exists():
        rows = json.loads(options.json.read_text())["rows"]
    for name in () if options.report else options.cases or cases():
        for output in options.outputs:
            found = measured(name, output, options.estimators, options.side, options.fine)
            keys = {_key(row) for row in found}
            rows = [row for row in rows if _key(row) not in keys] + found
            if options.json:
                text = ",\n".join(json.dumps(row) for row in rows)
                options.json.write_text(f'{{"torch": "{torch.__version__}", "rows": [\n{text}\n]}}\n')
    print(table(rows))
    for sentence in failures(rows):
        print(sentence)
    if options.plot:
        plot(rows, options.plot)


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("case", "output", "estimator", "anti_aliased", "mode"))


def measured(name: str, output: str, estimators: list[str], side: int, fine: int) -> list[dict[str, Any]]:
    """Measure the cells of one output of a case: each estimator, plain and anti-aliased, backward and forward."""
    case = cases()[name]()
    truth = differences(case, drawing(case, output), fine, 2)
    side = int(side * case.samples**0.5)
    rows = []

    def add(estimator: str, anti_aliased: bool, mode: str, cell: Cell) -> None:
        key = {"case": name, "output": output, "estimator": estimator, "anti_aliased": anti_aliased, "mode": mode}
        rows.append({**key, **{part: round(value, 5) for part, value in cell.row().items()}})

    for anti_aliased in (False, True) if "edge" in estimators else ():
        draw = drawing(case, output, anti_aliasing=anti_aliased)
        add("edge", anti_aliased, "backward", Cell.of(backward(case, draw, side, 4), truth, 4 * side**2))
        ahead = max(side // 2, 3)
        add("edge", anti_aliased, "forward", Cell.of(forward(case, draw, ahead, 3), truth, 3 * ahead**2))
    for estimator, make in OTHERS.items():
        other = make(case, output) if estimator in estimators else None
        if other is not None:
            few = min(side, 8)
            add(estimator, False, "backward", Cell.of(backward(case, other, few, 2), truth, 2 * few**2))
    print(*(f"{row['case']}, {output}, {row['estimator']}, {row['mode']}: {row['ratio']} ± {row['noise']}, cosine "
            f"{row['cosine']}" for row in rows), sep="\n", flush=True)  # fmt: skip
    return rows


if __name__ == "__main__":
    main()
