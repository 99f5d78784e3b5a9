"""Lists of models: in folders, in lists of paths, in archives."""

from __future__ import annotations

import csv
import os
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
from typing import IO, Any

from ..io.files import existing, import_library, read_text, reason

MESHES = (".obj", ".glb", ".gltf", ".ply", ".off", ".stl")
_ARCHIVES = (".zip", ".tar", ".tar.gz", ".tgz")
_LISTS = (".csv", ".txt", ".parquet")
_WITH_FILES = (".obj", ".gltf")  # formats that name other files
_PLAIN = re.compile(r"[^\w/-]+")  # what names of samples do not contain
_MOST_FILES, _MOST_BYTES = 10_000, 1 << 32  # extracted from an archive for one model
_MOST_UNPACKED = 1 << 33  # bytes of a compressed .tar, which is unpacked to list it


@dataclass(frozen=True, order=True)
class ModelFile:
    """Mesh file of a list.

    Attributes:
        name: Name, unique in the list: letters, digits, "_", "-" and "/".
        path: Absolute path of the file, or of the archive that contains it.
        member: Name in the archive, or "".
    """

    name: str
    path: str
    member: str = ""


def list_models(inputs: Sequence[Path]) -> list[ModelFile]:
    """List the models of files and folders, sorted by name.

    Args:
        inputs: Mesh files; archives of them, .zip, .tar or .tar.gz; folders, with those in all folders below; and lists
            of paths of any of these: .txt with one a line, .csv or .parquet with a column "path" and, if there are,
            "name" and "member" (of the archive). Paths in a list are relative to its folder. A parquet needs pyarrow.

    Returns:
        The models. A name is the path in the folder, archive or list without its suffix; several inputs, and archives
        in folders, put their own name before it. Equal names get their suffix and a number, and so do names that are
        folders of others. An archive that cannot be
        read or has no meshes stands in the list as a model, which cannot be read either.

    Raises:
        FileNotFoundError: An input does not exist.
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: An input is no mesh, archive, list or folder; a list is malformed; or there are no models.
    """
    found: list[tuple[str, str, str]] = []  # name with suffix, path, member
    for path in inputs:
        before = (
            f"{_without_suffix(path.resolve().name)}/"
            if len(inputs) > 1 and (path.is_dir() or _suffix(path) not in MESHES)
            else ""
        )
        found += [(before + name, file, member) for name, file, member in _listed(path)]
    if not found:
        places = ", ".join(map(str, inputs))
        raise ValueError(f"{places}: expected meshes ({', '.join(MESHES)}) or archives of them, got none")
    return _named(sorted(found))


def _listed(path: Path) -> Iterator[tuple[str, str, str]]:
    """List an input: names with suffix, paths and members."""
    if path.is_dir():
        yield from _in_folder(path)
        return
    existing(path, "a mesh, an archive, a list of them, or a folder")
    if _suffix(path) in _LISTS:
        for place, name, file, member in _rows(path):
            target = os.path.join(path.resolve().parent, file)
            if member or _suffix(target) in MESHES:
                inside = f"{_without_suffix(file)}/{member}" if member else file
                yield name + _suffix(inside) if name else inside, os.path.abspath(target), member
            elif _suffix(target) in _ARCHIVES:
                yield from _in_archive(target, name or _without_suffix(file))
            else:
                raise ValueError(f"{place}: expected a path that ends in {', '.join(MESHES + _ARCHIVES)}, got {file!r}")
    elif _suffix(path) in _ARCHIVES:
        yield from _in_archive(str(path))
    elif _suffix(path) in MESHES:
        yield path.name, os.path.abspath(path), ""
    else:
        expected = ", ".join(MESHES + _ARCHIVES + _LISTS)
        raise ValueError(f"{path}: expected a folder, or a file that ends in {expected}")


def _in_folder(folder: Path) -> Iterator[tuple[str, str, str]]:
    """List meshes and archives in a folder and those below, without hidden ones."""
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for file in (name for name in files if not name.startswith(".")):
            path = os.path.join(place, file)
            name = os.path.relpath(path, folder)
            if _suffix(file) in MESHES:
                yield name, os.path.abspath(path), ""
            elif _suffix(file) in _ARCHIVES:
                yield from _in_archive(path, _without_suffix(name))


