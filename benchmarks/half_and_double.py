"""Tables of constants at half and double their value, for the page of constants."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import Any

import torch

Stage = tuple[Mapping[ModuleType, str], Callable[[], str]]
"""Names of constants of modules, separated by spaces, and the score that they change."""


def run_stages(program: str, description: str | None, stages: Mapping[str, Stage]) -> None:
    """Print the `section` of each stage that the command line names, or of all, on one thread."""
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument("stages", nargs="*", choices=[[], *stages], help="stages; all by default")
    torch.set_num_threads(1)
    for name in parser.parse_args().stages or stages:
        section(name, *stages[name])


def section(title: str, constants: Mapping[ModuleType, str], score: Callable[[], str]) -> None:
    """Print a title and a `table` with its heading; the names of a module's constants are separated by spaces."""
    print(f"\n{title}\n| constant | half | value | double |\n|---|---|---|---|")
    table({module: names.split() for module, names in constants.items()}, score)


def table(constants: Mapping[ModuleType, Iterable[str]], score: Callable[[], str]) -> None:
    """Print a row of a table for each constant: the score at half, as it is, and at double.

    Halves and doubles that are equal to the value are left out, and errors are scores.
    """
    usual = score()
    for module, names in constants.items():
        stem = module.__name__.rpartition(".")[2]
        for name in names:
            _row(f"{stem}.{name}", getattr(module, name), partial(replaced, module, name), usual, score)


def table_of_defaults(functions: Mapping[Any, str], score: Callable[[], str]) -> None:
    """Print the same for arguments of functions, or fields of dataclasses, whose defaults nothing else repeats."""
    usual = score()
    for function, names in functions.items():
        call = inspect.unwrap(function.__init__ if isinstance(function, type) else function)
        for name in names.split():
            value = inspect.signature(call).parameters[name].default
            _row(f"{function.__name__}.{name}", value, partial(_default, call, name), usual, score)


def _row(text: str, value: Any, change: Callable[[Any], Any], usual: str, score: Callable[[], str]) -> None:
    cells = []
    for factor in (0.5, 2.0):
        other = scaled(value, factor)
        with change(other):
            cells.append(usual if other == value else _safely(score))
    print(f"| `{text} = {value}` | {cells[0]} | {usual} | {cells[1]} |", flush=True)


@contextmanager
def _default(call: Any, name: str, value: Any) -> Iterator[None]:
    """Give an argument another default for a while."""
    before = call.__defaults__, call.__kwdefaults__
    of_places = [one.name for one in inspect.signature(call).parameters.values() if one.default is not one.empty]
    of_places = of_places[: len(before[0] or ())]
    call.__kwdefaults__ = {**(before[1] or {}), **({} if name in of_places else {name: value})} or None
    call.__defaults__ = tuple(
        value if one == name else old for one, old in zip(of_places, before[0] or (), strict=True)
    )
    try:
        yield
    finally:
        call.__defaults__, call.__kwdefaults__ = before


def scaled(value: Any, factor: float) -> Any:
    """Multiply a number or each of a tuple; a share above 0.5 and a margin below 1.5 by their distance from 1.

    Counts are at least 1, and odd ones stay odd: they may be sides of windows.
    """
    if isinstance(value, tuple):
        return tuple(scaled(part, factor) for part in value)
    if isinstance(value, int):
        return max(1, int(factor * value) | (value & 1 if value > 1 else 0))
    return 1 - factor * (1 - value) if 0.5 < value < 1 or 1 < value < 1.5 else factor * value


@contextmanager
def replaced(module: ModuleType, name: str, value: Any) -> Iterator[None]:
    """Give a constant another value for a while."""
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)


def _safely(score: Callable[[], str]) -> str:
    try:
        return score()
    except (RuntimeError, ValueError, IndexError, ZeroDivisionError) as error:
        return f"{type(error).__name__}"
