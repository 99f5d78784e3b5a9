"""Each word of a text file, made long and with a control character: sentences quote it short and printable."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.many.commands.jobs import read_jobs
from neural_renderer.apps.many.models import list_models, opened
from neural_renderer.camera.files.load import load_cameras
from tests.fuzz.kinds import FILES, write_lists
from tests.test_hostile_files import Kind

WORD = re.compile(rb"(?<!\w)[A-Za-z][^\s\",:{}\[\]#<>=;]*|(?<![\w.-])\d+")
TEXTS = (".obj", ".mtl", ".ply", ".off", ".gltf", ".json", ".csv", ".txt")
LONG, LARGE = "w" * 3000, b"7" * 2000
MOST = 24  # words of a file
MATRIX = [[20, 0, 8], [0, 20, 8], [0, 0, 1]]
CAMERAS = {
    "bop.json": {"0": {"cam_K": MATRIX, "cam_R_w2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_w2c": [0, 0, 3]}},
    "hand.json": {"K": MATRIX, "views": [{"file": "a.png", "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [0, 0, 3]}]},
    "eyes.json": {"cameras": [{"eye": [0, 0, -3], "viewing_angle": 30, "convention": "opengl", "width": 16}]},
}


def write_cameras(folder: Path) -> list[str]:
    for name, content in CAMERAS.items():
        (folder / name).write_text(json.dumps(content))
    (folder / "a_par.txt").write_text("1\na.png 20 0 8 0 20 8 0 0 1 1 0 0 0 1 0 0 0 1 0 0 3\n")
    return [*CAMERAS, "a_par.txt"]


def read_cameras(folder: Path) -> None:
    for path in folder.iterdir():
        load_cameras(path, (16, 16))


def write_tables(folder: Path) -> list[str]:
    (folder / "jobs.csv").write_text("images,name,steps\na.png,a,9\n")
    (folder / "points.json").write_text('[{"hand": [1, 2.5, 1]}]')
    return [*write_lists(folder), "jobs.csv", "points.json"]


def read_tables(folder: Path) -> None:
    for name in ("l.txt", "l.csv"):
        for model in list_models([folder / name]):
            with opened(model):
                pass
    read_jobs(folder / "jobs.csv", "fit")
    nr.load_keypoints(folder / "points.json")


KINDS = {name: FILES[name] for name in ("obj", "ply", "off", "gltf", "views", "data", "results", "colmap")}
KINDS |= {"cameras": Kind(write_cameras, read_cameras), "tables": Kind(write_tables, read_tables)}


LATER = ("obj", "gltf", "results")  # take seconds


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LATER)) for name in KINDS])
def test_long_words(name: str, tmp_path: Path) -> None:
    torch.manual_seed(0)
    for file in KINDS[name].write(tmp_path):
        path = tmp_path / file
        if path.suffix in TEXTS:
            in_each_word(path, lambda: KINDS[name].read(tmp_path))


def in_each_word(path: Path, read: Callable[[], None]) -> None:
    data, is_json = path.read_bytes(), path.suffix in (".json", ".gltf")
    long = f"{json.dumps(chr(27))[1:-1] if is_json else chr(27)}[31m{LONG}".encode()
    found = {word[0]: word for word in WORD.finditer(data)}
    for word in list(found.values())[:MOST]:
        changed = LARGE if word[0].isdigit() else long + word[0][-4:]  # with its suffix
        path.write_bytes(data[: word.start()] + changed + data[word.end() :])
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            said = []
            try:
                read()
            except (ValueError, OSError) as error:
                said = [str(error)]
        for message in (*said, *(str(note.message) for note in notes)):
            assert len(message) < 1000 and message.isprintable(), (word[0], message)
    path.write_bytes(data)
