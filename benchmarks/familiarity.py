"""Calibrate what `reconstruct predict` says it knows: `networks/familiarity.json`, and figures for the model card.

    python -m benchmarks.familiarity MODELS STRANGERS [-o OUT.json]

MODELS is a folder of models by category with splits.csv, STRANGERS one of meshes of other kinds. Each object is drawn
from four random sides, cropped as `reconstruct` does, in its own colours or in one colour. Weights of the code are
fitted to the splits "train" and "val" and to every second stranger, and calibrated on "val" and these. The figures are
of the split "test" and of the other strangers, which nothing has seen.
"""

from __future__ import annotations

import argparse
import json
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from neural_renderer.apps.reconstruct.data.framing import scale_to_unit
from neural_renderer.apps.reconstruct.data.models_folder import find_models, read_splits
from neural_renderer.apps.reconstruct.evaluation.familiarity import (
    CALIBRATION,
    EVIDENCE,
    LEAST_FAMILIAR,
    Calibration,
    evidence,
)
from neural_renderer.apps.reconstruct.evaluation.picture import shipped_network
from neural_renderer.apps.reconstruct.shapes.shapes import CLASSES, Shape
from neural_renderer.apps.reconstruct.shapes.views import crop, crop_poses, draw, random_poses
from neural_renderer.io import load_mesh

VIEWS, BINS = 4, 5
TURNS = 5
RIDGES = 0.03, 0.01  # weights of the squares of weights, of numbers with deviation 1: the code, the rest
NONE = -1  # category of a stranger


def draw_object(path: Path) -> Tensor:
    """Draw an object from random sides: [4, 4, 64, 64]. The sides follow from its name."""
    vertices, faces, textures = load_mesh(path, 2)
    used, faces = torch.unique(faces.long(), return_inverse=True)
    colors = None if textures is None else textures.flatten(1, 3).mean(1)
    rng = np.random.default_rng(zlib.crc32(path.stem.encode()))
    shapes = []
    for view in range(VIEWS):
        plain = torch.from_numpy(rng.uniform(0.1, 0.9, 3)).float().expand(len(faces), 3)
        own = colors if colors is not None and view % 2 == 0 else plain
        shapes.append(Shape(0, scale_to_unit(vertices[used]), faces, own, torch.empty(0)))
    pose = crop_poses(random_poses(VIEWS, rng), [shape.vertices for shape in shapes], rng)
    return crop(torch.cat([draw([shape], pose[n : n + 1], rng) for n, shape in enumerate(shapes)]))[0]


@dataclass(frozen=True)
class Seen:
    """Outputs of the network for views of objects, with the same number of views for each object."""

    evidence: Tensor  # [N, 261]
    shares: Tensor  # probabilities of categories, [N, 13]
    truth: Tensor  # categories, [N]; `NONE` of strangers
    objects: Tensor  # numbers of the objects, [N]

    def familiar(self) -> Tensor:
        """The views of objects of known kinds."""
        return self.truth != NONE


def look(paths: Sequence[tuple[Path, int]]) -> Seen:
    """Show the network views of objects of a category each. Objects that cannot be read are left out."""
    network, rows = shipped_network(), []
    for number, (path, category) in enumerate(paths):
        try:
            images = draw_object(path)
        except (ValueError, OSError) as error:
            print(f"left out: {error}")
            continue
        occupancy, pose, shares = network.search(images)
        labels = torch.full((2, VIEWS), number)
        labels[0] = category
        rows.append((evidence(network, images, occupancy, pose), shares, *labels))
    return Seen(*(torch.cat(column) for column in zip(*rows, strict=True)))


