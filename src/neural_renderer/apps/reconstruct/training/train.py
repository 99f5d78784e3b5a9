"""`train`: a whole training with Lightning, in one process or several, new or resumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import lightning
import torch
from lightning.pytorch.loggers import TensorBoardLogger

from ....io.files import reason
from ...common.features import FeatureNetwork
from ...common.observer import Observer
from ..data.arrays import Split
from ..networks.checkpoint import LAST
from ..networks.configs import Config
from ..settings import RunSettings
from .callbacks import Checkpoints, Log, Watch
from .sampling import Batches
from .training import Training

_LOST = ("gloo", "NCCL", "Connection closed", "Connection reset")  # in errors of torch when a process is lost


def train(
    kind: str,
    config: Config,
    data: Split,
    val: Split | None,
    out: Path,
    run: RunSettings = RunSettings(),  # noqa: B008 (immutable)
    *,
    checkpoint: Path | None = None,
    features: FeatureNetwork | None = None,
    interrupted: list[int] | None = None,
    observer: Observer | None = None,
) -> Training:
    """Train a network until it is done, or interrupted because a list is not empty; return the training.

    Other arguments are as in `Training`. All processes, ``run.devices`` on each of the ``run.nodes``, share each batch
    (DDP). Networks run in bfloat16 if ``run.low_precision`` and `has_bfloat16`. The observer sees the steps, with
    predictions for a few pictures; it may pause and stop the training and change its learning rate. Only the first
    process calls it.

    Raises ValueError if a loss or gradient is not finite, or a batch cannot be shared; OSError if a file cannot be
    written, or another process of the training was lost.
    """
    Batches(data, config, run.seed, 0, 0, 0, run.devices * run.nodes)  # raises before any process is started
    out.mkdir(parents=True, exist_ok=True)
    same = {name: getattr(run, name) for name in ("minutes", "every", "seed", "workers")}
    training = Training(kind, config, data, val, features=features, **same)
    many = run.devices * run.nodes > 1
    interrupted = [] if interrupted is None else interrupted
    watchers = [] if observer is None else [Watch(observer, interrupted)]
    trainer = lightning.Trainer(
        accelerator={"cuda": "gpu"}.get(run.device, run.device),
        devices=run.devices,
        num_nodes=run.nodes,
        strategy="ddp" if many else "auto",
        precision="bf16-mixed" if run.low_precision and has_bfloat16(run.device) else "32-true",
        max_epochs=-1,
        reload_dataloaders_every_n_epochs=1,
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
        logger=TensorBoardLogger(out, name="tensorboard", version=""),
        callbacks=[*watchers, Checkpoints(out, interrupted), Log(out)],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        inference_mode=False,  # validation uses averaged weights, which later steps change in place
    )
    try:
        trainer.fit(training, ckpt_path=checkpoint, weights_only=True if checkpoint else None)
    except RuntimeError as error:
        if many and any(word in str(error) for word in _LOST):
            raise ConnectionError(
                f"expected all {run.devices * run.nodes} processes to go on, got none from one of them "
                f"({reason(error)}); the training can continue from {out / LAST}"
            ) from error
        raise
    return training


def has_bfloat16(device: str) -> bool:
    """Return whether the hardware is fast at bfloat16: GPUs since Ampere, processors with AMX."""
    if device != "cpu" and torch.cuda.is_available():
        return torch.cuda.is_bf16_supported(including_emulation=False)
    known: dict[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()  # of recent versions of torch
    return bool(known.get("amx_tile", False))