def _in_archive(path: str, name: str = "") -> Iterator[tuple[str, str, str]]:
    """List the meshes in an archive with a name; the archive itself if it has none or cannot be read."""
    whole = os.path.abspath(path)
    try:
        with _Archive(whole) as archive:
            meshes = [name for name in archive.sizes if _suffix(name) in MESHES]
    except (OSError, ValueError):
        meshes = []
    if not meshes:
        yield f"{name or os.path.basename(path)}.archive", whole, ""
    yield from ((f"{name}/{mesh}" if name else mesh, whole, mesh) for mesh in meshes)


def _rows(path: Path) -> Iterator[tuple[str, str, str, str]]:
    """Read a list: place for messages, name, path and member of each row."""
    if _suffix(path) == ".txt":
        lines = enumerate(read_text(path).splitlines(), 1)
        yield from ((f"{path}, line {number}", "", line.strip(), "") for number, line in lines if line.strip())
        return
    table: Iterable[dict[str, str]] = _parquet_rows(path) if _suffix(path) == ".parquet" else read_table(path)
    for number, row in enumerate(table, 2):
        if not row.get("path"):
            raise ValueError(f'{path}, line {number}: expected a column "path" with a path, got none')
        yield f"{path}, line {number}", row.get("name") or "", row["path"], row.get("member") or ""


def read_table(path: Path) -> list[dict[str, str]]:
    """Read a .csv with a header: a dictionary for each row, of stripped text; empty lines are left out.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file cannot be parsed, or a row has more values than the header.
    """
    try:
        rows = list(csv.reader(read_text(existing(path)).splitlines()))
    except csv.Error as error:
        raise ValueError(f"{path}: expected CSV, got a file that cannot be parsed ({error})") from None
    header = [cell.strip() for cell in rows[0]] if rows else []
    table = []
    for number, row in enumerate(rows[1:], 2):
        if len(row) > len(header):
            raise ValueError(f"{path}, line {number}: expected {len(header)} columns, got {len(row)}")
        if any(cell.strip() for cell in row):
            table.append({name: cell.strip() for name, cell in zip(header, row, strict=False)})
    return table


def _parquet_rows(path: Path) -> Iterator[dict[str, str]]:
    parquet = load_parquet(path)
    try:
        with parquet.ParquetFile(path) as file:
            columns = [name for name in ("path", "name", "member") if name in file.schema_arrow.names]
            for batch in file.iter_batches(columns=columns):
                yield from batch.to_pylist()
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a table, got a file that cannot be read ({reason(error)})") from None


def load_parquet(path: Path) -> Any:
    """Import pyarrow.parquet, for a file."""
    return import_library("pyarrow.parquet", f"for {path.name}")


def _named(found: Sequence[tuple[str, str, str]]) -> list[ModelFile]:
    """Make models with unique names."""
    names = plain_names([name for name, _, _ in found])
    return sorted(ModelFile(name, path, member) for name, (_, path, member) in zip(names, found, strict=True))


def plain_names(names: Sequence[str]) -> list[str]:
    """Convert paths to unique names as of `ModelFile`, without suffixes where they differ without."""
    stems = [_plain(str(PurePosixPath(name.replace("\\", "/")).with_suffix(""))) for name in names]
    counts = Counter(stems)
    counts.update({str(folder) for stem in stems for folder in PurePosixPath(stem).parents})  # also names of folders
    taken: set[str] = set()
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
    """Replace what a name of a sample may not contain; no part of it is empty."""
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

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The archive cannot be read, has no meshes, or is too large.
    """
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
                for info in self._tar:
                    if mode == "r:gz" and info.offset_data + info.size > _MOST_UNPACKED:  # before it is unpacked
                        raise ValueError(f"more than {_MOST_UNPACKED >> 30} GiB unpacked")
                    if info.isreg():
                        self.sizes[info.name] = info.size
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
