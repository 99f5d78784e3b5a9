"""Help, wrong options, missing inputs, unwritable outputs and missing extras are answered before torch is imported."""

from __future__ import annotations

import json
from pathlib import Path

from neural_renderer.apps import command_line
from neural_renderer.apps.commands import COMMANDS
from neural_renderer.base.extras import advice
from tests.programs import run_python

TRIANGLE = "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n"
# Of each command: a line with a missing input, one whose output lies below a file, and one that needs an extra.
# mesh.obj, picture.png, table.csv, data and photos exist.
LINES: dict[str, tuple[str, str, str, str]] = {
    "render": ("nope.obj -o a.png", "mesh.obj -o mesh.obj/a.png", "OpenEXR", "mesh.obj --save depth d.exr"),
    "compare": ("mesh.obj nope.obj", "mesh.obj mesh.obj -o mesh.obj/a.png", "", ""),
    "fit": ("nope -o out", "photos --cameras file -o mesh.obj/out", "pycolmap", "photos -o out"),
    "finish": ("nope.obj -o a.glb", "mesh.obj -o mesh.obj/a.glb", "fast_simplification", "mesh.obj -o a.glb"),
    "pose": (
        "mesh.obj nope.png -o out",
        "mesh.obj picture.png -o mesh.obj/out",
        "viser",
        "mesh.obj picture.png -o out --view",
    ),
    "dataset": ("nope.obj -o out", "mesh.obj --index csv -o mesh.obj/out", "pyarrow", "mesh.obj -o out"),
    "batch": ("fit nope.csv -o out", "fit table.csv -o mesh.obj/out", "ray", "fit table.csv -o out --engine ray"),
    "style": (
        "mesh.obj nope.png -o out",
        "mesh.obj picture.png -o mesh.obj/out",
        "safetensors",
        "mesh.obj picture.png -o out --weights a.safetensors",
    ),
    "dream": ("nope.obj -o out", "mesh.obj -o mesh.obj/out", "viser", "mesh.obj -o out --view"),
    "view": ("nope.obj", "mesh.obj --no-browser --record mesh.obj/out.html", "viser", "mesh.obj"),
    "run": ("nope.py", "", "", ""),
    "demo": ("", "-o mesh.obj/out", "", ""),
    "reconstruct dataset": ("nope out", "data mesh.obj/out", "ray", "data out --engine ray"),
    "reconstruct train": ("nope out", "data mesh.obj/out", "lightning", "data out"),
    "reconstruct pretrain": ("out --models nope", "mesh.obj/out", "", ""),
    "reconstruct evaluate": ("nope.ckpt data", "shipped data -o mesh.obj/out", "", ""),
    "reconstruct predict": ("nope.png -o out", "picture.png -o mesh.obj/out", "viser", "picture.png -o out --view"),
}
PROGRAM = """
import contextlib, io, json, os, sys
from neural_renderer.apps import command_line

os.chdir(sys.argv[2])
for arguments, library, expected, sentence in json.loads(sys.argv[1]):
    if library:
        sys.modules[library] = None
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = command_line.main(arguments)
    if library:
        del sys.modules[library]
    assert code == expected, (arguments, code, said.getvalue())
    assert sentence in said.getvalue(), (arguments, said.getvalue())
    slow = {"torch", "warp", "numpy", "PIL"} & set(sys.modules)
    assert not slow, f"{arguments}: imported {slow}"
"""


def test_every_command_that_checks_its_options_has_a_line() -> None:
    for name in command_line.command_names():
        group, _, part = name.partition(" ")
        options = getattr(command_line._load(COMMANDS[group].options), f"{(part or group).capitalize()}Options")
        assert name in LINES or not hasattr(options, "validate"), name
    assert set(LINES) <= set(command_line.command_names())


def test_answers_before_torch_is_imported(tmp_path: Path) -> None:
    for name in ("mesh.obj", "picture.png", "table.csv", "a.safetensors", "photos/1.jpg", "photos/2.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(TRIANGLE)
    (tmp_path / "data").mkdir()
    asked: list[tuple[list[str], str, int, str]] = [([], "", 0, "COMMAND"), (["--version"], "", 0, "neural-renderer")]
    asked += [(["nonsense"], "", 2, "nonsense"), (["reconstruct"], "", 0, "predict")]
    for name in command_line.command_names():
        command, (missing, output, library, without) = name.split(), LINES.get(name, ("", "", "", ""))
        asked += [([*command, "--help"], "", 0, "Example:"), ([*command, "--nonsense"], "", 2, "")]
        if missing:
            asked.append(([*command, *missing.split()], "", 1, "nope"))
        if output:
            asked.append(([*command, *output.split()], "", 1, "expected a folder that can be written"))
        if library:
            asked.append(([*command, *without.split()], library, 1, advice(library)))
    done = run_python("-c", PROGRAM, json.dumps(asked), tmp_path)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "out").exists()
