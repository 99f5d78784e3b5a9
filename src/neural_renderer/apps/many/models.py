"""Lists of models: in folders, in lists of paths, in archives."""

from __future__ import annotations

import csv
import os
import posixpath
import re
import shutil
import tarfile
import tempfile
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple

from ...io.files import existing, import_library, read_text, reason, short

MESHES = (".obj", ".glb", ".gltf", ".ply", ".off", ".stl")
_ARCHIVES = (".zip", ".tar", ".tar.gz", ".tgz")
_LISTS = (".csv", ".txt", ".parquet")
_COLUMNS = ("path", "name", "member")  # of lists
_WITH_FILES = (".obj", ".gltf")  # formats that name other files
_HIDDEN = re.compile(r"(^|/)\.[^./]")
_PLAIN = re.compile(r"[^\w/-]+")  # what names of samples do not contain
_MOST_FILES, _MOST_BYTES = 10_000, 1 << 32  # extracted from an archive for one model
_MOST_UNPACKED = 1 << 33  # bytes of a compressed .tar, which is unpacked to list it


@dataclass(frozen=True, order=True)
class ModelFile:
    """Mesh file of a list."""

    name: str  # unique in the list: letters, digits, "_", "-" and "/"
    path: str  # absolute path of the file, or of the archive that contains it
    member: str = ""  # name in the archive, or ""
    problem: str = ""  # sentence that says why there is no such model, or ""


_Found = tuple[str, str, str, str]  # name with suffix, path, member, problem


def list_models(inputs: Sequence[Path], without: Path | None = None) -> list[ModelFile]:
    """List the models of files and folders, sorted by name; ``without`` is a folder that is left out, with all in it.

    Inputs are mesh files; archives of them; folders, with those in all folders below; and lists of paths of any of
    these: .txt with one a line, .csv or .parquet with a column "path" and, if there are, "name" and "member" (of the
    archive). Paths in a list are relative to its folder.

    A name is the path in the folder, archive or list without its suffix; several inputs, and archives in folders, put
    their own name before it. Duplicate names, and names that are also folders, get their suffix and a number. An
    archive that cannot be read or has no meshes stands in the list as a model, which cannot be read either; and so does
    a row of a list that names no model. ValueError: An input or a list is malformed, or there are no models.
    """
    found: list[_Found] = []
    for path in inputs:
        before = (
            f"{_without_suffix(path.resolve().name)}/"
            if len(inputs) > 1 and (path.is_dir() or _suffix(path) not in MESHES)
            else ""
        )
        found += [_within(before, model) for model in _listed(path, without)]
    if not found:
        places = ", ".join(map(str, inputs))
        raise ValueError(f"{places}: expected meshes ({', '.join(MESHES)}) or archives of them, got none")
    if all(problem for *_, problem in found):
        raise ValueError(found[0][-1])
    return _named(sorted(found))


def _listed(path: Path, without: Path | None) -> Iterator[_Found]:
    if path.is_dir():
        yield from _in_folder(path, without)
        return
    existing(path, "a mesh, an archive, a list of them, or a folder")
    if _suffix(path) in _LISTS:
        for row in _rows(path):
            yield from _of_row(path.resolve().parent, row, without)
    elif _suffix(path) in _ARCHIVES:
        yield from _in_archive(str(path))
    elif _suffix(path) in MESHES:
        yield path.name, os.path.abspath(path), "", ""
    else:
        expected = ", ".join(MESHES + _ARCHIVES + _LISTS)
        raise ValueError(f"{path}: expected a folder, or a file that ends in {expected}")


def _within(before: str, model: _Found) -> _Found:
    return (before + model[0], *model[1:])


def _of_row(home: Path, row: _Row, without: Path | None) -> Iterator[_Found]:
    """List the models of a row of a list in the folder ``home``; one with a problem if there are none."""
    name, file, target = row.name, row.path, os.path.abspath(home / row.path)
    found: Iterable[_Found] = ()
    if row.problem:
        pass
    elif row.member or _suffix(target) in MESHES:
        inside = f"{_without_suffix(file)}/{row.member}" if row.member else file
        found = [(name + _suffix(inside) if name else inside, target, row.member, "")]
    elif _suffix(target) in _ARCHIVES:
        found = _in_archive(target, name or _without_suffix(file))
    elif os.path.isdir(target):
        found = [_within(f"{name or file}/", model) for model in _in_folder(Path(target), without)]
    expected = f"expected a folder with meshes, or a path that ends in {', '.join(MESHES + _ARCHIVES)}"
    problem = f"{row.place}: {row.problem or f'{expected}, got {short(file)}'}"
    yield from found or [(name or file or "row", target, "", problem)]


def _in_folder(folder: Path, without: Path | None) -> Iterator[_Found]:
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
                yield from _in_archive(path, _without_suffix(name))


def _in_archive(path: str, name: str = "") -> Iterator[_Found]:
    """List what is not hidden in an archive with a name; the archive itself if it has no meshes or cannot be read.

    Archives in it have a problem: they are not opened.
    """
    whole, before = os.path.abspath(path), f"{name}/" if name else ""
    try:
        with _Archive(whole) as archive:
            members = [member for member in archive.sizes if not _HIDDEN.search(member)]
    except (OSError, ValueError):
        members = []
    if not any(_suffix(member) in MESHES for member in members):
        yield f"{name or os.path.basename(path)}.archive", whole, "", ""
        return
    for member in members:
        if _suffix(member) in MESHES:
            yield before + member, whole, member, ""
        elif _suffix(member) in _ARCHIVES:
            problem = f"{os.path.basename(path)}: expected meshes in the archive, got the archive {short(member)}"
            yield before + member, whole, member, problem


