"""Archives and lists that would fill the memory, the disk or the time of the command itself."""

from __future__ import annotations

import datetime
import gzip
import io
import json
import os
import shutil
import tarfile
import time
import unicodedata
import zipfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from neural_renderer.apps.many import models, shards
from neural_renderer.apps.many.commands.jobs import Job, read_entry
from neural_renderer.apps.many.engines import Done
from neural_renderer.apps.many.models import ModelFile, list_models, opened, plain_names
from neural_renderer.apps.many.progress import Watching
from neural_renderer.apps.many.shards import Shard
from neural_renderer.apps.many.workers import JobError, Limits, Worker, WorkerHere
from neural_renderer.io.atomic_write import make_staging, sweep
from tests.apps.many import jobs

BALL = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
posix = pytest.mark.skipif(os.name != "posix", reason="processes of other systems are not looked at")


def header(kind: bytes, size: int, name: bytes = b"././@LongLink") -> bytes:
    """A header of 512 bytes of a .tar that claims a size."""
    block = bytearray(512)
    block[: len(name)] = name
    block[100:108], block[108:116], block[116:124] = b"0000644\0", b"0000000\0", b"0000000\0"
    block[124:136] = b"\x80" + size.to_bytes(11, "big")
    block[136:148], block[156:157], block[257:265] = b"00000000000\0", kind, b"ustar  \0"
    block[148:156] = b" " * 8
    block[148:156] = b"%06o\0 " % sum(block)
    return bytes(block)


@pytest.mark.parametrize("kind", [b"L", b"K", b"x", b"g", b"X"])
def test_long_headers_are_refused_before_they_are_read(tmp_path: Path, kind: bytes) -> None:
    """The content is missing: whoever reads it would say so. Both of them: plain and compressed."""
    for name, pack in (("a.tar", bytes), ("a.tar.gz", gzip.compress)):
        (tmp_path / name).write_bytes(pack(header(kind, 1 << 29) + bytes(1024)))
        with pytest.raises(ValueError, match=rf"{name}: expected an archive, .*a header of 512 MiB, more than 1"):
            list_models([tmp_path / name])


