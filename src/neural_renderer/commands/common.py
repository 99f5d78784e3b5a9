"""What the subcommands share: checks of their options, and a first Ctrl-C that lets a step end."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import torch

from ..io.named_files import names_file


def chosen_device(name: str) -> torch.device:
    """The device that an option names: "cpu", "cuda", or "auto"; ValueError where CUDA is asked for and missing."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device: expected cpu, got cuda, but torch finds no CUDA device here")
    return torch.device(name)


def checked_count(name: str, value: int, least: int) -> int:
    """``value`` if it is at least ``least``; otherwise ValueError names the option."""
    if value < least:
        raise ValueError(f"--{name.replace('_', '-')}: expected at least {least}, got {value}")
    return value


def output_folder(option: str, folder: Path) -> Path:
    """The folder, made if missing; OSError names the ``option`` if it cannot be, or cannot be written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        reason = None if os.access(folder, os.W_OK) else "no permission"
    except OSError as error:
        reason = error.strerror
    if reason:
        raise OSError(f"{option}: expected a folder that can be written, got {folder} ({reason})")
    return folder


def check_outputs(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Raise ValueError if a file that is to be written is one of ``inputs``, or one that they name, such as a texture.

    What does not exist is in nobody's way, and None stands for an input that is not given.
    """
    given = [path for path in inputs if path is not None and path.is_file()]
    read = {(status.st_dev, status.st_ino) for status in map(Path.stat, given)}
    for output in filter(Path.exists, outputs):
        status = output.stat()
        if (status.st_dev, status.st_ino) in read:
            raise ValueError(f"--output: expected a file that may be replaced, got {output}, which is an input")
        for path in given:
            if names_file(path, output):
                raise ValueError(f"--output: expected a file that may be replaced, got {output}, which {path} uses")


@contextmanager
def interruption() -> Iterator[list[int]]:
    """A list that the first Ctrl-C puts a signal into; the second one interrupts as ever."""
    found: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        found.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield found
    finally:
        signal.signal(signal.SIGINT, before)
