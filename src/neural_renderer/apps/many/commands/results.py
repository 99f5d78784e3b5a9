"""Results of many runs: a table of their reports, and a sheet with pictures of their meshes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from torch import Tensor

from ....io import save_image
from ....io.atomic_write import write_file
from ....io.files import reason
from ....meshes.mesh import Mesh
from ...common.pictures.photograph import turntable
from ...common.pictures.sheet import sheet
from .jobs import Job, read_entry

TABLE, SHEET = "reports.csv", "sheet.png"
_LEFT_OUT = ("history", "settings", "inputs", "changes", "starts", "gains", "version")  # parts of a report
_MOST_ROWS = 40  # of the sheet
_PICTURES, _SIZE = 6, 160  # of a mesh; pixels


def write_table(folder: Path, jobs: Sequence[Job]) -> int:
    """Write a table of the numbers in all reports, one row per job; return the number of failures."""
    rows, failures = [], 0
    for job in jobs:
        entry = read_entry(folder, job)
        state = "not finished" if entry is None else "failed" if entry["problem"] else "finished"
        row: dict[str, Any] = {"name": job.name, "state": state}
        if entry is not None:
            row["problem"] = entry["problem"] or ("doubtful" if entry["code"] else "")
            failures += state == "failed"
        if state == "finished":
            with suppress(OSError, ValueError, TypeError, KeyError):
                text = (folder / job.name / "report.json").read_text(encoding="utf-8")
                report = json.loads(text)
                row = dict(_numbers(report)) | row
                row["problem"] = "; ".join(reason["text"] for reason in report.get("reasons", [])) or row["problem"]
        rows.append(row)
    columns = list(dict.fromkeys(["name", "state", "problem", *(name for row in rows for name in row)]))
    table = io.StringIO()
    writer = csv.DictWriter(table, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_file(folder / TABLE, table.getvalue())
    return failures


def _numbers(report: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in report.items():
        if isinstance(value, dict) and name not in _LEFT_OUT:
            yield from _numbers(value, f"{before}{name}.")
        elif isinstance(value, (bool, int, float, str)) and name not in _LEFT_OUT:
            yield before + name, value


def write_sheet(folder: Path, jobs: Sequence[Job]) -> bool:
    """Draw the meshes of the first forty jobs that have one, a row each; return whether there is any."""
    rows: list[list[Tensor]] = []
    labels = []
    for job in jobs:
        path = folder / job.name / "mesh.obj"
        path = path if path.is_file() else path.with_suffix(".glb")  # of `finish`
        entry = read_entry(folder, job)
        if entry is None or entry["problem"] or not path.is_file() or len(rows) == _MOST_ROWS:
            continue
        try:
            mesh = Mesh.load(path, normalize=True)
            rows.append([picture.cpu() for picture in turntable(mesh, _PICTURES, size=_SIZE)])
        except (OSError, ValueError) as error:
            raise ValueError(f"{path}: expected the mesh of a finished run ({reason(error)})") from None
        labels.append(job.name)
    if rows:
        save_image(folder / SHEET, sheet(rows, labels))
    return bool(rows)
