"""Evaluation: scores of known predictions, tables, the retrieval baseline, the command."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from rich.console import Console
from torch import Tensor, nn

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.features import FeatureNetwork
from neural_renderer.apps.reconstruct.data.arrays import Split, open_split
from neural_renderer.apps.reconstruct.data.dataset import Settings, render_views
from neural_renderer.apps.reconstruct.data.framing import scale_to_unit
from neural_renderer.apps.reconstruct.data.voxels import chamfer, voxelize, voxelize_model
from neural_renderer.apps.reconstruct.evaluation.evaluate import Scores, blocks, evaluate, markdown, terminal
from neural_renderer.apps.reconstruct.evaluation.predictors import (
    MeshPredictions,
    VoxelPredictions,
    network_predictor,
)
from neural_renderer.apps.reconstruct.evaluation.retrieval import Retrieval, feature_layer, image_features
from neural_renderer.apps.reconstruct.evaluation.sheets import on_paper, prediction_sheet
from neural_renderer.apps.reconstruct.networks.configs import Config
from tests.rounding import EPS

SHAPES = {
    "ball": nr.icosphere(2),
    "pole": (nr.cube()[0] * torch.tensor([0.1, 1, 0.2]), nr.cube()[1]),
    "slab": (nr.cube()[0] * torch.tensor([1.0, 0.1, 0.6]), nr.cube()[1]),
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write one object of each class, in "test" and in "train"."""
    folder = tmp_path_factory.mktemp("data")
    for name, (vertices, faces) in SHAPES.items():
        vertices = scale_to_unit(vertices)
        textures = torch.tensor([0.8, 0.3, 0.5]).expand(len(faces), 2, 2, 2, 3)
        images = render_views(vertices, faces, textures, Settings(samples=2))
        voxels = voxelize_model(vertices, faces.flip(1))
        for split, order in (("test", [0, 1, 2, 3]), ("train", [1, 2, 0, 3])):
            np.savez_compressed(folder / f"{name}_{split}_images.npz", images[None, :, order].numpy())
            np.savez_compressed(folder / f"{name}_{split}_voxels.npz", voxels[None].numpy())
    return folder


class ConstantNetwork:
    """A network that always predicts a ball."""

    config = Config()

    def __init__(self, kind: str, grown: float = 1.0) -> None:
        self.kind, self.faces, self._grown = kind, SHAPES["ball"][1], grown

    def vertices(self, images: Tensor) -> Tensor:
        return (self._grown * scale_to_unit(SHAPES["ball"][0])).expand(len(images), -1, -1)

    def occupancy(self, images: Tensor) -> Tensor:
        return voxelize(self.vertices(images), self.faces).float() * 0.6


def scores_of(split: Split, predict: Any) -> Scores:
    scores = Scores()
    for name, label, values in evaluate(predict, split):
        scores.objects.setdefault(name, {})[label] = values
    return scores


@pytest.mark.parametrize("kind", ["mesh", "voxel"])
def test_a_right_prediction_scores_one(data: Path, kind: str) -> None:
    split = open_split(data, "test", ["ball"])
    scores = scores_of(split, network_predictor(ConstantNetwork(kind)))
    assert scores.of_class("ball") == 1 and scores.of_class("ball", "chamfer") == 0
    assert scores.of_class("ball", "silhouette_iou") > (0.97 if kind == "mesh" else 0.85)
    above = scores_of(split, network_predictor(ConstantNetwork("voxel"), threshold=0.7))
    assert above.of_class("ball") == 0
    assert above.of_class("ball", "chamfer") == pytest.approx(math.sqrt(3), rel=32 * EPS)


