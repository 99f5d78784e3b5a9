"""This machine's own C++ compiler, with sanitizers, for the headers in ``raster/kernels``.

``python -m tests.native.compiler address`` writes the environment variables that a Python needs whose kernels have the
address sanitizer.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

from neural_renderer.raster.warp.native import HEADERS

HERE = Path(__file__).parent
SANITIZERS = {
    "none": [],
    "address": ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"],
    "thread": ["-fsanitize=thread"],
}
# GCC warns that wide vectors are passed in another way if the processor has none: this matters between libraries only.
# clang warns of a & b of truth values, which is meant: it has no branch.
_WARNINGS = ["-Wall", "-Wextra", "-Werror", "-Wno-psabi", "-Wno-bitwise-instead-of-logical"]
# One rounding for each operation, as Warp compiles the headers. -g1: the lines of the source, which sanitizers name.
_FLAGS = ["-std=c++17", "-O1", "-g1", "-ffp-contract=off", "-pthread", f"-I{HEADERS}", f"-I{HERE}", *_WARNINGS]
# The runtime of each sanitizer and the library that it looks into, and its options. Leaks would be those of Python.
_RUNTIMES = {
    "address": ("libasan.so", "ASAN_OPTIONS", "detect_leaks=0"),
    "thread": ("libtsan.so", "TSAN_OPTIONS", "ignore_noninstrumented_modules=1:halt_on_error=1"),
}
MISSING = "no C++ compiler with sanitizers: expected g++ (12 or later) or clang++ (15 or later)"


@cache
def compiler() -> str | None:
    """Find a compiler that knows the headers' vectors and sanitizers: ``$CXX``, g++ or clang++; None if none does."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "probe.cpp")
        source.write_text('#include "lanes.h"\nint main() {}\n', encoding="utf-8")
        for name in [os.environ["CXX"]] if "CXX" in os.environ else ["g++", "clang++"]:
            commands = [[name, *_FLAGS, *flags, source, "-o", f"{source}.out"] for flags in SANITIZERS.values()]
            if shutil.which(name) and all(_run(one).returncode == 0 for one in commands):
                return name
    return None


def compile_source(source: Path, sanitizer: str, *flags: str | Path) -> None:
    """Compile a file.

    Args:
        source: With its ending .cpp.
        sanitizer: Key of `SANITIZERS`.
        flags: Further ones, such as "-o" and the result's path.

    Raises:
        LookupError: There is no compiler.
        ValueError: The source has errors or warnings, which the message lists.
    """
    name = compiler()
    if name is None:
        raise LookupError(MISSING)
    done = _run([name, *_FLAGS, *SANITIZERS[sanitizer], source, *flags])
    if done.returncode:
        raise ValueError(f"{source}: expected C++ without warnings, got\n{done.stderr}")


def without_sanitizer() -> dict[str, str]:
    """Return the environment variables for programs that have no sanitizer, or their own."""
    return {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}


def _run(command: list[str | Path]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, env=without_sanitizer())


def environment(sanitizer: str) -> dict[str, str]:
    """Return the environment variables of a Python whose kernels have a sanitizer: its runtime has to come first.

    Raises:
        LookupError: The compiler has no runtime that another program can load; g++ on Linux has.
    """
    runtime, variable, options = _RUNTIMES[sanitizer]
    name = compiler()
    if name is None:
        raise LookupError(MISSING)
    ask = [[name, f"-print-file-name={library}"] for library in (runtime, "libstdc++.so")]
    found = [_run(one).stdout.strip() for one in ask]
    if "clang" in name or not all(map(os.path.isabs, found)):
        raise LookupError(f"{name}: expected g++ (12 or later) with {runtime}, for Python to load")
    return {"LD_PRELOAD": ":".join(found), variable: options}


if __name__ == "__main__":
    try:
        sys.stdout.write("\n".join(f"{name}={value}" for name, value in environment(sys.argv[1]).items()))
    except LookupError as error:
        sys.exit(str(error))
