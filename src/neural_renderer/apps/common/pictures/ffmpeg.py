"""The program ffmpeg, for local files of known formats.

ffmpeg takes a path for an address or a list of files where it looks like one, and a file for a playlist that names
others, whatever its suffix. So paths are absolute and have the scheme "file:", and inputs may be of three formats only.
"""

from __future__ import annotations

import errno
import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from fractions import Fraction
from typing import Any

import imageio_ffmpeg

_FORMATS = "mov,matroska,avi"  # .mp4, .m4v and .mov; .mkv and .webm; .avi


def from_file(path: str | os.PathLike[str], *options: str) -> list[str]:
    """Return the arguments for an input: no other file is opened for it, and no address."""
    return ["-protocol_whitelist", "file", "-format_whitelist", _FORMATS, *options, "-i", to_file(path)]


def to_file(path: str | os.PathLike[str]) -> str:
    """Return the argument for an output."""
    return f"file:{os.path.abspath(path)}"


@contextmanager
def running(arguments: Sequence[str], reads: bool = False) -> Iterator[Any]:
    """Run ffmpeg; give its output to be read, or with ``reads`` its input. OSError: It failed; the reason is its own.

    It is killed where the block ends before it does.
    """
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-v", "error", *([] if reads else ["-nostdin"])]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE} if reads else {"stdin": subprocess.DEVNULL}
    pipes["stdout"] = subprocess.DEVNULL if reads else subprocess.PIPE
    with tempfile.TemporaryFile() as messages:  # a pipe could fill up and block it
        with subprocess.Popen([*command, *arguments], stderr=messages, **pipes) as process:
            try:
                yield process.stdin if reads else process.stdout
                if reads:
                    with suppress(BrokenPipeError):
                        process.stdin.close()  # type: ignore[union-attr]
                elif process.stdout.read(1):  # type: ignore[union-attr]
                    return  # enough is read
                process.wait()
            except BrokenPipeError:  # it has ended; its message follows
                process.wait()
            finally:
                is_over = process.poll() is not None
                process.kill()
        messages.seek(0)
        last = messages.read().decode(errors="replace").strip().rpartition("\n")[2].rpartition("] ")[2]
        if is_over and process.returncode:
            last = last.replace(os.strerror(errno.ENOMEM), "it takes more memory than there is")
            raise OSError(last or f"exit status {process.returncode}")


def frame_times(path: str | os.PathLike[str], most: int) -> tuple[int, float, tuple[int, int]]:
    """Count the frames of a video without decoding them, up to ``most``: number, seconds, and width and height.

    OSError: It cannot be read.
    """
    unit, size, count, first, last = Fraction(0), (0, 0), 0, None, 0
    with running([*from_file(path), "-map", "0:v:0", "-c", "copy", "-f", "framecrc", "-"]) as lines:
        for line in lines:
            key, _, value = line.decode("ascii", "replace").partition(":")
            if key == "#tb 0":
                unit = Fraction(value.strip())
            elif key == "#dimensions 0":
                width, height = map(int, value.strip().split("x"))
                size = width, height
            elif not key.startswith("#"):
                _, _, shown, lasting = map(int, line.split(b",")[:4])
                count, first = count + 1, shown if first is None else min(first, shown)
                last = max(last, shown + lasting)
            if count == most:
                break
    return count, float((last - (first or 0)) * unit), size
