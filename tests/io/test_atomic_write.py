"""Files are whole or as they were, whatever happens while they are written."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.io import atomic_write
from neural_renderer.io.atomic_write import replacing, write_file, writing
from tests.faults import contents, full_disk

NOISE = torch.from_numpy(np.random.default_rng(0).random((4, 3, 60, 60), np.float32))  # which no format makes small
VERTICES, FACES = nr.icosphere(1)


def save_mesh(path: Path, color: float = 0.5) -> None:
    nr.save_mesh(path, VERTICES, FACES, torch.full((len(FACES), 2, 2, 2, 3), color))


def save_uv_mesh(path: Path) -> None:
    uv, image = VERTICES[FACES.long()][..., :2], NOISE[0].movedim(0, 2)
    index = torch.arange(len(FACES)) % 2
    colors = torch.zeros(len(FACES), 3, 3)
    nr.UVMesh(VERTICES, FACES, uv, index, (image, image), colors, ("repeat", "clamp")).save(path)


SAVES: dict[str, Callable[[Path], None]] = {
    "a.png": lambda path: nr.save_image(path, NOISE[0]),
    "a.jpg": lambda path: nr.save_image(path, NOISE[0]),
    "a.gif": lambda path: nr.save_animation(path, NOISE),
    "a.mp4": lambda path: nr.save_animation(path, NOISE),
    "a.obj": save_mesh,
    "a.ply": save_mesh,
    "a.glb": save_mesh,
    "uv.obj": save_uv_mesh,
    "uv.glb": save_uv_mesh,
    "old.obj": lambda path: nr.save_obj(path, VERTICES, FACES, torch.ones(len(FACES), 2, 2, 2, 3)),
    "a.txt": lambda path: write_file(path, "text" * 1000),
    "a.npz": lambda path: save_array(path),
}


def save_array(path: Path) -> None:
    with replacing(path) as fresh:
        np.savez(fresh, NOISE.numpy())


@pytest.mark.parametrize("name", SAVES)
def test_a_full_disk_leaves_what_was_there(tmp_path: Path, name: str) -> None:
    save, path = SAVES[name], tmp_path / "out" / name
    with full_disk(1000), pytest.raises(OSError, match=f"{name}: expected to write it, got: "):
        save(path)
    assert contents(tmp_path) == {}
    save(path)
    before = contents(tmp_path)
    with full_disk(1000), pytest.raises(OSError, match=f"{name}: expected to write it, got: ") as raised:
        save(path)
    # Another program writes the MP4, and NumPy does not pass the number of the error on.
    assert raised.value.errno == errno.EFBIG or name in ("a.mp4", "a.npy")
    assert contents(tmp_path) == before
    save(path)
    assert contents(tmp_path) == before and not list(tmp_path.glob("out/.*"))


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_mesh_and_its_texture_change_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, count: int
) -> None:
    """An error at any file of the set, before or after others were renamed, takes all of them back."""
    save_mesh(tmp_path / "a.obj")
    before = contents(tmp_path)
    assert set(before) == {"a.obj", "a.mtl", "a_texture.png"}
    real, calls = getattr(os, step), []

    def fails(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == count + 1:
            raise OSError(errno.EIO, "Input/output error")
        return real(*arguments)

    monkeypatch.setattr(os, step, fails)
    with pytest.raises(OSError, match=r"a\.obj: expected to write it, got: Input/output error"):
        save_mesh(tmp_path / "a.obj", 0.9)
    assert contents(tmp_path) == before
    calls.clear()
    with pytest.raises(OSError, match=r"new\.obj: expected to write it"):
        save_mesh(tmp_path / "new.obj")
    assert contents(tmp_path) == before


@pytest.mark.parametrize("count", [1, 2, 3])
def test_ctrl_c_between_two_renames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    save_mesh(tmp_path / "a.obj")
    before = contents(tmp_path)
    real, calls = os.replace, []

    def interrupted(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == count:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        save_mesh(tmp_path / "a.obj", 0.9)
    assert contents(tmp_path) == before


def test_without_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unsupported(*_: Any) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    save_mesh(tmp_path / "a.obj")
    before = contents(tmp_path)
    monkeypatch.setattr(os, "link", unsupported)
    real, calls = os.replace, []

    def fails(*arguments: Any) -> Any:
        calls.append(arguments)
        return unsupported() if len(calls) == 3 else real(*arguments)

    monkeypatch.setattr(os, "replace", fails)
    with pytest.raises(OSError, match=r"a\.obj"):
        save_mesh(tmp_path / "a.obj", 0.9)
    assert contents(tmp_path) == before


KILLED = """
import importlib.util, os, signal, sys
from pathlib import Path

spec = importlib.util.spec_from_file_location("atomic_write", sys.argv[1])  # without torch, which takes seconds
atomic_write = importlib.util.module_from_spec(spec)
spec.loader.exec_module(atomic_write)
real, calls = getattr(os, sys.argv[2]), []


def dies(*arguments):
    calls.append(arguments)
    if len(calls) == int(sys.argv[3]):
        os.kill(os.getpid(), signal.SIGKILL)
    return real(*arguments)


setattr(os, sys.argv[2], dies)
with atomic_write.replacing("a.obj") as fresh:
    fresh.write_text("new")
    fresh.with_name("a.mtl").write_text("new")
