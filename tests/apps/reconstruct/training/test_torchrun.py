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
import torch

import neural_renderer as nr
from neural_renderer.apps.command_line import main
from neural_renderer.apps.reconstruct.networks.checkpoint import read_checkpoint
from tests.paths import ROOT
from tests.programs import search_path

pytestmark = pytest.mark.slow

# The command with a small network, whose log has every step.
PROGRAM = """
import os, sys, time
from dataclasses import replace
from neural_renderer.apps.reconstruct.networks import configs
from neural_renderer.apps.reconstruct.training import callbacks
from neural_renderer.apps.reconstruct.training.training import Training
from tests.apps.reconstruct.synthetic import SMALL

configs._CONFIGS = {"best": replace(SMALL, rate=1e-4)}
callbacks._LOG_EVERY = 1
step = Training.optimizer_step

def die(self, *arguments, **named):
    step(self, *arguments, **named)
    if self.steps_done == int(os.environ.get("DIE_AT", "-1")) and os.environ.get("RANK") == os.environ["DIES"]:
        os.kill(os.getpid(), 9)

Training.optimizer_step = die
from neural_renderer.apps.command_line import main
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


def write_shards(folder: Path) -> Path:
    """Make a data set of two classes by `neural-renderer dataset`, two objects of each in the split train."""
    generator = torch.Generator().manual_seed(0)
    for kind, (vertices, faces) in {"ball": nr.icosphere(1), "box": nr.cube()}.items():
        for name in "abc":
            nr.save_mesh(folder / kind / f"{name}.obj", vertices * (0.3 + torch.rand(3, generator=generator)), faces)
    frame = "--views 24 --size 64 --azimuth 90 --elevation 30 --viewing-angle 15 --distance 5.464"
    options = [*frame.split(), "--outputs", "rgba.png", "--index", "csv", "-j", "0", "--models-per-shard", "2"]
    assert main(["dataset", str(folder), "-o", str(folder / "views"), *options]) == 0
    return folder / "views"


def test_nodes(tmp_path: Path) -> None:
    """Two processes take the steps of one with the whole batch, reading shards of views; a training goes on with
    another number of processes, more or fewer; one that is lost ends the training with a sentence."""
    data = str(write_shards(tmp_path))
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    outs = {name: tmp_path / name for name in ("one", "fewer", "more")}

    def train(nodes: int, name: str, *more: str, **variables: str) -> list[tuple[int, str]]:
        return finish(start(program, nodes, data, str(outs[name]), "--steps", "4", *more, **variables))

    runs = [train(1, "one")]
    lost = {"fewer": train(2, "fewer", DIE_AT="3", DIES="1"), "more": train(1, "more", DIE_AT="3", DIES="0")}
    assert all(code != 0 for results in lost.values() for code, _ in results)
    assert "expected all 2 processes to go on, got none from one of them" in " ".join(lost["fewer"][0][1].split())
    assert all(read_checkpoint(outs[name] / "last.ckpt")["training"]["steps"] == 2 for name in lost)
    runs += [train(1, "fewer", "--resume"), train(2, "more", "--resume")]
    for code, text in (result for results in runs for result in results):
        assert code == 0, text
    one, first = losses(outs["one"]), read_checkpoint(outs["one"] / "last.ckpt")
    assert len(set(one)) == 4
    for name in lost:
        again, curve = read_checkpoint(outs[name] / "last.ckpt"), losses(outs[name])
        assert again["training"]["steps"] == len(curve) == 4
        # Means over the batch in another order, rounded to six decimals. Later steps follow gradients with such errors,
        # which Adam divides by the gradient's size.
        assert abs(one[0] - curve[0]) <= 1e-5 * one[0] + 1e-6, (one, curve)
        assert all(abs(a - b) <= 1e-3 * a for a, b in zip(one, curve, strict=True)), (one, curve)
        for part, value in first["state_dict"].items():
            if value.is_floating_point():
                assert (value - again["state_dict"][part]).norm() <= 1e-2 * value.norm() + 1e-4, part
