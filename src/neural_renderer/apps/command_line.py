"""The console command `neural-renderer`: runs a subcommand and turns errors into a message and an exit code."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import gc
import importlib
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NoReturn

import tyro
from rich.console import Console
from rich.text import Text

from ..version import __version__
from .commands import COMMANDS, Command

_DESCRIPTION = """A differentiable mesh renderer. `neural-renderer COMMAND --help` explains each command,
--version shows the version.

Exit codes: 0 success, 1 error (with a message), 2 wrong usage, 3 a doubtful result (it is written, with the reason),
130 interrupted. With --debug after the command, or NEURAL_RENDERER_DEBUG=1 in the environment, an error shows its
traceback."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line ``args`` (sys.argv without the program's name by default) and return the exit code."""
    own, others = _split_program(list(sys.argv[1:] if args is None else args))
    debug = os.environ.get("NEURAL_RENDERER_DEBUG", "") not in ("", "0") or "--debug" in own
    arguments = [*(argument for argument in own if argument != "--debug"), *others] or ["--help"]
    if arguments[0] == "--version":
        sys.stdout.write(f"neural-renderer {__version__}\n")
        return 0
    try:
        with _plain_warnings():
            module, options = _parse(arguments)
            return _load(module).run(options)
    except SystemExit as stop:  # --help (0) and wrong usage (2)
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except KeyboardInterrupt as stop:  # may say how to continue
        _say(": ".join(("interrupted", *map(str, stop.args))), "yellow")
        return 130
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if debug:
            raise
        _say(_name_option(_message(error), arguments), "red")
        return 1


def _split_program(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Split the arguments of `run` after the program: the others are its own."""
    if arguments[:1] != ["run"]:
        return arguments, []
    place = 1
    while place < len(arguments) and arguments[place].startswith("-"):
        place += 2 if arguments[place] == "--device" else 1
    return arguments[: place + 1], arguments[place + 1 :]


def _parse(
    arguments: list[str],
    commands: dict[str, Command] = COMMANDS,
    prog: str = "neural-renderer",
    description: str = _DESCRIPTION,
) -> tuple[str, Any]:
    """Parse arguments: return the module of the command and its options."""
    name = arguments[0]
    if name not in commands:
        if not name.startswith("-"):
            close = difflib.get_close_matches(name, commands, 1)
            advice = f"; did you mean {close[0]}?" if close else ""
            _refuse(f"{prog}: expected one of {', '.join(commands)}, got {name!r}{advice}")
        choices: dict[str, Any] = {name: _placeholder(command.summary) for name, command in commands.items()}
        return "", tyro.extras.subcommand_cli_from_dict(choices, prog=prog, description=description, args=arguments)
    command, prog = commands[name], f"{prog} {name}"
    if command.module.endswith(".commands"):
        group = _load(command.module)
        return _parse(arguments[1:] or ["--help"], group.COMMANDS, prog, group.DESCRIPTION)
    known = _load(command.options)
    problem = known.find_problem(arguments) if hasattr(known, "find_problem") else None
    if problem:
        _refuse(problem)
    arguments, others = _split_program(arguments)
    kind = getattr(known, f"{name.capitalize()}Options")
    if hasattr(kind, "steps"):  # some commands once called them iterations
        arguments = [re.sub(r"^--iterations(?=$|=)", "--steps", argument) for argument in arguments]
    options = tyro.cli(kind, prog=prog, args=arguments[1:])
    return command.module, dataclasses.replace(options, arguments=tuple(others)) if others else options


def _refuse(message: str) -> NoReturn:
    _say(message, "red")
    raise SystemExit(2)


def _load(module: str) -> Any:
    gc.disable()  # imports leave little garbage, and each search for it goes through all that torch has
    try:
        return importlib.import_module(f"neural_renderer.apps.{module}")
    finally:
        gc.enable()


def _placeholder(summary: str) -> Callable[..., Any]:
    """Make a command without options, for the list of commands."""

    def command() -> None: ...

    command.__doc__ = summary
    return command


def _say(message: str, style: str) -> None:
    """Print one line to standard error."""
    Console(stderr=True).print(Text(message, style=style), soft_wrap=True)


@contextlib.contextmanager
def _plain_warnings() -> Iterator[None]:
    """Print warnings without the place in the source code."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: _say(" ".join(str(message).splitlines()), "yellow")
        yield


def _name_option(message: str, arguments: Sequence[str]) -> str:
    """Replace the name of a library argument at the start of a message by the option that set it, if there is one."""
    name, _, rest = message.partition(":")
    option = "--" + name.replace("_", "-")
    given = {argument.partition("=")[0].replace("_", "-") for argument in arguments}
    return f"{option}:{rest}" if option in given else message


def _message(error: Exception) -> str:
    """Format an error on one line, or with an indented list; unexpected errors are named and mention --debug."""
    message = "\n  ".join(" ".join(part.split()) for part in str(error).split("\n  "))
    if isinstance(error, OSError) and error.strerror:
        return f"{os.fsdecode(error.filename)}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, ModuleNotFoundError) and "pip install" in message:
        return message
    if isinstance(error, (ValueError, TypeError, OSError)) and message:
        return message
    return f"{type(error).__name__}: {message} (--debug shows a traceback)"


if __name__ == "__main__":
    sys.exit(main())
