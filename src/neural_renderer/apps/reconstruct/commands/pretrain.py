"""`neural-renderer reconstruct pretrain`: training of the package's network on generated shapes."""

from __future__ import annotations

import math

from ...common.command import INTERRUPTED, say
from ..data.arrays import open_split
from ..data.models_folder import default_splits, find_models, read_splits
from ..options import PretrainOptions
from ..shapes.shapes import Shapes
from ..training.pretrain import WEIGHTS, pretrain


def run(options: PretrainOptions) -> int:
    """Train the network; return the exit code: 0, or 130 after Ctrl-C."""
    limit = math.inf if options.minutes is None else options.minutes
    if (options.out / WEIGHTS).exists() and not options.resume:
        raise ValueError(f"OUT: expected a folder without a training, or --resume, got {options.out / WEIGHTS}")
    models = []
    if options.models is not None:
        found = find_models(options.models)[0]
        splits = default_splits(found) if options.splits is None else read_splits(options.splits)
        models = [model for model in found if splits.get((model.category, model.name)) == "train"]
    val = None if options.data is None else open_split(options.data, "val")
    shapes = Shapes(options.seed, models)
    try:
        pretrain(shapes, options.out, options.steps, limit, val, options.every, options.resume, say)
    except KeyboardInterrupt:
        say(f"stopped; --resume continues from {options.out}")
        return INTERRUPTED
    say(f"the network is in {options.out / WEIGHTS}")
    return 0
