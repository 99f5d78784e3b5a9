"""Training: learning, resuming, several processes, checkpoints, errors, the command."""

from __future__ import annotations

import csv
import errno
import itertools
import shutil
import sys
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from neural_renderer.apps.common.features import googlenet, load_features
from neural_renderer.apps.reconstruct.networks import configs
from neural_renderer.apps.reconstruct.networks.checkpoint import load_model, make_network, read_checkpoint, save_model
from neural_renderer.apps.reconstruct.networks.configs import Config
from neural_renderer.apps.reconstruct.settings import RunSettings
from neural_renderer.apps.reconstruct.training.callbacks import Checkpoints
from neural_renderer.apps.reconstruct.training.train import train
from neural_renderer.apps.reconstruct.training.training import Training, schedule
from tests.apps.features.test_features import torchvision_googlenet, torchvision_vgg
from tests.apps.reconstruct.synthetic import SMALL, synthetic_split, write_split
from tests.faults import contents, full_disk
from tests.programs import run_python

pytestmark = pytest.mark.filterwarnings("ignore")


def small_training(out: Path, kind: str = "mesh", config: Config = SMALL, every: int = 3, **options: Any) -> Training:
    out.mkdir(exist_ok=True)
    given = {name: options.pop(name) for name in options.keys() & {part.name for part in fields(RunSettings)}}
    run = RunSettings(every=every, device="cpu", **given)
    return train(kind, config, synthetic_split(), synthetic_split(1, seed=1), out, run, **options)


@pytest.mark.parametrize("kind", ["mesh", "voxel"])
def test_it_learns(tmp_path: Path, kind: str) -> None:
    training = small_training(tmp_path, kind, replace(SMALL, steps=20, rate=3e-3), every=20)
    with (tmp_path / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    losses = [float(row["loss"]) for row in rows if row["loss"]]
    assert training.done and len(losses) == 2 and losses[-1] < losses[0]
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir())[-1] == "00000020.png"
    assert list((tmp_path / "tensorboard").glob("events*"))
    images = torch.rand(2, 4, 64, 64)
    network = load_model(tmp_path / "last.ckpt")
    assert network.kind == kind and not network.training
    torch.testing.assert_close(network(images), training.model(images))
    assert load_model(tmp_path / "best.ckpt")(images).shape == network(images).shape


@pytest.mark.parametrize("kind", ["mesh", pytest.param("voxel", marks=pytest.mark.slow)])
def test_features_of_another_network(tmp_path: Path, kind: str) -> None:
    """Pretrained features are used, do not change, and are part of the checkpoint."""
    features = googlenet(torchvision_googlenet())
    before = {name: value.clone() for name, value in features.state_dict().items()}
    options: dict[str, Any] = {"config": replace(SMALL, encoder="features"), "features": features}
    training = small_training(tmp_path / "whole", kind, **options)
    for name, value in features.state_dict().items():
        assert torch.equal(value, before[name]), name
    images = torch.rand(2, 4, 64, 64)
    for name in ("last", "best"):
        network = load_model(tmp_path / "whole" / f"{name}.ckpt")
        assert network(images).shape == training.model(images).shape
    torch.testing.assert_close(load_model(tmp_path / "whole" / "last.ckpt")(images), training.model(images))
    small_training(tmp_path / "parts", kind, interrupted=[2], **options)
    resumed = small_training(tmp_path / "parts", kind, checkpoint=tmp_path / "parts" / "last.ckpt", **options)
    for (name, one), other in zip(training.state_dict().items(), resumed.state_dict().values(), strict=True):
        assert torch.equal(one, other), name


def test_a_kill_costs_the_steps_since_the_checkpoint_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = small_training(tmp_path / "whole")
    step = Training.training_step

    def killed(self: Training, batch: Any, batch_idx: int) -> Any:
        if self.steps_done == 5:
            raise MemoryError
        return step(self, batch, batch_idx)

    monkeypatch.setattr(Training, "training_step", killed)
    with pytest.raises(MemoryError):
        small_training(tmp_path / "parts")
    monkeypatch.undo()
    assert read_checkpoint(tmp_path / "parts" / "last.ckpt")["training"]["steps"] == 3
    resumed = small_training(tmp_path / "parts", checkpoint=tmp_path / "parts" / "last.ckpt")
    assert resumed.steps_done == whole.steps_done == 6
    for (name, one), other in zip(whole.state_dict().items(), resumed.state_dict().values(), strict=True):
        assert torch.equal(one, other), name
    again = small_training(tmp_path / "parts", checkpoint=tmp_path / "parts" / "last.ckpt")
    assert again.done and again.steps_done == 6  # nothing is left to do