class _Row(NamedTuple):
    """Row of a list, with its location for messages, and its error or ""."""

    place: str
    path: str
    name: str = ""
    member: str = ""
    problem: str = ""


def _rows(path: Path) -> Iterator[_Row]:
    if _suffix(path) == ".txt":
        lines = enumerate(read_text(path).splitlines(), 1)
        yield from (_Row(f"{path.name}, line {number}", line.strip()) for number, line in lines if line.strip())
        return
    is_parquet = _suffix(path) == ".parquet"
    header, table = _parquet_table(path) if is_parquet else read_table(path)
    if "path" not in header:
        raise ValueError(f'{path}: expected a column "path", got {", ".join(map(short, header)) or "none"}')
    for number, row, problem in table:
        file, name, member = (row.get(column) or "" for column in _COLUMNS)
        missing = "" if file else 'expected a path in the column "path", got none'
        yield _Row(f"{path.name}, {'row' if is_parquet else 'line'} {number}", file, name, member, problem or missing)


Table = tuple[list[str], Iterable[tuple[int, dict[str, str], str]]]
"""Header and rows of a table: line number, cells, and an error or ""."""


def read_table(path: Path) -> Table:
    """Read a .csv with a header, of stripped text; empty lines are left out. A row longer than the header is wrong."""
    reader = csv.reader(read_text(existing(path)).splitlines())
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
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a table, got a file that cannot be read ({reason(error)})") from None
    rows = [{name: str(value) for name, value in row.items() if value is not None} for row in cells]
    return header, [(number, row, "") for number, row in enumerate(rows, 1)]


def load_parquet(path: Path) -> Any:
    """Import pyarrow.parquet, for a file."""
    return import_library("pyarrow.parquet", f"for {path.name}")


def _named(found: Sequence[_Found]) -> list[ModelFile]:
    names = plain_names([name for name, *_ in found])
    return sorted(ModelFile(name, *place) for name, (_, *place) in zip(names, found, strict=True))


def plain_names(names: Sequence[str]) -> list[str]:
    """Convert paths to unique names for `ModelFile`, without suffix where that is unique."""
    stems = [_plain(str(PurePosixPath(name.replace("\\", "/")).with_suffix(""))) for name in names]
    taken = {str(folder) for stem in stems for folder in PurePosixPath(stem).parents}  # names of folders
    counts = Counter([*stems, *taken])
    plain = []
    for stem, name in zip(stems, names, strict=True):
        stem = stem if counts[stem] == 1 else f"{stem}_{_suffix(name)[1:]}".rstrip("_")
        unique, number = stem, 1
        while unique in taken:
            number += 1
            unique = f"{stem}_{number}"
        taken.add(unique)
        plain.append(unique)
    return plain


def _plain(name: str) -> str:
    """Replace characters that the name of a sample may not contain. No part of it is empty."""
    parts = [_PLAIN.sub("_", part) for part in name.split("/") if part not in ("", ".", "..")]
    return "/".join(parts) or "model"


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
    if not model.member and _suffix(path) not in _ARCHIVES:
        yield path
        return
    with ExitStack() as stack:
        archive = stack.enter_context(_Archive(str(path)))
        if not model.member:
            raise ValueError(f"{path}: expected meshes in the archive, got none")
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="neural_renderer-"))
        yield archive.extract(model.member, Path(folder))


class _Archive:
    """Archive, as a context; ``sizes`` are those of its regular files by name."""

    def __init__(self, path: str) -> None:
        self._path = existing(path)
        self._stack = ExitStack()
        try:
            if _suffix(path) == ".zip":
                self._zip: zipfile.ZipFile | None = self._stack.enter_context(zipfile.ZipFile(path))
                self.sizes = {info.filename: info.file_size for info in self._zip.infolist() if not info.is_dir()}
            else:
                self._zip = None
                mode: Any = "r:" if _suffix(path) == ".tar" else "r:gz"
                self._tar = self._stack.enter_context(tarfile.open(path, mode))  # noqa: SIM115 (`_stack` closes it)
                self.sizes = {}
                links = []
                for info in self._tar:
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

    def extract(self, member: str, folder: Path) -> Path:
        """Extract a mesh, and what it may name: the files in its folder and below that are neither mesh nor archive."""
        names = [member]
        if _suffix(member) in _WITH_FILES:
            home = member.rpartition("/")[0]
            inside = f"{home}/" if home else ""
            others = (name for name in self.sizes if name.startswith(inside) and name != member)
            names += [name for name in others if _suffix(name) not in MESHES + _ARCHIVES]
        size = sum(self.sizes.get(name, 0) for name in names)
        if len(names) > _MOST_FILES or size > _MOST_BYTES:
            raise ValueError(
                f"{self._path}: expected at most {_MOST_FILES:,} files of {_MOST_BYTES >> 30} GiB for {member}, got "
                f"{len(names):,} files of {size / 2**30:.1f} GiB"
            )
        try:
            for name in names:
                target = folder / name
                if not target.resolve().is_relative_to(folder.resolve()):
                    raise ValueError(f"it names {name}, which is outside")
                target.parent.mkdir(parents=True, exist_ok=True)
                with self._open(name) as source, target.open("wb") as copy:
                    shutil.copyfileobj(source, copy)
        except Exception as error:  # as above
            raise ValueError(f"{self._path}: expected {member}, got {reason(error)}") from None
        return folder / member

    def _open(self, name: str) -> IO[bytes]:
        file = self._zip.open(name) if self._zip is not None else self._tar.extractfile(name)
        if file is None:
            raise ValueError("no regular file")
        return file
