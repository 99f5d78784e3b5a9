"""A whole training with Lightning: one process or many, from the beginning or from a checkpoint."""

from __future__ import annotations

import math
from pathlib import Path

import lightning
import torch
from lightning.pytorch.loggers import TensorBoardLogger

from ....features import FeatureNetwork
from ..data.arrays import Split
from ..networks.configs import Config
from .callbacks import Keep, Record
from .sampling import Batches
from .training import Training


def fit(
    kind: str,
    config: Config,
    train: Split,
    val: Split | None,
    out: Path,
    *,
    minutes: float = math.inf,
    every: int = 250,
    seed: int = 0,
    workers: int = 0,
    devices: int = 1,
    nodes: int = 1,
    device: str = "auto",
    low_precision: bool = False,
    checkpoint: Path | None = None,
    features: FeatureNetwork | None = None,
    interrupted: list[int] | None = None,
) -> Training:
    """Train until it is done, or until ``interrupted`` has something in it; the results are in the folder ``out``.

    Args:
        kind, config, train, val, minutes, every, seed, workers, features: as `Training`.
        devices, nodes: processes on each machine, and machines; they share each batch, by DDP.
        device: "cpu", "cuda" or "auto".
        low_precision: bfloat16 for the networks, where `has_bfloat16`.
        checkpoint: a "last.ckpt" to go on from.

    Raises ValueError at a loss that is not finite, OSError for a checkpoint that cannot be written.
    """
    Batches(train, config, seed, 0, 0, 0, devices * nodes)  # one that cannot be shared is told before all is started
    out.mkdir(parents=True, exist_ok=True)
    training = Training(
        kind, config, train, val, minutes=minutes, every=every, seed=seed, workers=workers, features=features
    )
    many = devices * nodes > 1
    trainer = lightning.Trainer(
        accelerator={"cuda": "gpu"}.get(device, device),
        devices=devices,
        num_nodes=nodes,
        strategy="ddp" if many else "auto",
        precision="bf16-mixed" if low_precision and has_bfloat16(device) else "32-true",
        max_epochs=-1,
        reload_dataloaders_every_n_epochs=1,
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
        logger=TensorBoardLogger(out, name="tensorboard", version=""),
        callbacks=[Keep(out, [] if interrupted is None else interrupted), Record(out)],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        inference_mode=False,  # the average of weights that validation looks at goes on being changed
    )
    trainer.fit(training, ckpt_path=checkpoint, weights_only=True if checkpoint else None)
    return training


def has_bfloat16(device: str = "auto") -> bool:
    """Whether the hardware is faster in bfloat16: GPUs since Ampere, processors with AMX."""
    if device != "cpu" and torch.cuda.is_available():
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return bool(getattr(torch.cpu, "_is_amx_tile_supported", lambda: False)())
