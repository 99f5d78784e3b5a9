"""Test of whether a file names another one, which must then not be replaced."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import unquote

from ...io.files import read_text
from ...io.named_files import find_file

_LONGEST = 4096  # characters of a name; a longer text is data
_NAMING = (".obj", ".mtl", ".ply", ".gltf", ".glb", ".json", ".csv")  # suffixes of files that name others
_NO_NUMBERS = re.compile(r"^[^\S\n]*[^\svf#].*", re.MULTILINE)  # lines of an OBJ file that may name one


def names_file(path: Path, other: Path, *folders: Path) -> bool:
    """Test whether a mesh file, its material files or a camera file may name the file ``other``.

    Names are matched in any case, with or without suffix, as written or by their last part, relative to the folder of
    the file and to ``folders``.
    """
    suffix, folders = path.suffix.lower(), (path.parent, *folders)
    if suffix not in _NAMING:
        return False
    known = other.resolve(), other.parent.resolve() / other.name  # the same unless it is a link
    wanted, stems = {str(file).lower() for file in known}, {file.stem.lower() for file in known}
    wanted |= {name.removesuffix(other.suffix.lower()) for name in wanted}
    roots = [str(folder.resolve()).lower() for folder in folders]
    text = read_text(path)
    find = partial(find_file, path, allow_outside=True, listings={})
    for line in re.findall(_NO_NUMBERS, text) if suffix == ".obj" else text.split("\n"):
        keyword, _, rest = line.strip().partition(" ")
        if suffix == ".obj" and keyword.lower() == "mtllib":
            names = rest, *rest.split()
            libraries = {find(name.strip('"'), *folders) for name in dict.fromkeys(names)}
            if any(names_file(library, other, *folders) for library in libraries if library):
                return True
        line = (unquote(line) if suffix in (".gltf", ".glb") else line).lower().replace("\\", "/")
        if any(stem in line for stem in stems):
            paths = (os.path.normpath(os.path.join(root, name)) for root in roots for name in _names(line))
            if any(named in wanted for named in paths):
                return True
    return False


def _names(line: str) -> Iterator[str]:
    """Iterate over possible file names in a line: its last words, quoted parts, and parts between commas."""
    end = ""
    for word in reversed(line.split()):
        end = f"{word} {end}".rstrip()
        if len(end) > _LONGEST:
            break
        yield from (end.strip('"'), os.path.basename(end.strip('"')))
    # A key of JSON without a dot is no name of a file: "k" does not name k.png.
    quoted = [name for name, colon in re.findall(r'"([^"]*)"(\s*:)?', line) if not colon or "." in name]
    for name in (*quoted, *line.split(",")):
        if len(name) <= _LONGEST:
            yield from (name, os.path.basename(name))