def test_means_are_over_views_objects_and_classes(data: Path) -> None:
    split = open_split(data, "test")

    def some(images: Tensor) -> VoxelPredictions:
        """Predict the ball for half of the views."""
        filled = voxelize(scale_to_unit(SHAPES["ball"][0])[None], SHAPES["ball"][1]).repeat(len(images), 1, 1, 1)
        filled[::2] = False
        return VoxelPredictions(filled)

    scores = scores_of(split, some)
    assert scores.of_class("ball") == 0.5
    assert scores.mean() == pytest.approx(sum(scores.of_class(name) for name in SHAPES) / 3)
    assert scores.to_dict()["classes"]["ball"]["voxel_iou"] == 0.5  # type: ignore[index]


def test_silhouettes_come_from_the_side_too(data: Path) -> None:
    """A pole rotated by 90° has wrong silhouettes from all sides."""
    split = open_split(data, "test", ["pole"])
    right = MeshPredictions(scale_to_unit(SHAPES["pole"][0]).expand(24, -1, -1), SHAPES["pole"][1])
    assert scores_of(split, lambda _: right).mean("silhouette_iou") > 0.9
    turned = MeshPredictions(scale_to_unit(SHAPES["pole"][0])[:, [2, 1, 0]].expand(24, -1, -1), SHAPES["pole"][1])
    assert scores_of(split, lambda _: turned).mean("silhouette_iou") < 0.8


def test_chamfer_of_shifted_plates() -> None:
    plates = torch.zeros(3, 32, 32, 32, dtype=torch.bool)
    plates[0, 5], plates[1, 8] = True, True
    # Means over 32 x 32 voxels.
    assert chamfer(plates[:1], plates[1:2]).item() == pytest.approx(2 * 3 / 31, rel=32**2 * EPS)
    both = chamfer(plates, plates[:1])
    assert both.tolist() == pytest.approx([0, 6 / 31, math.sqrt(3)], rel=32**2 * EPS)
    assert torch.allclose(chamfer(plates[:1], plates), both)


def test_tables() -> None:
    names = ["airplane", "bench", "dresser", "car", "chair", "display", "lamp", "rifle"]
    methods = {}
    for label, base in (("retrieval", 0.4), ("mesh", 0.5)):
        rows = {
            name: {"x": {"voxel_iou": base + 0.01 * index, "silhouette_iou": 0.5, "chamfer": base}}
            for index, name in enumerate(names)
        }
        methods[label] = Scores(rows)
    first, second = blocks(methods)
    assert first[0] == ["", *names[:7]] and second[0] == ["", "rifle", "mean"]
    assert first[1][:3] == ["retrieval", "0.4000", "0.4100"] and second[2] == ["mesh", "**0.5700**", "**0.5350**"]
    assert (
        blocks(methods, "chamfer")[1][1][2] == "**0.4000**"
        and blocks(methods, "silhouette_iou")[1][1][2] == "**0.5000**"
    )
    assert [len(part[0]) for part in blocks({"a": Scores(dict(list(methods["mesh"].objects.items())[:7]))})] == [9]
    text = markdown(methods)
    assert text.count("| mesh |") == 6 and "| retrieval | 0.4700 | 0.4350 |" in text and "Voxel IoU" in text
    assert len(terminal(methods)) == 2
    console = Console(width=40, file=io.StringIO())
    for table in terminal(methods, width=40):
        console.print(table)
    told = console.file.getvalue()  # type: ignore[attr-defined]
    assert "…" not in told and "0.5350" in told and max(map(len, told.splitlines())) <= 40


def colour_network(name: str = "GoogLeNet", layer: str = "pool5") -> FeatureNetwork:
    """Make a network whose features are mean colours of nine parts of an image."""
    return FeatureNetwork(name, nn.Identity(), {layer: nn.Sequential(nn.AdaptiveAvgPool2d(3), nn.Flatten())})