def test_files_with_holes_are_refused(tmp_path: Path) -> None:
    """Their maps may be long; tarfile reads them whole."""
    (tmp_path / "old.tar").write_bytes(header(b"S", 512, b"a.obj") + bytes(2048))
    info = tarfile.TarInfo("b.obj")
    info.size, info.pax_headers = 1024, {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.realsize": "9"}
    with tarfile.open(tmp_path / "new.tar", "w", format=tarfile.PAX_FORMAT) as tar:
        tar.addfile(info, io.BytesIO(b"1000000000\n" + b"1\n" * 506 + b"\n"))
    for name in ("old.tar", "new.tar"):
        with pytest.raises(ValueError, match="a file with holes"):
            list_models([tmp_path / name])


def test_archives_of_too_many_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        for number in range(20):
            tar.addfile(tarfile.TarInfo(f"{number}.obj"))
    assert len(list_models([tmp_path / "a.tar"])) == 20
    for limit, value in (("_MOST_MEMBERS", 10), ("_MOST_NAMES", 50)):
        with monkeypatch.context() as patch:
            patch.setattr(models, limit, value)
            with pytest.raises(ValueError, match=r"more than .* files, or names of"):
                list_models([tmp_path / "a.tar"])


def test_archives_are_opened_by_the_worker(tmp_path: Path) -> None:
    """A list is made within limits of memory and time; what exceeds them stands in the list with the reason."""

    class Poor(WorkerHere):
        def run(self, work: Any, job: Any) -> tuple[Any, list[str]]:
            if "bomb" in job:
                raise JobError("expected to need at most 4 GiB of memory, got more")
            return super().run(work, job)

    for name in ("bomb", "good"):
        with tarfile.open(tmp_path / f"{name}.tar", "w") as tar:
            info = tarfile.TarInfo("a.obj")
            info.size = len(BALL)
            tar.addfile(info, io.BytesIO(BALL))
    bomb, good = list_models([tmp_path], worker=Poor())
    assert good == ModelFile("good/a", str(tmp_path / "good.tar"), "a.obj")
    assert bomb.problem == f"{tmp_path / 'bomb.tar'}: expected to need at most 4 GiB of memory, got more"


@pytest.mark.parametrize("name", ["a.zip", "a.tar", "a.tar.gz"])
def test_an_archive_is_listed_once_for_all_its_models(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each model listed it again: of 400,000 empty files, a zip of 38 MB, that would take days."""
    for place in ("one", "two", "two/below", "twofold"):
        (tmp_path / "in" / place).mkdir(parents=True)
        (tmp_path / "in" / place / "m.obj").write_bytes(BALL)
        (tmp_path / "in" / place / "m.mtl").write_bytes(b"")
    kind = {".zip": "zip", ".tar": "tar", ".gz": "gztar"}[Path(name).suffix]
    shutil.make_archive(str(tmp_path / "a"), kind, tmp_path / "in")
    found, opens = list_models([tmp_path / name]), []
    kept = models._Archive.__init__
    monkeypatch.setattr(models._Archive, "__init__", lambda self, path: (opens.append(path), kept(self, path))[1])
    sides = {}
    for model in found:
        with opened(model) as path:
            assert path.read_bytes() == BALL
            sides[model.name] = sorted(side.parent.name for side in path.parent.rglob("*.mtl"))
    assert sides == {"one/m": ["one"], "two/below/m": ["below"], "two/m": ["below", "two"], "twofold/m": ["twofold"]}
    with (
        pytest.raises(ValueError, match=r"expected x.obj, got no such file$"),
        opened(ModelFile("x", found[0].path, "x.obj")),
    ):
        pass
    assert len(opens) == 1
    os.utime(tmp_path / name, (1, 1))  # another file, perhaps
    with opened(found[0]):
        assert len(opens) == 2


def test_equal_names_take_linear_time() -> None:
    """A hundred thousand rows called "chair" took nine minutes; a limit of a tenth of that is safe on any machine."""
    start = time.process_time()
    names = plain_names(["chair"] * 100_000)
    assert time.process_time() - start < 54
    assert len(set(names)) == 100_000 and names[:2] + names[-1:] == ["chair", "chair_2", "chair_100000"]


def test_long_names_fit_a_file_system(tmp_path: Path) -> None:
    long = ["n" * 300, "n" * 301, "ü" * 150, "/".join(["a"] * 100_000), f"x/{'y' * 254}.obj", "a" * 200]
    names = plain_names(long)
    assert len(set(names)) == len(names) and names[-1] == "a" * 200
    for name in names:
        (tmp_path / name).mkdir(parents=True)
        assert len(name.encode()) <= 1000
        assert all(len(part.encode()) <= 220 for part in name.split("/"))
    assert plain_names(long) == names


def test_names_that_differ_by_case_are_numbered() -> None:
    """As are letters with accents of one or two characters: some file systems have one file for both."""
    names = ["A.obj", "a.obj", "caf\u00e9.obj", "cafe\u0301.obj", "B/x.obj", "b.obj"]
    plain = plain_names(names)
    assert plain[:2] == ["A_obj", "a_obj_2"] and plain[4] == "B/x"
    assert len({unicodedata.normalize("NFC", name).casefold() for name in plain}) == len(names)
    assert plain_names(["a/CON.obj", "con_.obj", "lpt1/b.obj"]) == ["a/CON_", "con_", "lpt1_/b"]  # devices of Windows


def test_strange_cells_of_parquet(tmp_path: Path) -> None:
    """One row that is no text costs itself; another file than a table is refused in a sentence."""
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    (tmp_path / "a.obj").write_bytes(BALL)
    columns = {
        "bytes": [b"a.obj"],
        "list": [["a.obj"]],
        "struct": [{"x": "a.obj"}],
        "bool": [True],
        "time": [datetime.datetime(1, 1, 1)],
        "null": pa.array([None], pa.string()),
    }
    for name, column in columns.items():
        parquet.write_table(pa.table({"path": column, "name": ["one"]}), tmp_path / "list.parquet")
        expected = 'expected a path in the column "path"' if name == "null" else "path: expected a text, got"
        with pytest.raises(ValueError, match=f"^list.parquet, row 1: {expected}"):  # the only row
            list_models([tmp_path / "list.parquet"])
        _, model = list_models([tmp_path / "a.obj", tmp_path / "list.parquet"])
        assert model.problem.startswith(f"list.parquet, row 1: {expected}")
    mixed = pa.table({"path": ["a.obj", "a.obj"], "name": [7, None]})
    parquet.write_table(mixed, tmp_path / "list.parquet")
    assert {model.name for model in list_models([tmp_path / "list.parquet"])} == {"7", "a"}
    (tmp_path / "list.parquet").write_bytes(b"PAR1" + bytes(60) + b"PAR1")
    with pytest.raises(ValueError, match=r"list\.parquet: expected a table, got a file that cannot be read"):
        list_models([tmp_path / "list.parquet"])


def test_cells_with_line_breaks(tmp_path: Path) -> None:
    """Only line feeds end the lines of a file; a quoted cell may have them."""
    for name in ("a\u2028b.obj", "c\nd.obj", "e\x0bf.obj", "g\x85h.obj"):
        (tmp_path / name).write_bytes(BALL)
        (tmp_path / "list.csv").write_text(f'path,name\n"{name}",one\n', encoding="utf-8", newline="")
        assert list_models([tmp_path / "list.csv"]) == [ModelFile("one", str(tmp_path / name))]
        if "\n" not in name:
            (tmp_path / "list.txt").write_text(f"{name}\n", encoding="utf-8", newline="")
            assert list_models([tmp_path / "list.txt"])[0].path == str(tmp_path / name)


@posix
@pytest.mark.usefixtures("copied_processes")
def test_a_killed_worker_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not after the time limit, nor after a crash; and the files of killed parents are swept."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    left = tmp_path / make_staging(tmp_path).name.replace(str(os.getpid()), "999999999")
    left.mkdir()
    (left / "mesh.obj").write_bytes(BALL)
    with closing(Worker(Limits(seconds=1.0))) as worker:
        with pytest.raises(JobError, match="expected an end within 1 s"):
            worker.run(jobs.unpack_and_sleep, 3600)
        assert not left.exists()
        assert not list(tmp_path.rglob("part*"))
        place = Path(worker.run(jobs.unpack_and_sleep, 0)[0])
        assert place.is_relative_to(tmp_path) and place.exists()
        worker._process.kill()
    assert not list(tmp_path.rglob("part*"))


@posix
def test_temporary_folders_of_other_machines_are_swept_when_they_are_old(tmp_path: Path) -> None:
    """Those of a process that lives are never."""
    own, old, new = make_staging(tmp_path), tmp_path / ".neural_renderer-00000000-1-a", tmp_path / ".neural_renderer-b"
    old.mkdir()
    new.mkdir()
    for path in (own, old):
        os.utime(path, (0, 0))
    sweep(tmp_path, others=True)
    assert own.exists() and new.exists() and not old.exists()


@pytest.mark.slow  # starts a worker
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")
def test_a_job_that_forks_answers_once() -> None:
    with closing(Worker()) as worker:
        assert worker.run(jobs.fork, "a") == ("a", [])
        for number in range(4):
            assert worker.run(jobs.double, 2 * number) == (4 * number, [])


def test_an_archive_is_unpacked_into_the_workers_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        info = tarfile.TarInfo("a.obj")
        info.size = len(BALL)
        tar.addfile(info, io.BytesIO(BALL))
    [model] = list_models([tmp_path / "a.tar"])
    with opened(model) as path:
        assert path.is_relative_to(tmp_path / "temporary")


def test_many_equal_problems_are_few_lines(capsys: pytest.CaptureFixture[str]) -> None:
    """A few of each kind, and their number at the end; a list may have as many kinds as models, too."""
    with Watching(2000) as watching:
        for number in range(1000):
            watching("a", Done(1, failures=1, problems=(f"c/{number}: expected faces, got {number} vertices",)))
            watching("a", Done(1, notes=(f"c/{number}: {'x' * number}\x1b[31m is odd",)))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) < 50 and not any("\x1b[31m is" in line for line in lines)
    assert sum("expected faces" in line for line in lines) == 4
    assert "997 more messages like: c/0: expected faces, got 0 vertices" in lines


@pytest.mark.parametrize(
    "change",
    [
        *({name: value} for name in ("models", "views") for value in (None, "x", [])),
        *({name: value} for name in ("samples", "failed") for value in (None, "x", 1, [1])),
        "[" * 100_000,
        "5",
        *(path for path in (Path("/dev/zero"),) if path.exists()),
    ],
)
def test_entries_of_others_are_made_again(tmp_path: Path, change: Any) -> None:
    """An entry of a finished shard or run that no command has written is none."""
    shard, job = Shard(0, ()), Job("a", ())
    known: dict[str, Any] = {"shard": shard.name, "models": 1, "views": 0, "samples": [], "failed": []}
    for name, entry in ((shard.name, known), (job.name, {"arguments": [], "problem": "", "code": 0, "files": []})):
        place = tmp_path / "manifest" / f"{name}.json"
        place.parent.mkdir(exist_ok=True)
        place.write_text(json.dumps(entry))
        assert (shards.read_entry(tmp_path, shard) if name == shard.name else read_entry(tmp_path, job)) == entry
        place.unlink()
        if isinstance(change, Path):
            place.symlink_to(change)
        else:
            place.write_text(change if isinstance(change, str) else json.dumps(known | change))
        assert (shards.read_entry(tmp_path, shard) if name == shard.name else read_entry(tmp_path, job)) is None


def test_long_names_in_messages(tmp_path: Path) -> None:
    """Of a missing archive, once; and of a member that is not in its archive."""
    (tmp_path / "l.txt").write_text(f"{'a' * 240}/{'b' * 240}/{'c' * 240}.zip\n")
    with pytest.raises(ValueError, match=r"^l.txt, line 1: .*expected a file, got nothing there$") as found:
        list_models([tmp_path / "l.txt"])
    assert len(str(found.value)) < 300
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as pack:
        pack.writestr("a.obj", BALL)
    with (
        pytest.raises(ValueError, match="no such file") as missing,
        opened(ModelFile("a", str(tmp_path / "b.zip"), f"\x1b{'w' * 5000}.obj")),
    ):
        pass
    assert len(str(missing.value)) < 400 and str(missing.value).isprintable()
