"""The console command `neural-renderer`: runs a subcommand and turns errors into a message and an exit code."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import gc
import importlib
import itertools
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NoReturn

import tyro
from rich.console import Console
from rich.text import Text

from .version import __version__

# Command → summary. The options of the command `render` are the class `RenderOptions` in `commands.options`; the
# function `run(options)` in `commands.render` returns the exit code, and likewise for other commands. A command is
# imported when it runs, so that help and messages about wrong options do not wait for the import of torch.
COMMANDS = {
    "render": "Draw a mesh file as a picture or a turntable.",
    "info": "Show versions and devices, and check that rendering works.",
    "fit": "Recover a textured mesh from images with known cameras.",
    "pose": "Find the pose of a known object in pictures.",
    "dataset": "Draw views of many models.",
    "batch": "Run fit, style or dream many times.",
    "reconstruct": "Reconstruct a mesh from a single picture.",
    "style": "Transfer the style of a painting to a mesh.",
    "dream": "Apply DeepDream to a mesh.",
    "view": "Show meshes, results and records in the browser.",
    "run": "Run a program that needs nvdiffrast or CUDA, without them.",
    "demo": "Draw a turntable, and fit a sphere to a duck.",
}
_GROUPS = ("reconstruct",)  # commands with subcommands; the package of each lists them as COMMANDS
_MANY = ("dataset", "batch")  # commands whose modules are in the package `many`

_DESCRIPTION = """A differentiable mesh renderer. `neural-renderer COMMAND --help` explains each command,
--version shows the version.

Exit codes: 0 success, 1 error (with a message), 2 wrong usage, 3 a fit whose outlines do not match the masks (its
results are written), 130 interrupted. With --debug after the command, or NEURAL_RENDERER_DEBUG=1 in the environment, an
error shows its traceback."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line ``args`` (sys.argv without the program's name by default) and return the exit code."""
    _open_standard_handles()
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


def _open_standard_handles() -> None:
    """Open the standard input and outputs where they are closed, as for a daemon: files would get their numbers."""
    for handle in range(3):
        try:
            os.fstat(handle)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free


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
    commands: dict[str, str] = COMMANDS,
    package: str = "",
    prog: str = "neural-renderer",
    description: str = _DESCRIPTION,
) -> tuple[str, Any]:
    """Parse arguments: return the module of the command, relative to `commands`, and its options."""
    name = arguments[0]
    package = "many." if name in _MANY and not package else package
    module = package + name
    if name in _GROUPS:
        group = _load(module)
        return _parse(arguments[1:] or ["--help"], group.COMMANDS, f"{module}.", f"{prog} {name}", group.DESCRIPTION)
    if name in commands:
        known = _load(f"{package}options")
        if name == "render":
            _check_save(arguments, known.SAVED)
        if name in ("render", "dataset") and not package.startswith("reconstruct"):
            _check_size(arguments)
        arguments, others = _split_program(arguments)
        kind = getattr(known, f"{name.capitalize()}Options")
        if hasattr(kind, "steps"):  # some commands once called them iterations
            arguments = [re.sub(r"^--iterations(?=$|=)", "--steps", argument) for argument in arguments]
        options = tyro.cli(kind, prog=f"{prog} {name}", args=arguments[1:])
        return module, dataclasses.replace(options, arguments=tuple(others)) if others else options
    if not name.startswith("-"):
        close = difflib.get_close_matches(name, commands, 1)
        advice = f"; did you mean {close[0]}?" if close else ""
        _refuse(f"{prog}: expected one of {', '.join(commands)}, got {name!r}{advice}")
    choices: dict[str, Any] = {command: _placeholder(summary) for command, summary in commands.items()}
    return module, tyro.extras.subcommand_cli_from_dict(choices, prog=prog, description=description, args=arguments)


def _check_save(arguments: list[str], known: tuple[str, ...]) -> None:
    """End with a message unless --save is given once at most, with known names, each followed by a file."""
    places = [place for place, argument in enumerate(arguments) if argument.partition("=")[0] == "--save"]
    if not places:
        return
    words = list(itertools.takewhile(lambda word: not word.startswith("-"), arguments[places[0] + 1 :]))
    wrong = [word for word in words[::2] if word not in known]
    if len(places) > 1:
        problem = f"expected at most once, with all its values, got it {len(places)} times"
    elif wrong:
        problem = f"expected each name to be one of {', '.join(known)}, got {wrong[0]!r}"
    elif not words or len(words) % 2:
        problem = f"expected names and files in turn, such as {known[0]} {known[0]}.png, got {' '.join(words)!r}"
    else:
        return
    _refuse(f"--save: {problem}")


def _check_size(arguments: list[str]) -> None:
    """End with a message if the first value of --size is no number: tyro's message is long."""
    for place, argument in enumerate(arguments):
        option, equals, value = argument.partition("=")
        value = value if equals else "".join(arguments[place + 1 : place + 2])
        if option == "--size" and not re.fullmatch(r"[+-]?\d+", value):
            _refuse(f"--size: expected a side, or height and width such as --size 480 640, in pixels, got {value!r}")


def _refuse(message: str) -> NoReturn:
    _say(message, "red")
    raise SystemExit(2)


def _load(module: str) -> Any:
    gc.disable()  # imports leave little garbage, and each search for it goes through all that torch has
    try:
        return importlib.import_module(f"neural_renderer.commands.{module}")
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