"""


@pytest.mark.skipif(os.name != "posix", reason="no SIGKILL")
@pytest.mark.parametrize(("step", "count"), [("fsync", 1), ("fsync", 2), ("replace", 1), ("replace", 2)])
def test_a_kill_leaves_what_was_there(tmp_path: Path, step: str, count: int) -> None:
    """The next write deletes what it leaves besides, and makes a set old again that is new in part."""
    for name in ("a.obj", "a.mtl"):
        (tmp_path / name).write_text("old")
    before = contents(tmp_path)
    command = [sys.executable, "-c", KILLED, atomic_write.__file__, step, str(count)]
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == -signal.SIGKILL
    found = contents(tmp_path)
    new = {"a.mtl": b"new"} if (step, count) == ("replace", 2) else {}
    assert {name: found[name] for name in before} == before | new
    left = set(found) - set(before)
    assert len(left) >= 2 and all(name.startswith(".neural_renderer-") for name in left)
    write_file(tmp_path / "b.txt", "b")
    assert contents(tmp_path) == before | {"b.txt": b"b"}


def test_what_others_write_is_not_swept(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.txt") as fresh:
        fresh.write_text("a")
        write_file(tmp_path / "b.txt", "b")
        elsewhere = tmp_path / ".neural_renderer-00000000-1-abc"
        elsewhere.mkdir()  # of a process on another machine
        write_file(tmp_path / "b.txt", "b")
        assert elsewhere.is_dir() and fresh.is_file()
    assert (tmp_path / "a.txt").read_text() == "a"


def test_threads_that_write_one_file(tmp_path: Path) -> None:
    texts = [str(number) * 200_000 for number in range(8)]
    threads = [threading.Thread(target=write_file, args=(tmp_path / "a.txt", text)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    assert (tmp_path / "a.txt").read_text() in texts


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    real, link = tmp_path / "real.txt", tmp_path / "link.png"
    real.write_text("old")
    real.chmod(0o640)
    link.symlink_to(real)
    write_file(link, "new")
    assert link.is_symlink() and real.read_text() == "new" and real.stat().st_mode & 0o777 == 0o640


def test_links_to_another_file_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "other").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to(tmp_path / "other" / "real.txt")
    real = os.replace

    def within_one(source: Path, target: Path) -> None:
        if (tmp_path / "other" in source.parents) != (tmp_path / "other" in target.parents):
            raise OSError(errno.EXDEV, "Invalid cross-device link")
        real(source, target)

    monkeypatch.setattr(os, "replace", within_one)
    for text in ("one", "two"):
        write_file(link, text)
        assert link.is_symlink() and contents(tmp_path / "other") == {"real.txt": text.encode()}


def test_what_is_changed_after_a_kill_stays(tmp_path: Path) -> None:
    staging = tmp_path / f".neural_renderer-{atomic_write._machine()}-{_dead_process()}-x"
    for name, text in (("old/a.mtl", "old"), ("new/a.obj", "new")):
        (staging / name).parent.mkdir(parents=True)
        (staging / name).write_text(text)
    (tmp_path / "a.mtl").write_text("somebody's")
    os.utime(staging / "old", (1, 1))
    write_file(tmp_path / "b.txt", "b")
    assert contents(tmp_path) == {"a.mtl": b"somebody's", "b.txt": b"b"}


def _dead_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_what_cannot_be_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "kept").write_text("kept")
    os.mkfifo(tmp_path / "pipe")
    for name, sentence in (
        ("folder", "Is a directory"),
        ("pipe", "not a regular file"),
        ("kept/b", "Not a directory|File exists"),
    ):
        with pytest.raises(OSError, match=f"{name}: expected to write it, got: ({sentence})"):
            write_file(tmp_path / name, "b")
    monkeypatch.setattr(atomic_write.os, "access", lambda *_: False)  # which root is never told
    with pytest.raises(OSError, match="kept: expected to write it, got: Permission denied"):
        write_file(tmp_path / "kept", "b")
    assert (tmp_path / "kept").read_text() == "kept" and not list(tmp_path.glob(".*"))


def test_nothing_but_the_file(tmp_path: Path) -> None:
    with (
        pytest.raises(OSError, match=r"a\.txt: expected to write it, got: No such file"),
        replacing(tmp_path / "a.txt"),
    ):
        pass  # the block forgot to write
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "a.txt") as fresh:
        fresh.write_text("half")
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_errors_name_the_file(tmp_path: Path) -> None:
    with (
        pytest.raises(OSError, match=r"log\.csv: expected to write it, got: No space left") as raised,
        writing("log.csv"),
    ):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert raised.value.errno == errno.ENOSPC


def test_links_out_of_their_folder_are_replaced(tmp_path: Path) -> None:
    """A folder may come from others: what it links to stays, whatever is written."""
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "out" / "in").mkdir(parents=True)
    for name, goal in (("a.txt", "../mine.txt"), ("b.txt", str(tmp_path / "mine.txt")), ("c.txt", "in/../a.txt")):
        (tmp_path / "out" / name).symlink_to(goal)
        write_file(tmp_path / "out" / name, name)
    assert contents(tmp_path / "out") == {"a.txt": b"c.txt", "b.txt": b"b.txt", "c.txt": b"c.txt"}
    assert (tmp_path / "mine.txt").read_text() == "mine"
