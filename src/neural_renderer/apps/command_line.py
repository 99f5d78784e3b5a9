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
from typing import Any

import tyro

from ..version import __version__
from .commands import COMMANDS, Command
from .common.checks import UsageError
from .common.terminal import INTERRUPTED, say

_DESCRIPTION = """A differentiable mesh renderer. `neural-renderer COMMAND --help` explains each command,
--version shows the version.

Exit codes: 0 success, 1 error (with a message), 2 wrong usage, 3 a doubtful result (it is written, with the reason),
130 interrupted. With --debug after the command, or NEURAL_RENDERER_DEBUG=1 in the environment, an error shows its
traceback."""

_ARGUMENT = re.compile(r"\b([a-z_]+)=(True|False|[A-Z]+(?: [A-Z]+)*\b)")
"""An argument of the library in a message: allow_outside=True, masks=FOLDER."""
_ALIASES = {"-o": "--output", "--out": "--output", "-j": "--processes", "--iterations": "--steps"}


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line ``args`` (sys.argv without the program's name by default) and return the exit code."""
    _open_standard_handles()
    arguments = list(sys.argv[1:] if args is None else args)
    debug = os.environ.get("NEURAL_RENDERER_DEBUG", "") not in ("", "0") or "--debug" in arguments
    if arguments[:1] == ["--version"]:
        sys.stdout.write(f"neural-renderer {__version__}\n")
        return 0
    names: set[str] = set()
    try:
        with _plain_warnings(names):
            module, options = _parse(arguments)
            names |= set(_names(options))
            if hasattr(options, "validate"):
                options.validate()  # before the import of the command, which takes seconds
            return _load(module).run(options)
    except SystemExit as stop:  # --help (0) and wrong usage (2)
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except UsageError as error:
        say(str(error), "red")
        return 2
    except KeyboardInterrupt as stop:  # may say how to continue
        say(": ".join(("interrupted", *map(str, stop.args))), "yellow")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if debug:
            raise
        say(_name_options(_message(error), arguments, names), "red")
        return 1


def _open_standard_handles() -> None:
    """Open the standard input and outputs if they are closed, as for a daemon: files would get their numbers.

    Processes that are started here have them, too.
    """
    for handle in range(3):
        try:
            os.fstat(handle)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest number that is free


def _parse(
    arguments: list[str],
    commands: dict[str, Command] = COMMANDS,
    prog: str = "neural-renderer",
    description: str = _DESCRIPTION,
) -> tuple[str, Any]:
    """Parse arguments: return the module of the command and its options."""
    while arguments[:1] == ["--debug"]:
        arguments = arguments[1:]
    name, words = (arguments or ["--help"])[0], arguments[1:]
    if name not in commands:
        if not name.startswith("-"):
            close = difflib.get_close_matches(name, commands, 1)
            advice = f"; did you mean {close[0]}?" if close else ""
            raise UsageError(f"{prog}: expected one of {', '.join(commands)}, got {name!r}{advice}")
        choices: dict[str, Any] = {name: _placeholder(command.summary) for name, command in commands.items()}
        return "", tyro.extras.subcommand_cli_from_dict(choices, prog=prog, description=description, args=[name])
    command, prog = commands[name], f"{prog} {name}"
    if command.module.endswith(".commands"):
        group = _load(command.module)
        return _parse(words, group.COMMANDS, prog, group.DESCRIPTION)
    known = _load(command.options)
    if hasattr(known, "parse"):
        return command.module, known.parse(words, prog)
    words = [word for word in words if word != "--debug"]
    return command.module, tyro.cli(getattr(known, f"{name.capitalize()}Options"), prog=prog, args=words)


def command_names() -> Iterator[str]:
    """List all commands; those of a group have its name before theirs."""
    for name, command in COMMANDS.items():
        group = _load(command.module).COMMANDS if command.module.endswith(".commands") else [""]
        yield from (f"{name} {part}".strip() for part in group)


def _load(module: str) -> Any:
    """Import a module of the applications without garbage collection, which would go through all that torch has."""
    name = f"neural_renderer.apps.{module}"
    if name in sys.modules:
        return sys.modules[name]
    gc.disable()
    try:
        return importlib.import_module(name)
    finally:
        gc.freeze()  # later collections leave out what is loaded now
        gc.enable()


def _placeholder(summary: str) -> Callable[..., Any]:
    """Make a command without options, for the list of commands."""

    def command() -> None: ...

    command.__doc__ = summary
    return command


@contextlib.contextmanager
def _plain_warnings(names: set[str]) -> Iterator[None]:
    """Print warnings without the place in the source code, with the options of these names."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        say(_name_options(" ".join(str(message).splitlines()), (), names), "yellow")

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


def _names(options: Any) -> Iterator[str]:
    """List the names of options, those in groups, too."""
    for name, value in vars(options).items():
        yield from _names(value) if dataclasses.is_dataclass(value) else (name,)


def _name_options(message: str, arguments: Sequence[str], names: set[str]) -> str:
    """Replace names of arguments of the library by options.

    These are a name at the start of the message, if the option is among the ``arguments``, and phrases such as
    allow_outside=True and masks=FOLDER, if the command has options of these ``names``.
    """

    def option(found: re.Match[str]) -> str:
        name, value = found[1], found[2]
        if name not in names:
            return found[0]
        flag = name.replace("_", "-")
        return {"True": f"--{flag}", "False": f"--no-{flag}"}.get(value, f"--{flag} {value}")

    message = _ARGUMENT.sub(option, message)
    name, _, rest = message.partition(":")
    flag = "--" + name.replace("_", "-")
    given = {argument.partition("=")[0].replace("_", "-") for argument in arguments}
    return f"{flag}:{rest}" if flag in {_ALIASES.get(each, each) for each in given} else message


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
