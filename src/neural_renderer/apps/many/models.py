"""Lists of models: in folders, in lists of paths, in archives."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import posixpath
import re
import shutil
import sys
import tarfile
import tempfile
import threading
import unicodedata
import weakref
import zipfile
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple

from ...io.files import existing, import_library, read_text, reason, short, short_path
from .workers import JobError, Worker, WorkerHere

MESHES = (".obj", ".glb", ".gltf", ".ply", ".off", ".stl")
_ARCHIVES = (".zip", ".tar", ".tar.gz", ".tgz")
_LISTS = (".csv", ".txt", ".parquet")
_EXTENDED = (tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK, *(b"x", b"g", b"X"))  # headers of a .tar with more
_COLUMNS = ("path", "name", "member")  # of lists
_COLUMNS_TOLD = 5  # of a list without a path, in its message
_WITH_FILES = (".obj", ".gltf")  # formats that name other files
_LAST = chr(sys.maxunicode)  # sorted after all other characters
_HIDDEN = re.compile(r"(^|/)\.[^./]")
_DEVICE = re.compile(r"con|prn|aux|nul|com\d|lpt\d", re.IGNORECASE)  # what Windows calls no file
_PLAIN = re.compile(r"[^\w/-]+")  # characters that names of samples do not have
_MOST_FILES, _MOST_BYTES = 10_000, 1 << 32  # extracted from an archive for one model
_MOST_UNPACKED = 1 << 33  # bytes of a compressed .tar, which is unpacked to list it
_MOST_HEADER = 1 << 20  # bytes of a long name or of attributes in a .tar, which tarfile reads whole
_MOST_MEMBERS, _MOST_NAMES = 1_000_000, 1 << 28  # members of an archive, and characters of all their names
_LONGEST_PART, _LONGEST_NAME = 200, 1000  # bytes of a part of a name of a sample, and of all; a file system takes 255


@dataclass(frozen=True, order=True)
class ModelFile:
    """Mesh file of a list."""

    name: str  # unique in the list: letters, digits, "_", "-" and "/"
    path: str  # absolute path of the file, or of the archive that contains it
    member: str = ""  # name in the archive, or ""
    problem: str = ""  # sentence that says why there is no such model, or ""


_Found = tuple[str, str, str, str]  # name with suffix, path, member, problem


def file_checksum(path: Path) -> str:
    """Compute the SHA-256 of a file, in hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def list_models(inputs: Sequence[Path], without: Path | None = None, worker: Worker | None = None) -> list[ModelFile]:
    """List the models of files and folders, sorted by name; ``without`` is a folder that is left out, with all in it.

    A ``worker`` opens archives, within its limits; by default this process does.

    Inputs are mesh files; archives of them; folders, with those in all folders below; and lists of paths of any of
    these: .txt with one a line, .csv or .parquet with a column "path" and, if there are, "name" and "member" (of the
    archive). Paths in a list are relative to its folder.

    A name is the path in the folder, archive or list without its suffix; several inputs, and archives in folders, put
    their own name before it. Duplicate names, and names that are also folders, get their suffix and a number. An
    archive that cannot be read or has no meshes stands in the list as a model, which cannot be read either; and so does
    a row of a list that names no model. ValueError: An input or a list is malformed, or there are no models.
    """
    found: list[_Found] = []
    worker = WorkerHere() if worker is None else worker
    for path in inputs:
        before = (
            f"{_without_suffix(path.resolve().name)}/"
            if len(inputs) > 1 and (path.is_dir() or _suffix(path) not in MESHES)
            else ""
        )
        found += [_within(before, model) for model in _listed(path, without, worker)]
    if not found:
        places = ", ".join(map(str, inputs))
        raise ValueError(f"{places}: expected meshes ({', '.join(MESHES)}) or archives of them, got none")
    if all(problem for *_, problem in found):
        raise ValueError(found[0][-1])
    return _named(sorted(found))


def _listed(path: Path, without: Path | None, worker: Worker) -> Iterator[_Found]:
    if path.is_dir():
        yield from _in_folder(path, without, worker)
        return
    existing(path, "a mesh, an archive, a list of them, or a folder")
    if _suffix(path) in _LISTS:
        for row in _rows(path):
            yield from _of_row(path.resolve().parent, row, without, worker)
    elif _suffix(path) in _ARCHIVES:
        yield from _in_archive(str(path), worker)
    elif _suffix(path) in MESHES:
        yield path.name, os.path.abspath(path), "", ""
    else:
        expected = ", ".join(MESHES + _ARCHIVES + _LISTS)
        raise ValueError(f"{path}: expected a folder, or a file that ends in {expected}")


def _within(before: str, model: _Found) -> _Found:
    return (before + model[0], *model[1:])