def test_an_interruption_keeps_everything(tmp_path: Path) -> None:
    training = small_training(tmp_path, interrupted=[2])
    assert training.steps_done == 1 and not training.done
    assert read_checkpoint(tmp_path / "last.ckpt")["training"]["steps"] == 1


def test_minutes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time limit, by a clock that advances by a second at each reading."""
    clock = SimpleNamespace(monotonic=itertools.count().__next__)
    monkeypatch.setattr("neural_renderer.apps.reconstruct.training.training.time", clock)
    training = small_training(tmp_path, config=replace(SMALL, steps=100), minutes=0.1)
    assert training.done and training.steps_done == training.seconds == 6


def test_a_loss_that_is_no_number(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"loss: expected finite numbers, got .* at step 0"):
        small_training(tmp_path, config=replace(SMALL, laplacian=float("nan")))


def test_a_full_disk(tmp_path: Path) -> None:
    path = tmp_path / "best.ckpt"
    network = make_network("mesh", SMALL)
    save_model(path, network, ["box"])
    before = path.read_bytes()
    with pytest.raises(OSError, match=r"best.ckpt: expected to write it, got: File too large"), full_disk(1000):
        save_model(path, network, ["box"])
    assert contents(tmp_path) == {"best.ckpt": before}


def test_a_disk_that_is_full_for_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        if path.suffix == ".png":
            write(path, content[:100])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"00000003.png: expected to write it, got: No space left on device"):
        small_training(tmp_path)
    assert not list((tmp_path / "pictures").iterdir())


def test_an_output_folder_that_is_deleted_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def ending(*_: Any) -> None:
        while (tmp_path / "out").exists():  # a thread of the logger may write a new file into it meanwhile
            shutil.rmtree(tmp_path / "out", ignore_errors=True)

    monkeypatch.setattr(Checkpoints, "on_train_epoch_end", ending)
    # The first to notice is the log or the logger's thread.
    with pytest.raises(OSError, match="No such file or directory"):
        small_training(tmp_path / "out")


def test_files_that_are_no_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "x.ckpt"
    with pytest.raises(FileNotFoundError, match="expected a checkpoint, got nothing there"):
        load_model(path)
    path.write_bytes(b"PK\3\4 and then nothing")
    with pytest.raises(
        ValueError, match=r"x.ckpt: expected a checkpoint, got a file that is broken or of another format"
    ):
        load_model(path)
    torch.save({"state_dict": {}}, path)
    with pytest.raises(ValueError, match="expected a checkpoint of a reconstruction network, got another checkpoint"):
        load_model(path)
    network = make_network("voxel", SMALL)
    save_model(path, network, ["box"], val_iou=0.5)
    content = torch.load(path, weights_only=True)
    torch.save(content | {"reconstruction": content["reconstruction"] | {"version": 99}}, path)
    with pytest.raises(ValueError, match="expected a checkpoint of version 1, got version 99"):
        load_model(path)
    torch.save(content | {"reconstruction": content["reconstruction"] | {"kind": "mesh"}}, path)
    with pytest.raises(ValueError, match="expected weights that match its header, got others"):
        load_model(path)
    content["state_dict"]["decoder.0.bias"][3] = torch.nan
    torch.save(content, path)
    with pytest.raises(ValueError, match=r"x.ckpt: expected finite weights, got NaN or infinity"):
        load_model(path)


@pytest.mark.parametrize("lie", [{"width": 1 << 28}, {"hidden": [1 << 30, 1 << 30]}, {"hidden": [4096] * 1000}])
def test_a_header_of_a_larger_network_takes_no_memory(tmp_path: Path, lie: dict[str, Any]) -> None:
    path = tmp_path / "x.ckpt"
    save_model(path, make_network("mesh", SMALL), ["box"])
    content = torch.load(path, weights_only=True)
    content["reconstruction"]["config"] |= lie
    torch.save(content, path)
    with pytest.raises(
        ValueError, match=r"x\.ckpt: expected weights that match its header.*at least \d+ numbers, got \d+"
    ):
        load_model(path)


def test_a_checkpoint_that_unpacks_to_more_than_it_is(tmp_path: Path) -> None:
    path = tmp_path / "x.ckpt"
    torch.save({"state_dict": {"zeros": torch.zeros(1 << 20)}}, path)
    with zipfile.ZipFile(path) as source:
        members = {info.filename: source.read(info) for info in source.infolist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members.items():
            packed.writestr(name, content)
    assert path.stat().st_size < 1 << 16
    with pytest.raises(ValueError, match=r"x\.ckpt: expected a checkpoint, got a file that is broken"):
        load_model(path)
    with pytest.raises(ValueError, match=r"x\.ckpt: .*it is compressed"):
        load_features(path)


def test_code_in_a_checkpoint_is_not_run(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "sprung",)

    torch.save({"reconstruction": {"version": 1}, "state_dict": Trap()}, tmp_path / "x.ckpt")
    with pytest.raises(ValueError, match="broken or of another format"):
        load_model(tmp_path / "x.ckpt")
    assert not (tmp_path / "sprung").exists()


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from neural_renderer.apps.command_line import main

    monkeypatch.setattr(configs, "_CONFIGS", {"paper": SMALL, "small": SMALL, "best": SMALL})
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    command = ["reconstruct", "train", str(data), str(out), "--device", "cpu"]
    assert main(command) == 1 and "_train_images.npz" in capsys.readouterr().err
    for split in ("train", "val"):
        write_split(data, split, 1)
    assert main([*command, "--steps", "2", "--classes", "box"]) == 0
    assert "2 steps in" in capsys.readouterr().out and load_model(out / "best.ckpt").kind == "mesh"
    assert main(command) == 1 and "--resume continues it" in capsys.readouterr().err
    assert main([*command, "--resume", "--model", "voxel"]) == 1
    assert "expected a checkpoint with model voxel, got mesh" in " ".join(capsys.readouterr().err.split())
    assert main([*command, "--steps", "3", "--classes", "box", "--resume"]) == 0
    assert read_checkpoint(out / "last.ckpt")["training"]["steps"] == 3
    assert main([*command, "--classes", "boat"]) == 1 and "boat" in capsys.readouterr().err
    for option, value, sentence in (
        ("--classes", "ball", "expected a checkpoint with classes ['ball'], got ['box']"),
        ("--seed", "1", "expected a checkpoint with seed 1, got 0"),
        ("--steps", "2", "--steps: expected at least the 3 steps already taken, got 2"),
    ):
        assert main([*command, "--classes", "box", "--resume", option, value]) == 1
        assert sentence in " ".join(capsys.readouterr().err.split())
    file = out / "best.ckpt"
    assert main([*command[:3], str(file), *command[4:], "--classes", "box"]) == 1
    assert f"OUT: expected a folder that can be written, got {file} (Not a directory)" in " ".join(
        capsys.readouterr().err.split()
    )
    (out / "last.ckpt").rename(tmp_path / "last.ckpt")
    assert main([*command, "--classes", "box"]) == 1
    assert "best.ckpt: expected a folder without a network" in " ".join(capsys.readouterr().err.split())
    (out / "last.ckpt").write_bytes((out / "best.ckpt").read_bytes())
    assert main([*command, "--classes", "box", "--resume"]) == 1
    assert "expected the state of a training, got a network only" in " ".join(capsys.readouterr().err.split())
    assert main([*command[:3], str(tmp_path / "shared"), "--devices", "3"]) == 1  # of 4 objects
    told = " ".join(capsys.readouterr().err.split())
    assert "--devices: expected a divisor of the batch of 4 objects, got 3" in told
    assert not torch.distributed.is_initialized()
    if not torch.cuda.is_available():
        assert main([*command[:-1], "cuda"]) == 1 and "--device: expected cpu, got cuda" in capsys.readouterr().err
    assert main([*command, "--minutes", "-1"]) == 1 and "--minutes" in capsys.readouterr().err


@pytest.mark.parametrize("library", ["lightning", "tensorboard"])
def test_a_missing_library_is_named(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By its own name, before anything is written."""
    from neural_renderer.apps.command_line import main

    monkeypatch.setitem(sys.modules, library, None)
    write_split(tmp_path, "train", 1)
    assert main(["reconstruct", "train", str(tmp_path), str(tmp_path / "out"), "--config", "small"]) == 1
    sentence = f'expected {library} to be installed to train networks (pip install "neural-renderer[reconstruct]")\n'
    assert capsys.readouterr().err.endswith(sentence) and not (tmp_path / "out").exists()