def test_retrieval_finds_what_looks_alike(data: Path) -> None:
    train, test = open_split(data, "train"), open_split(data, "test")
    network = colour_network()
    retrieval = Retrieval(train, network)
    assert list(retrieval.prepare())[-1] == 72
    for name in SHAPES:
        own = torch.from_numpy(train.images[name][0, [3, 9]].copy())
        assert retrieval.nearest(own) == [(name, 0)] * 2
    found = retrieval.predictor()(torch.from_numpy(test.images["ball"][0].copy())).voxels()
    assert found.shape == (24, 32, 32, 32)
    kept = next(data.glob("ball_train_images_googlenet_*.npy"))
    stamp = kept.stat().st_ino
    again = Retrieval(train, network)
    list(again.prepare())
    assert kept.stat().st_ino == stamp and again.nearest(own) == retrieval.nearest(own)
    features = image_features(network, torch.zeros(2, 4, 64, 64, dtype=torch.uint8))
    assert torch.equal(features, torch.ones(2, 27))  # transparent is white


def test_retrieval_says_what_is_missing(data: Path, tmp_path: Path) -> None:
    assert feature_layer(colour_network("VGG-16", "fc6")) == "fc6"
    with pytest.raises(ValueError, match="features: expected a network with the layer fc6, got VGG-16 without it"):
        feature_layer(colour_network("VGG-16", "pool5"))
    (tmp_path / "ball_train_images.npz").write_bytes((data / "ball_train_images.npz").read_bytes())
    with pytest.raises(FileNotFoundError, match=r"ball_train_voxels\.npz: expected voxels to retrieve"):
        Retrieval(open_split(tmp_path, "train"), colour_network())
    (tmp_path / "ball_test_images.npz").write_bytes((data / "ball_test_images.npz").read_bytes())
    with pytest.raises(FileNotFoundError, match=r"ball_test_voxels\.npz: expected the voxels to compare with"):
        next(evaluate(network_predictor(ConstantNetwork("mesh")), open_split(tmp_path, "test")))


def test_sheet(data: Path) -> None:
    split = open_split(data, "test")
    predictors = {
        "a": network_predictor(ConstantNetwork("mesh")),
        "b": network_predictor(ConstantNetwork("voxel"), 0.9),
    }
    picture = prediction_sheet(predictors, split, size=32)
    assert picture.shape == (3, 20 + 3 * 32, (1 + 3 * 3) * 32)
    cells = picture[:, 20:].unfold(1, 32, 32).unfold(2, 32, 32).permute(1, 2, 0, 3, 4)  # [row, column, 3, 32, 32]
    for row, name in enumerate(split.classes):
        view = (7 * row + 2) % 24
        image = torch.from_numpy(split.images[name][0, view].copy())
        truth = VoxelPredictions(torch.from_numpy(split.voxels[name][0].copy())[None])
        shapes = [predict(image[None]) for predict in predictors.values()]
        expected = [each.picture(0, (view + turn) % 24, 32) for each in (*shapes, truth) for turn in (0, 5, 12)]
        assert torch.equal(cells[row, 1:], torch.stack(expected))
        # The input is the picture on white, at half its size.
        half = torch.nn.functional.interpolate(on_paper(image)[None], (32, 32), mode="bilinear")[0]
        assert torch.equal(cells[row, 0], half)
    assert len({cells[row, 7].numpy().tobytes() for row in range(3)}) == 3  # three shapes


