"""Time of each part of a training step: data, network, renderer, losses, optimiser.

python -m benchmarks.reconstruction_step DATA --config paper --model mesh

With other programs running: OMP_NUM_THREADS=1 python -m benchmarks.reconstruction_step DATA --processor
"""

from __future__ import annotations

import statistics
import time
from dataclasses import replace
from pathlib import Path

import torch
import tyro

from neural_renderer.apps.common.features import load_features
from neural_renderer.apps.reconstruct.data.arrays import open_split
from neural_renderer.apps.reconstruct.names import ConfigName, ModelName
from neural_renderer.apps.reconstruct.networks.configs import make_config
from neural_renderer.apps.reconstruct.training.sampling import prepare_batch
from neural_renderer.apps.reconstruct.training.train import has_bfloat16
from neural_renderer.apps.reconstruct.training.training import Training, downsample_like, pair_with_views
from neural_renderer.losses import soft_iou_loss


def main(
    data: tyro.conf.Positional[Path],
    config: ConfigName = "paper",
    model: ModelName = "mesh",
    steps: int = 20,
    processor: bool = False,
    features: Path | None = None,
) -> None:
    """Print the median time of each part over some training steps, and its share.

    ``processor`` measures the processor time of all threads; wall-clock time would include other programs.
    ``features`` is the option of `reconstruct train`.
    """
    now_is = time.process_time if processor else time.perf_counter
    split = open_split(data, "train")
    recipe = make_config(config, split.classes)
    if features is not None:
        recipe = replace(recipe, encoder="features")
    looking = None if features is None else load_features(features)
    training = Training(model, recipe, split, every=steps, features=looking)
    network, optimiser = training.network, training.configure_optimizers()
    batches = training.batches()
    parts: dict[str, list[float]] = {}

    def took(name: str, since: float) -> float:
        now = now_is()
        parts.setdefault(name, []).append(now - since)
        return now

    for step in range(steps):
        clock = now_is()
        images, alpha, views = prepare_batch(batches[step], recipe.inputs)
        clock = took("data", clock)
        low = recipe.low_precision and has_bfloat16()
        with torch.autocast("cpu", torch.bfloat16, enabled=low):
            shapes = network(images.flatten(0, 1).contiguous(memory_format=torch.channels_last))
        clock = took("network, forward", clock)
        leaf = shapes.detach().requires_grad_()
        paired, paired_views, target = pair_with_views(leaf, alpha, views)
        drawn = network.silhouettes(paired, paired_views)
        clock = took("renderer, forward", clock)
        error = soft_iou_loss(drawn, downsample_like(drawn, target))
        (pull,) = torch.autograd.grad(error, drawn, retain_graph=True)
        regularizer = network.regularizer(leaf)
        (rest,) = torch.autograd.grad(regularizer, leaf) if regularizer.requires_grad else (0.0,)
        clock = took("losses", clock)
        (gradient,) = torch.autograd.grad(drawn, leaf, pull)
        clock = took("renderer, backward", clock)
        optimiser.zero_grad()
        shapes.backward(gradient + rest)
        clock = took("network, backward", clock)
        optimiser.step()
        took("optimiser", clock)
    medians = {name: statistics.median(times) for name, times in parts.items()}
    total = sum(medians.values())
    for name, seconds in medians.items():
        print(f"{name:20} {1000 * seconds:8.1f} ms {100 * seconds / total:5.1f} %")
    print(f"{'step':20} {1000 * total:8.1f} ms")


if __name__ == "__main__":
    tyro.cli(main)
