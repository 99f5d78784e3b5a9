"""Fuzzers: each makes inputs from random numbers, and says what has to hold for any input.

An input is a file's name and its bytes. Inputs that once failed lie in ``crashes``/fuzzer/number/name. They are tests,
and fuzzers start from them, too.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import torch

from tests.fuzz import calls, messages
from tests.fuzz.edits import changed
from tests.fuzz.kinds import FILES
from tests.test_hostile_files import Kind, bounded, check

CRASHES = Path(__file__).parent / "crashes"
_OLD = 0.1  # share of inputs that begin with one that once failed


class Fuzzer(Protocol):
    """Makes inputs, and runs them."""

    def draw(self, rng: random.Random) -> tuple[str, bytes]:
        """Make an input from random numbers: its name and bytes."""
        ...

    def run(self, name: str, data: bytes) -> None:
        """Run an input; an exception says what does not hold."""
        ...

    def close(self) -> None:
        """End what has been started."""
        ...


class FilesFuzzer:
    """Changes files of a kind in a folder: they are read, or a sentence names one of them."""

    def __init__(self, name: str, kind: Kind, folder: Path) -> None:
        self._kind, self._folder = kind, folder
        torch.manual_seed(0)
        self._names = kind.write(folder)
        kind.read(folder)
        self._old = kept(name)

    def draw(self, rng: random.Random) -> tuple[str, bytes]:
        """Change one of the good files, or one that once failed."""
        if self._old and rng.random() < _OLD:
            name, data = rng.choice(self._old)
        else:
            name = rng.choice(self._names)
            data = (self._folder / name).read_bytes()
        return name, changed(data, self._kind.containers, rng)

    def run(self, name: str, data: bytes) -> None:
        """Read all with this file in place of the good one, or beside the good ones."""
        path = self._folder / name
        if not (is_known := path.exists()):
            path.write_bytes(data)
        check(path, lambda _: data, lambda: self._kind.read(self._folder))
        if not is_known:
            path.unlink()

    def close(self) -> None: ...


class CallsFuzzer:
    """Calls the interface of nvdiffrast."""

    def draw(self, rng: random.Random) -> tuple[str, bytes]:
        """Make a call."""
        return "call.json", calls.draw(rng)

    def run(self, name: str, data: bytes) -> None:
        """Do it."""
        with bounded():
            calls.run(data)

    def close(self) -> None: ...


def kept(name: str) -> list[tuple[str, bytes]]:
    """Return the inputs of a fuzzer that once failed."""
    found = []
    for number in sorted(CRASHES.glob(f"{name}/*")):
        found += [
            (path.relative_to(number).as_posix(), path.read_bytes()) for path in number.rglob("*") if path.is_file()
        ]
    return found


def keep(name: str, file: str, data: bytes, folder: Path = CRASHES) -> Path:
    """Write an input that failed to where tests find it."""
    import hashlib

    path = folder / name / hashlib.sha256(data).hexdigest()[:8] / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def _of_files(name: str) -> Callable[[Path], Fuzzer]:
    return lambda folder: FilesFuzzer(name, FILES[name], folder)


FUZZERS: dict[str, Callable[[Path], Fuzzer]] = {
    **{name: _of_files(name) for name in FILES},
    "calls": lambda folder: CallsFuzzer(),
    "messages": lambda folder: messages.MessagesFuzzer(),
}
