"""The console command `neural-renderer`: finds the subcommand, and turns errors into one sentence and an exit code."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import tyro
from rich.console import Console
from rich.text import Text

# Name → (module below `commands`, its dataclass with a method `run` that returns the exit code, summary). The dataclass
# adds that method to the command's options, which `commands.options` has, and is imported only when there is something
# to do: help and complaints about options come at once, without torch. A table in place of the dataclass makes a group.
COMMANDS = {
    "render": ("render", "Render", "Draw a mesh file as a picture or as a turntable."),
    "info": ("info", "Info", "Show versions and devices, and check that rendering works."),
    "fit": ("fit", "Fit", "Recover a textured mesh from images with known cameras."),
    "reconstruct": ("reconstruct", "COMMANDS", "Turn one picture into a mesh."),
    "style": ("style", "Style", "Give a mesh the style of a painting."),
    "dream": ("dream", "Dream", "Turn a mesh into what a network sees in it."),
    "demo": ("demo", "Demo", "Make pictures that show what the package does."),
}

_DESCRIPTION = """A differentiable mesh renderer: `neural-renderer COMMAND --help` explains each command.

Exit codes: 0 done, 1 something was wrong (one sentence says what), 2 wrong usage, 130 interrupted. With --debug after
the command, or NEURAL_RENDERER_DEBUG=1 in the environment, an error shows where it happened."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line ``args`` (sys.argv without the program's name by default) and return the exit code."""
    arguments = list(sys.argv[1:] if args is None else args)
    debug = os.environ.get("NEURAL_RENDERER_DEBUG", "") not in ("", "0") or "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"] or ["--help"]
    try:
        with _plain_warnings():
            module, kind, options = _parse(arguments)
            return getattr(_load(module), kind)(**vars(options)).run()
    except SystemExit as stop:  # --help (0) and wrong usage (2)
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except KeyboardInterrupt:
        _say("interrupted", "yellow")
        return 130
    except BrokenPipeError:  # the reader of our output, such as `head`, has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if debug:
            raise
        _say(_in_options(_sentence(error), arguments), "red")
        return 1


def _parse(
    arguments: list[str],
    table: dict[str, tuple[str, str, str]] = COMMANDS,
    folder: str = "",
    prog: str = "neural-renderer",
    description: str = _DESCRIPTION,
) -> tuple[str, str, Any]:
    """The module and the class of the command that ``arguments`` name, and its options, filled in."""
    name = arguments[0]
    module, kind, _ = table.get(name, ("", "", ""))
    module = folder + module
    if kind == "COMMANDS":
        group = _load(module)
        prog = f"{prog} {name}"
        return _parse(arguments[1:] or ["--help"], group.COMMANDS, f"{module}.", prog, group.DESCRIPTION)
    called = getattr(_load(f"options.{module}"), f"{kind}Options") if kind else None
    commands: dict[str, Any] = {
        other: called if other == name else _stand_in(summary) for other, (_, _, summary) in table.items()
    }
    options = tyro.extras.subcommand_cli_from_dict(commands, prog=prog, description=description, args=arguments)
    return module, kind, options


def _load(module: str) -> Any:
    return importlib.import_module(f"neural_renderer.commands.{module}")


def _stand_in(summary: str) -> Callable[..., Any]:
    """A command as the list of commands needs it."""

    def command() -> None: ...

    command.__doc__ = summary
    return command


def _say(message: str, style: str) -> None:
    """One line to the user, beside what the command puts out."""
    Console(stderr=True).print(Text(message, style=style), soft_wrap=True)


@contextlib.contextmanager
def _plain_warnings() -> Iterator[None]:
    """Warnings as what they say, without a place in a program that the user did not write."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_, **__: _say(" ".join(str(message).splitlines()), "yellow")
        yield


def _in_options(message: str, arguments: Sequence[str]) -> str:
    """The message, with the library's name of an argument replaced by the option that gave it: ``--texture-size``."""
    name, _, rest = message.partition(":")
    option = "--" + name.replace("_", "-")
    given = {argument.partition("=")[0].replace("_", "-") for argument in arguments}
    return f"{option}:{rest}" if option in given else message


def _sentence(error: Exception) -> str:
    """What went wrong, on one line; an error that nobody foresaw is named and says how to learn more."""
    message = " ".join(str(error).split())
    if isinstance(error, OSError) and error.strerror:
        return f"{os.fsdecode(error.filename)}: {error.strerror}" if error.filename else error.strerror
    if isinstance(error, (ValueError, TypeError, OSError)) and message:
        return message
    return f"{type(error).__name__}: {message} (--debug shows where)"


if __name__ == "__main__":
    sys.exit(main())