def _of_row(home: Path, row: _Row, without: Path | None, worker: Worker) -> Iterator[_Found]:
    """List the models of a row of a list in the folder ``home``; one with a problem if there are none."""
    name, file, target = row.name, row.path, os.path.abspath(home / row.path)
    found: Iterable[_Found] = ()
    if row.problem:
        pass
    elif row.member or _suffix(target) in MESHES:
        inside = f"{_without_suffix(file)}/{row.member}" if row.member else file
        found = [(name + _suffix(inside) if name else inside, target, row.member, "")]
    elif _suffix(target) in _ARCHIVES:
        models = _in_archive(target, worker, name or _without_suffix(file))
        found = ((*model, problem and f"{row.place}: {problem}") for *model, problem in models)  # type: ignore[misc]
    elif os.path.isdir(target):
        found = [_within(f"{name or file}/", model) for model in _in_folder(Path(target), without, worker)]
    expected = f"expected a folder with meshes, or a path that ends in {', '.join(MESHES + _ARCHIVES)}"
    problem = f"{row.place}: {row.problem or f'{expected}, got {short(file)}'}"
    yield from found or [(name or file or "row", target, "", problem)]


def _in_folder(folder: Path, without: Path | None, worker: Worker) -> Iterator[_Found]:
    """List meshes and archives in a folder and those below, without hidden ones."""
    left_out = os.path.relpath(without, folder.resolve()) if without else None
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and os.path.relpath(os.path.join(place, name), folder) != left_out
        )
        for file in (name for name in files if not name.startswith(".")):
            path = os.path.join(place, file)
            name = os.path.relpath(path, folder)
            if _suffix(file) in MESHES:
                yield name, os.path.abspath(path), "", ""
            elif _suffix(file) in _ARCHIVES:
                yield from _in_archive(path, worker, _without_suffix(name))


def _in_archive(path: str, worker: Worker, name: str = "") -> Iterator[_Found]:
    """List what is not hidden in an archive with a name; the archive itself, with a problem, if it has no meshes.

    Archives in it have a problem: they are not opened.
    """
    whole, before = os.path.abspath(path), f"{name}/" if name else ""
    place = short_path(whole)
    try:
        members, _ = worker.run(_members, whole)
    except JobError as error:
        problem = str(error) if place in str(error) else f"{place}: {error}"
        yield f"{name or os.path.basename(path)}.archive", whole, "", problem
        return
    for member in members:
        if _suffix(member) in MESHES:
            yield before + member, whole, member, ""
        elif _suffix(member) in _ARCHIVES:
            problem = (
                f"{short_path(os.path.basename(path))}: expected meshes in the archive, got the archive {short(member)}"
            )
            yield before + member, whole, member, problem


def _members(path: str) -> list[str]:
    """List meshes and archives in an archive that are not hidden; ValueError if it has no meshes."""
    with _Archive(path) as archive:
        members = [name for name in archive.sizes if _suffix(name) in MESHES + _ARCHIVES and not _HIDDEN.search(name)]
    if not any(_suffix(member) in MESHES for member in members):
        raise ValueError(f"{path}: expected meshes in the archive, got none")
    return members


class _Row(NamedTuple):
    """Row of a list, with its location for messages, and its error or ""."""

    place: str
    path: str
    name: str = ""
    member: str = ""
    problem: str = ""


def _rows(path: Path) -> Iterator[_Row]:
    if _suffix(path) == ".txt":
        lines = enumerate(read_text(path).split("\n"), 1)
        yield from (_Row(f"{path.name}, line {number}", line.strip()) for number, line in lines if line.strip())
        return
    is_parquet = _suffix(path) == ".parquet"
    header, table = _parquet_table(path) if is_parquet else read_table(path)
    if "path" not in header:
        found = ", ".join(map(short, header[:_COLUMNS_TOLD])) + (", …" if len(header) > _COLUMNS_TOLD else "")
        raise ValueError(f'{path}: expected a column "path", got {found or "none"}')
    for number, row, problem in table:
        file, name, member = (row.get(column) or "" for column in _COLUMNS)
        missing = "" if file else 'expected a path in the column "path", got none'
        yield _Row(f"{path.name}, {'row' if is_parquet else 'line'} {number}", file, name, member, problem or missing)


Table = tuple[list[str], Iterable[tuple[int, dict[str, str], str]]]
"""Header and rows of a table: line number, cells, and an error or ""."""


def read_table(path: Path) -> Table:
    """Read a .csv with a header, of stripped text; empty lines are left out. A row longer than the header is wrong."""
    reader = csv.reader(io.StringIO(read_text(existing(path)), newline=""))
    try:
        lines = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except csv.Error as error:
        raise ValueError(f"{path}: expected CSV, got a file that cannot be parsed ({error})") from None
    header = lines[0][1] if lines else []
    return header, [
        (
            number,
            dict(zip(header, row, strict=False)),
            f"expected {len(header)} columns, got {len(row)}" if len(row) > len(header) else "",
        )
        for number, row in lines[1:]
    ]