def test_command_with_features(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from neural_renderer.apps.command_line import main

    monkeypatch.setattr(configs, "_CONFIGS", {"best": SMALL})
    data, out, weights = tmp_path / "data", tmp_path / "out", tmp_path / "weights.pth"
    data.mkdir()
    write_split(data, "train", 1)
    torch.save(torchvision_googlenet(), weights)
    command = ["reconstruct", "train", str(data), str(out), "--device", "cpu", "--steps", "1"]
    assert main([*command, "--features", str(data / "none.pth")]) == 1 and "none.pth" in capsys.readouterr().err
    assert main([*command, "--features", str(weights)]) == 0
    assert "ball, box: no images of the split val" in " ".join(capsys.readouterr().err.split())
    assert torch.equal(*(load_model(out / f"{name}.ckpt").sphere for name in ("best", "last")))
    torch.save(torchvision_vgg(16), tmp_path / "vgg.pth")
    torch.save({name: value * 2 for name, value in torchvision_googlenet().items()}, tmp_path / "other.pth")
    for other in ("vgg", "other"):
        assert main([*command, "--resume", "--features", str(tmp_path / f"{other}.pth")]) == 1
        told = " ".join(capsys.readouterr().err.split())
        assert "last.ckpt: expected a checkpoint with the features of" in told and "got other features" in told
    assert main([*command, "--resume", "--features", str(weights)]) == 0
    weights.unlink()
    assert load_model(out / "last.ckpt").config.encoder == "features"
    assert main([*command, "--resume"]) == 1
    assert "expected a checkpoint with encoder light, got features" in " ".join(capsys.readouterr().err.split())
    torch.save({"weight": torch.zeros(3)}, weights)
    assert main([*command[:3], str(tmp_path / "other"), *command[4:], "--features", str(weights)]) == 1
    assert "expected the weights of a VGG" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "other").exists()


