"""Fits to photographs of others: ``python -m benchmarks.strangers FOLDER [FOLDER …] -o OUT [-- OPTIONS]``.

Each folder of photographs is fitted by the command, into a folder of its name in OUT. Printed are the number of
photographs and of those placed, the verdict with its reasons, the PSNR, processor seconds, and the largest memory. A
sheet in OUT shows a photograph, its mask, the mesh, and the mesh without texture, for each fit of an object: the
verdict has to be that of a person who looks at it.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

from PIL import Image

from neural_renderer.apps.common.pictures.sheet import sheet

from .photographs_sheet import pictures


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strangers", description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+", help="folders of photographs")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the results")
    parser.add_argument("--view", type=int, default=3, help="number of the photograph on the sheet")
    arguments = sys.argv[1:]
    end = arguments.index("--") if "--" in arguments else len(arguments)
    options = parser.parse_args(arguments[:end])
    rows = []
    for folder in options.folders:
        output = options.output / folder.name
        print(measure(folder, output, arguments[end + 1 :]), flush=True)
        if (output / "mesh.glb").is_file() and (output / "masks").is_dir():
            rows.append(pictures(output, options.view, 220))
    if rows:
        Image.fromarray(sheet(rows).numpy()).save(options.output / "sheet.jpg", quality=85)


def measure(folder: Path, output: Path, options: list[str]) -> dict[str, Any]:
    """Fit a folder of photographs, with options of the command, and collect the figures of its report."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "neural_renderer", "fit", str(folder), "-o", str(output), "--turntable", "0"]
    done = subprocess.run([*command, "--force", *options], capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    row: dict[str, Any] = {"photographs": folder.name, "exit code": done.returncode}
    row["processor seconds"] = round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    row["largest memory so far, GB"] = round(after.ru_maxrss / 2**20, 1)  # of all children
    if done.returncode not in (0, 3):
        return row | {"message": done.stderr.strip().splitlines()[-1:]}
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    found = report.get("photographs", {})
    row |= {"number": found.get("photographs"), "placed": found.get("placed"), "surface": found.get("surface")}
    row |= {"verdict": report["verdict"], "reasons": [reason["text"] for reason in report.get("reasons", [])]}
    return row | {name: report[name]["psnr"]["mean"] for name in ("fitted", "held_out") if name in report}


if __name__ == "__main__":
    main()