@pytest.fixture
def networks(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(path: Path, device: Any) -> ConstantNetwork:
        if not Path(path).exists():
            raise FileNotFoundError(f"{path}: expected a checkpoint, got nothing there")
        return ConstantNetwork("mesh" if "mesh" in str(path) else "voxel", 0.8)

    monkeypatch.setattr("neural_renderer.apps.reconstruct.commands.evaluate.load_model", load)
    monkeypatch.setattr("neural_renderer.apps.common.features.load_features", lambda name: colour_network())


def test_the_command(data: Path, tmp_path: Path, networks: None, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("mesh", "voxel"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "best.ckpt").touch()
    arguments = ["reconstruct", "evaluate", str(tmp_path / "mesh" / "best.ckpt"), str(data)]
    arguments += ["--also", str(tmp_path / "voxel" / "best.ckpt"), "--baseline", "retrieval", "--device", "cpu"]
    arguments += ["--classes", "ball", "slab"]
    assert cli.main(arguments) == 0
    told = capsys.readouterr().out
    assert "Voxel IoU" in told and "retrieval" in told and "silhouette IoU" in told
    out = tmp_path / "mesh" / "evaluation_test"
    report = json.loads((out / "scores.json").read_text())
    assert list(report["methods"]) == ["retrieval", "mesh", "voxel"]
    mesh = report["methods"]["mesh"]
    assert 0 < mesh["mean"]["voxel_iou"] < mesh["classes"]["ball"]["voxel_iou"] < 1
    assert report["objects"] == {"ball": 1, "slab": 1}
    assert "| mesh |" in (out / "table.md").read_text()
    with Image.open(out / "sheet.png") as picture:
        assert picture.size == (13 * 96, 20 + 2 * 96)


def test_interrupted_it_keeps_what_is_done(
    data: Path, tmp_path: Path, networks: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(label: str, *_: Any) -> Scores:
        if label == "voxel":
            raise KeyboardInterrupt
        return Scores({name: {"x": {"voxel_iou": 0.5, "silhouette_iou": 0.5, "chamfer": 0.5}} for name in SHAPES})

    monkeypatch.setattr("neural_renderer.apps.reconstruct.commands.evaluate._evaluate", interrupted)
    for name in ("mesh", "voxel"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "best.ckpt").touch()
    paths = [str(tmp_path / name / "best.ckpt") for name in ("mesh", "voxel")]
    arguments = ["reconstruct", "evaluate", paths[0], str(data), "-o", str(tmp_path / "out")]
    assert cli.main([*arguments, "--also", paths[1]]) == 130
    assert list(json.loads((tmp_path / "out" / "scores.json").read_text())["methods"]) == ["mesh"]
    arguments[2] = paths[1]
    assert cli.main([*arguments, "-o", str(tmp_path / "other")]) == 130 and not (tmp_path / "other").exists()


def test_what_is_wrong_is_a_sentence(
    data: Path, tmp_path: Path, networks: None, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mesh.ckpt").touch()
    checkpoint = str(tmp_path / "mesh.ckpt")
    for arguments, sentence in (
        (["nowhere.ckpt", str(data)], "nowhere.ckpt: expected a file"),
        ([checkpoint, str(tmp_path / "nowhere")], "nowhere: expected a folder with a data set"),
        ([checkpoint, str(data), "--set", "val"], "expected files {class}_val_images.npz, got none"),
        ([checkpoint, str(data), "--classes", "lamp"], "the classes are ball, pole, slab"),
        ([checkpoint, str(data), "--threshold", "1"], "--threshold: expected a number above 0 and below 1"),
        ([checkpoint, str(data), "--refine", "-1"], "--refine: expected at least 0, got -1"),
        (
            [checkpoint, str(data), "--features", "vgg16"],
            "--features: expected --baseline retrieval with it, got vgg16",
        ),
        (["none", str(data)], "checkpoint: expected a network or --baseline retrieval, got neither"),
    ):
        assert cli.main(["reconstruct", "evaluate", *arguments]) == 1
        told = capsys.readouterr().err
        assert sentence in told and told.count("\n") == 1


def test_voxels_of_other_axes_are_noticed(
    data: Path, tmp_path: Path, networks: None, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mesh.ckpt").touch()
    for kind in ("images", "voxels"):
        with np.load(data / f"pole_test_{kind}.npz") as arrays:
            array = arrays["arr_0"]
        np.savez(tmp_path / f"pole_test_{kind}.npz", array if kind == "images" else array.transpose(0, 3, 2, 1).copy())
    np.savez(
        tmp_path / "pole_test_voxels.npz", np.load(data / "pole_test_voxels.npz")["arr_0"].transpose(0, 2, 1, 3).copy()
    )
    assert cli.main(["reconstruct", "evaluate", str(tmp_path / "mesh.ckpt"), str(tmp_path)]) == 0
    told = capsys.readouterr().err
    assert "pole: the silhouettes of voxels and images differ, unlike the published data; with the axes (" in told