def test_schedules() -> None:
    assert [schedule("step", p) for p in (0.0, 0.5, 0.949, 0.951)] == [1, 1, 1, 0.1]
    assert schedule("cosine", 0.02) == 1 and schedule("cosine", 0.01) == 0.5 and schedule("cosine", 1.0) < 1e-9


TWO_PROCESSES = """
import sys
from dataclasses import replace
from pathlib import Path
from neural_renderer.apps.reconstruct.data.arrays import open_split
from neural_renderer.apps.reconstruct.settings import RunSettings
from neural_renderer.apps.reconstruct.training.train import train
from tests.programs import run_python
from tests.apps.reconstruct.synthetic import SMALL

folder, out = Path(sys.argv[1]), Path(sys.argv[2])
train("mesh", replace(SMALL, steps=1), open_split(folder, "train"), None, out, RunSettings(devices=2, device="cpu"))
"""


@pytest.mark.slow
def test_two_processes_do_what_one_does(tmp_path: Path) -> None:
    """Two processes compute the gradient of one, to rounding.

    Compared is Adam's first moment after one step, which is the gradient. Weights would say less: Adam's first step is
    as long for a gradient of rounding errors as for any other.
    """
    write_split(tmp_path, "train")
    script = tmp_path / "two.py"
    script.write_text(TWO_PROCESSES)
    done = run_python(script, tmp_path, tmp_path / "two")
    assert done.returncode == 0, done.stderr
    train("mesh", replace(SMALL, steps=1), synthetic_split(), None, tmp_path / "one", RunSettings(device="cpu"))
    one, two = (read_checkpoint(tmp_path / name / "last.ckpt") for name in ("one", "two"))
    assert one["training"]["steps"] == two["training"]["steps"] == 1
    states = [content["optimizer_states"][0]["state"] for content in (one, two)]
    assert len(states[0]) == len(states[1]) > 20
    for number, state in states[0].items():
        gradient, other = state["exp_avg"], states[1][number]["exp_avg"]
        # Sums over the batch, its images' pixels and the mesh, in another order, through layers of 512 terms.
        assert gradient.norm() > 0 and (gradient - other).norm() <= 1e-4 * gradient.norm()