def _parquet_table(path: Path) -> Table:
    parquet = load_parquet(path)
    try:
        with parquet.ParquetFile(path) as file:
            header = file.schema_arrow.names
            columns = [name for name in _COLUMNS if name in header]
            cells = [row for batch in file.iter_batches(columns=columns) for row in batch.to_pylist()]
    except Exception as error:  # pyarrow raises errors of many classes
        raise ValueError(f"{path}: expected a table, got a file that cannot be read ({reason(error)})") from None
    return header, [(number, *_text_cells(row)) for number, row in enumerate(cells, 1)]


def _text_cells(row: dict[str, Any]) -> tuple[dict[str, str], str]:
    """Convert cells of any type to text; return what is wrong, too, if one is neither a text nor a number."""
    wrong = [f"{name}: expected a text, got {type(value).__name__}" for name, value in row.items() if _is_odd(value)]
    return {name: str(value).strip() for name, value in row.items() if value is not None}, "; ".join(wrong)


def _is_odd(value: Any) -> bool:
    return value is not None and (isinstance(value, bool) or not isinstance(value, (str, int, float)))


def load_parquet(path: Path) -> Any:
    """Import pyarrow.parquet, for a file."""
    return import_library("pyarrow.parquet", f"for {path.name}")


def _named(found: Sequence[_Found]) -> list[ModelFile]:
    names = plain_names([name for name, *_ in found])
    return sorted(ModelFile(name, *place) for name, (_, *place) in zip(names, found, strict=True))


def plain_names(names: Sequence[str]) -> list[str]:
    """Convert paths to unique names for `ModelFile`, without suffix where that is unique.

    Names that differ only by case count as equal: many file systems have one file for both.
    """
    stems = [_plain(str(PurePosixPath(name.replace("\\", "/")).with_suffix(""))) for name in names]
    taken = {_alike(str(folder)) for stem in stems for folder in PurePosixPath(stem).parents}  # names of folders
    counts = Counter([*map(_alike, stems), *taken])
    numbers: dict[str, int] = {}  # the last of each stem
    plain = []
    for stem, name in zip(stems, names, strict=True):
        stem = stem if counts[_alike(stem)] == 1 else _plain(f"{stem}_{_suffix(name)[1:]}".rstrip("_"))
        unique, number = stem, numbers.get(_alike(stem), 1)
        while _alike(unique) in taken:
            number += 1
            unique = f"{stem}_{number}"
        numbers[_alike(stem)] = number
        taken.add(_alike(unique))
        plain.append(unique)
    return plain


def _alike(name: str) -> str:
    """Convert a name to what some file systems compare: without case, accents composed."""
    return unicodedata.normalize("NFC", name.casefold())


def _plain(name: str) -> str:
    """Replace characters that the name of a sample may not contain. No part is empty, or too long for a file system."""
    parts = [_cut(_PLAIN.sub("_", part), _LONGEST_PART) for part in name.split("/") if part not in ("", ".", "..")]
    parts = [f"{part}_" if _DEVICE.fullmatch(part) else part for part in parts]
    return _cut("/".join(parts), _LONGEST_NAME) or "model"


def _cut(text: str, most: int) -> str:
    """Cut a text that has more bytes than ``most``, and end it with a hash of the whole."""
    data = text.encode()
    if len(data) <= most:
        return text
    digest = hashlib.sha256(data).hexdigest()[:16]
    return f"{data[: most - len(digest) - 1].decode(errors='ignore')}_{digest}"


def _suffix(path: str | Path) -> str:
    name = os.fspath(path).lower()
    return ".tar.gz" if name.endswith(".tar.gz") else os.path.splitext(name)[1]


def _without_suffix(path: str) -> str:
    return path[: len(path) - len(_suffix(path))]


@contextmanager
def opened(model: ModelFile) -> Iterator[Path]:
    """Give the mesh file of a model, extracted into a temporary folder if it is in an archive.

    ValueError: The model has a problem, or its archive cannot be read, has no meshes, or is too large.
    """
    if model.problem:
        raise ValueError(model.problem)
    path = existing(model.path, "a file that can be read")
    if not model.member:
        yield path
        return
    archive = _opened_archive(str(path))
    with tempfile.TemporaryDirectory(prefix="neural_renderer-") as folder:
        yield archive.extract(model.member, Path(folder))


_kept = threading.local()  # the last archive of each thread


def _opened_archive(path: str) -> _Archive:
    """Open an archive, or give the last one of this thread if it is the same: the list of its files takes long."""
    found = os.stat(path)
    key = os.getpid(), path, found.st_ino, found.st_size, found.st_mtime_ns  # a forked process has files of its own
    if getattr(_kept, "key", None) != key:
        _kept.key = _kept.archive = None  # closes the one before
        _kept.archive = _Archive(path)
        _kept.key = key
    archive: _Archive = _kept.archive
    return archive


