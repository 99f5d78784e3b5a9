"""Training in several processes and nodes under torchrun: the steps of one process, and a process that is lost."""

from __future__ import annotations

import csv
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from neural_renderer.tasks.reconstruction.networks.checkpoint import read_checkpoint
from tests.paths import ROOT
from tests.programs import search_path
from tests.tasks.reconstruction.synthetic import write_split

pytestmark = pytest.mark.slow

# The command with a small network, whose log has every step.
PROGRAM = """
import os, sys, time
from dataclasses import replace
from neural_renderer.tasks.reconstruction.networks import configs
from neural_renderer.tasks.reconstruction.training import callbacks
from neural_renderer.tasks.reconstruction.training.training import Training
from tests.tasks.reconstruction.synthetic import SMALL

configs._CONFIGS = {"best": replace(SMALL, rate=1e-4)}
callbacks._LOG_EVERY = 1
step = Training.optimizer_step

def die(self, *arguments, **named):
    step(self, *arguments, **named)
    if self.steps_done == int(os.environ.get("DIE_AT", "-1")) and os.environ.get("RANK") == "1":
        os.kill(os.getpid(), 9)

Training.optimizer_step = die
from neural_renderer.cli import main
sys.exit(main(["reconstruct", "train", *sys.argv[1:], "--device", "cpu", "--every", "2"]))
"""


def start(program: Path, nodes: int, *arguments: str, **variables: str) -> list[subprocess.Popen[str]]:
    """Start torchrun with one process on each of some nodes, all of which are this machine."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    environment = os.environ | {"PYTHONPATH": search_path(ROOT), "OMP_NUM_THREADS": "1", **variables}
    runs = []
    for node in range(nodes):
        launch = ["torch.distributed.run", "--nnodes", str(nodes), "--nproc-per-node", "1", "--node-rank", str(node)]
        launch += ["--master-addr", "127.0.0.1", "--master-port", port, str(program), *arguments]
        command = [sys.executable, "-m", *launch, "--nodes", str(nodes), "--devices", "1"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        runs.append(subprocess.Popen(command, env=environment, **pipes))  # type: ignore[call-overload]
    return runs


def finish(runs: list[subprocess.Popen[str]]) -> list[tuple[int, str]]:
    """Wait for all; a run that hangs is killed after ten minutes."""
    end = time.monotonic() + 600
    results = []
    for run in runs:
        try:
            text = run.communicate(timeout=max(1.0, end - time.monotonic()))[0]
        finally:
            run.kill()
        results.append((run.returncode, text))
    return results


def losses(out: Path) -> list[float]:
    with (out / "log.csv").open() as file:
        return [float(row["loss"]) for row in csv.DictReader(file) if row["loss"]]


def test_nodes(tmp_path: Path) -> None:
    """Two nodes take the steps of one process with the whole batch; a training goes on with another number of nodes;
    a node that is lost ends the training with a sentence, and it is resumed from rank 0's checkpoint."""
    write_split(tmp_path, "train")
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    outs = {name: tmp_path / name for name in ("one", "two", "more", "lost")}
    for name, nodes in (("one", 1), ("two", 2)):
        for code, text in finish(start(program, nodes, str(tmp_path), str(outs[name]), "--steps", "4")):
            assert code == 0, text
    one, two = losses(outs["one"]), losses(outs["two"])
    assert len(one) == len(two) == 4
    # The losses of the log are those of rank 0's half of the batch in the second case; the weights tell.
    first, second = (read_checkpoint(outs[name] / "last.ckpt") for name in ("one", "two"))
    assert first["training"]["steps"] == second["training"]["steps"] == 4
    for name, value in first["state_dict"].items():
        if value.is_floating_point():
            assert (value - second["state_dict"][name]).norm() <= 1e-2 * value.norm() + 1e-4, name

    runs = start(program, 2, str(tmp_path), str(outs["lost"]), "--steps", "4", DIE_AT="3")
    results = finish(runs)
    assert all(code != 0 for code, _ in results)
    assert "expected all 2 processes to go on, got none from one of them" in " ".join(results[0][1].split())
    assert read_checkpoint(outs["lost"] / "last.ckpt")["training"]["steps"] == 2
    [(code, text)] = finish(start(program, 1, str(tmp_path), str(outs["lost"]), "--steps", "4", "--resume"))
    assert code == 0, text
    resumed = read_checkpoint(outs["lost"] / "last.ckpt")
    assert resumed["training"]["steps"] == 4
    for name, value in first["state_dict"].items():
        if value.is_floating_point():
            assert (value - resumed["state_dict"][name]).norm() <= 1e-2 * value.norm() + 1e-4, name
