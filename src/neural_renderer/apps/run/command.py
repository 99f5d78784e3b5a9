"""`neural-renderer run`: an unchanged program, with this package for nvdiffrast and PyTorch3D, and the CPU for CUDA."""

from __future__ import annotations

import contextlib
import os
import runpy
import sys
import traceback
import warnings
from pathlib import Path

from ...compat.nvdiffrast.stand_in import stand_in
from .cuda_on_cpu import cuda_on_cpu
from .options import RunOptions
from .pytorch3d.stand_in import stand_in as pytorch3d_stand_in
from .stand_ins.finder import generators_stand_in


def run(options: RunOptions) -> int:
    """Run the program; return its exit code, 1 if it ends with an error or a message."""
    program = options.program
    sys.argv = [program, *options.arguments]
    sys.path.insert(0, os.getcwd() if options.module else str(Path(program).resolve().parent))
    warnings.showwarning = warnings._showwarning_orig  # type: ignore[attr-defined]  # as Python shows them
    ours = options.ours
    names = stand_in(ours), pytorch3d_stand_in(ours), generators_stand_in(ours)
    with contextlib.ExitStack() as stack:
        for each in (*names, cuda_on_cpu(always=options.device == "cpu")):
            stack.enter_context(each)
        try:
            if options.module:
                runpy.run_module(program, run_name="__main__", alter_sys=True)
            else:
                runpy.run_path(program, run_name="__main__")
        except SystemExit as stop:
            if stop.code is None or isinstance(stop.code, int):
                return stop.code or 0
            sys.stderr.write(f"{stop.code}\n")
            return 1
        except Exception as error:
            _show(error)
            return 1
    return 0


def _show(error: Exception) -> None:
    """Print the traceback without the frames that started the program."""
    trace = error.__traceback__
    while trace is not None and trace.tb_frame.f_globals.get("__name__") != "__main__":
        trace = trace.tb_next
    if trace is None and not isinstance(error, SyntaxError):
        trace = error.__traceback__
    traceback.print_exception(error.with_traceback(trace))