class _Member(tarfile.TarInfo):
    """Member of a .tar whose headers are short: tarfile reads a long name, attributes and maps of holes whole."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> _Member:
        """Read a header of 512 bytes; ValueError if what follows it is no plain content and too long."""
        member = super().frombuf(buf, encoding, errors)
        if member.type in _EXTENDED and member.size > _MOST_HEADER:
            raise ValueError(f"a header of {member.size / 2**20:,.0f} MiB, more than {_MOST_HEADER >> 20}")
        if member.type == tarfile.GNUTYPE_SPARSE:
            raise ValueError("a file with holes")
        return member

    def _proc_gnusparse_10(self, *_: object) -> None:
        raise ValueError("a file with holes")


class _Archive:
    """Archive, as a context; ``sizes`` are those of its regular files by name."""

    def __init__(self, path: str) -> None:
        self._path = existing(path)
        self._stack = ExitStack()
        weakref.finalize(self, self._stack.close)
        try:
            if _suffix(path) == ".zip":
                self._zip: zipfile.ZipFile | None = self._stack.enter_context(zipfile.ZipFile(path))
                self.sizes = {info.filename: info.file_size for info in self._zip.infolist() if not info.is_dir()}
            else:
                self._zip = None
                mode: Any = "r:" if _suffix(path) == ".tar" else "r:gz"
                self._tar = self._stack.enter_context(tarfile.open(path, mode, tarinfo=_Member))  # noqa: SIM115
                self.sizes = {}
                self._infos: dict[str, tarfile.TarInfo] = {}
                links, names = [], 0
                for number, info in enumerate(self._tar, 1):
                    self._infos[info.name] = info
                    names += len(info.name) + len(info.linkname)
                    if number > _MOST_MEMBERS or names > _MOST_NAMES:
                        raise ValueError(f"more than {_MOST_MEMBERS:,} files, or names of {_MOST_NAMES >> 20} MiB")
                    if mode == "r:gz" and info.offset_data + info.size > _MOST_UNPACKED:  # before it is unpacked
                        raise ValueError(f"more than {_MOST_UNPACKED >> 30} GiB unpacked")
                    if info.isreg():
                        self.sizes[info.name] = info.size
                    elif info.islnk() and info.linkname in self.sizes:  # another name of a file before it
                        self.sizes[info.name] = self.sizes[info.linkname]
                    elif info.issym():
                        place = posixpath.join(posixpath.dirname(info.name), info.linkname)
                        links.append((info.name, posixpath.normpath(place)))
                plain = {posixpath.normpath(name): size for name, size in self.sizes.items()}
                self.sizes |= {name: plain[target] for name, target in links if target in plain}
        except Exception as error:  # damaged archives raise errors of many classes
            self._stack.close()
            raise ValueError(f"{path}: expected an archive, got one that cannot be read ({reason(error)})") from None

    def __enter__(self) -> _Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @cached_property
    def _others(self) -> list[str]:
        """The names of the files that are neither mesh nor archive, sorted."""
        return sorted(name for name in self.sizes if _suffix(name) not in MESHES + _ARCHIVES)

    def extract(self, member: str, folder: Path) -> Path:
        """Extract a mesh, and what it may name: the files in its folder and below that are neither mesh nor archive."""
        names = [member]
        if _suffix(member) in _WITH_FILES:
            home = member.rpartition("/")[0]
            inside = f"{home}/" if home else ""
            names += self._others[bisect_left(self._others, inside) : bisect_left(self._others, f"{inside}{_LAST}")]
        size = sum(self.sizes.get(name, 0) for name in names)
        if len(names) > _MOST_FILES or size > _MOST_BYTES:
            raise ValueError(
                f"{self._path}: expected at most {_MOST_FILES:,} files of {_MOST_BYTES >> 30} GiB for "
                f"{short_path(member)}, got {len(names):,} files of {size / 2**30:.1f} GiB"
            )
        try:
            for name in names:
                target = folder / name
                if not target.resolve().is_relative_to(folder.resolve()):
                    raise ValueError(f"it names {short_path(name)}, which is outside")
                target.parent.mkdir(parents=True, exist_ok=True)
                with self._open(name) as source, target.open("wb") as copy:
                    shutil.copyfileobj(source, copy)
        except Exception as error:  # as above
            raise ValueError(f"{self._path}: expected {short_path(member)}, got {reason(error)}") from None
        return folder / member

    def _open(self, name: str) -> IO[bytes]:
        if name not in self.sizes:
            raise ValueError("no such file")
        file = self._zip.open(name) if self._zip is not None else self._tar.extractfile(self._infos[name])
        if file is None:
            raise ValueError("no regular file")
        return file