def regress(values: Tensor, familiar: Tensor, ridge: float) -> tuple[Tensor, float]:
    """Logistic regression of values [N, K], strangers and familiar objects weighing the same: weights [K], bias."""
    values = values.double()
    mean, deviation = values.mean(0), values.std(0) + 1e-6
    scaled = torch.cat(((values - mean) / deviation, values.new_ones(len(values), 1)), 1)
    sign = torch.where(familiar, 1.0, -1.0).double()
    share = torch.where(familiar, 0.5 / familiar.sum(), 0.5 / (~familiar).sum())
    found = scaled.new_zeros(scaled.shape[1], requires_grad=True)
    optimizer = torch.optim.LBFGS([found], max_iter=200, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        value = (share * F.softplus(-sign * (scaled @ found))).sum() + ridge * found[:-1].square().sum()
        value.backward()
        return value

    optimizer.step(loss)
    weights = found.detach()[:-1] / deviation
    return weights.float(), float(found.detach()[-1] - (weights * mean).sum())


def fit(train: Seen, seen: Seen) -> Calibration:
    """Fit a score of the code, then a second regression of it and the other numbers, and a temperature.

    The second one sees scores of objects that the first was not fitted to, in turns of a fifth.
    """
    few, familiar = len(EVIDENCE), seen.familiar()

    def score(chosen: Tensor) -> tuple[Tensor, float]:
        values = torch.cat((train.evidence, seen.evidence[chosen]))[:, few:]
        return regress(values, torch.cat((train.familiar(), familiar[chosen])), RIDGES[0])

    scores = torch.zeros(len(familiar))
    for turn in range(TURNS):
        held = seen.objects % TURNS == turn
        weights, bias = score(~held)
        scores[held] = seen.evidence[held, few:] @ weights + bias
    second, bias = regress(torch.cat((seen.evidence[:, :few], scores[:, None]), 1), familiar, RIDGES[1])
    weights, constant = score(torch.ones(len(familiar), dtype=torch.bool))
    merged = torch.cat((second[:few], second[few] * weights))

    logs, right = seen.shares[familiar].clamp(min=1e-12).log(), seen.truth[familiar]
    temperatures = torch.linspace(0.5, 3, 251)
    surprises = torch.stack([F.cross_entropy(logs / temperature, right) for temperature in temperatures])
    temperature = float(temperatures[surprises.argmin()])
    rounded = tuple(round(float(weight), 5) for weight in merged)
    return Calibration(round(temperature, 2), rounded, round(bias + float(second[few]) * constant, 5))


def describe(calibration: Calibration, seen: Seen) -> None:
    """Print the figures of held-out objects."""
    known, shares, truth = seen.familiar(), seen.shares, seen.truth
    familiar = calibration.familiar(seen.evidence)
    ranks = (familiar[known][:, None] > familiar[~known]).float().mean()
    doubted = familiar < LEAST_FAMILIAR
    print(f"{int(known.sum())} views of familiar objects, {float(doubted[known].float().mean()):.1%} doubted")
    print(f"{int((~known).sum())} views of strangers, {float(doubted[~known].float().mean()):.1%} caught")
    print(f"area under the curve {float(ranks):.3f}")
    for name, column in zip(EVIDENCE, seen.evidence.T, strict=False):
        print(f"  by {name} alone {float((column[known][:, None] > column[~known]).float().mean()):.3f}")
    print("probability of a familiar object: said, true (strangers and familiar ones weighing the same), views")
    weight = torch.where(known, 0.5 / known.sum(), 0.5 / (~known).sum())
    print_bins(familiar, known.float(), weight)
    calibrated = calibration.categories(shares[known])
    for title, p in (("category, calibrated", calibrated), ("category, as of the network", shares[known])):
        best = p.max(1)
        print(f"{title}: said, true, views")
        print_bins(best.values, (best.indices == truth[known]).float(), torch.ones(len(p)))
        nothing = -p.gather(1, truth[known][:, None]).clamp(min=1e-12).log().mean()
        print(f"  log loss {float(nothing):.3f}")


def print_bins(said: Tensor, true: Tensor, weight: Tensor) -> None:
    """Print the mean probability and the observed frequency of each bin, and the expected calibration error."""
    index = (said * BINS).long().clamp(max=BINS - 1)
    error = 0.0
    for number in range(BINS):
        inside = index == number
        if not bool(inside.any()):
            continue
        share = weight[inside] / weight[inside].sum()
        means = float((said[inside] * share).sum()), float((true[inside] * share).sum())
        error += abs(means[0] - means[1]) * float(weight[inside].sum() / weight.sum())
        print(f"  {number / BINS:.1f} to {(number + 1) / BINS:.1f}: {means[0]:.2f} {means[1]:.2f} {int(inside.sum())}")
    print(f"  expected calibration error {error:.3f}")


def main() -> None:
    """Calibrate and describe."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", type=Path)
    parser.add_argument("strangers", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=CALIBRATION)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    splits = read_splits(options.models / "splits.csv")
    models = [(it, splits.get((it.category, it.name))) for it in find_models(options.models)[0]]
    strangers = [(path, NONE) for path in sorted(options.strangers.iterdir())]
    familiar = {
        split: [(it.path, CLASSES.index(it.category)) for it, own in models if own == split]
        for split in ("train", "val", "test")
    }
    calibration = fit(look(familiar["train"]), look(familiar["val"] + strangers[::2]))
    numbers = {"temperature": calibration.temperature, "weights": calibration.weights, "bias": calibration.bias}
    options.output.write_text(json.dumps({"evidence": EVIDENCE, **numbers}) + "\n", encoding="utf-8")
    describe(calibration, look(familiar["test"] + strangers[1::2]))


if __name__ == "__main__":
    main()
