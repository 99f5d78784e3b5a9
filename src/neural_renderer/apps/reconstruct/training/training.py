"""`Training`: the Lightning module that trains a reconstruction network."""

from __future__ import annotations

import copy
import math
import time
from typing import Any

import lightning
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torch.utils.data import DataLoader

from ....compat.first_packages.adam import Adam
from ....optim.losses import soft_iou_loss
from ...common.features import FeatureNetwork
from ..data.arrays import Split
from ..data.framing import VIEWS
from ..networks.checkpoint import HEADER, Model, header, make_network
from ..networks.configs import Config
from ..networks.mesh_network import MeshNetwork
from .sampling import Batches, prepare_batch

_VALIDATED = 40  # objects of a class at each validation
_STRIDE, _APART = 7, 11  # distances of input views in a validation: from object to object, and of the two
_BIAS_SLOWDOWN = 10  # the learning rate of the global bias is smaller by this factor in the published code
_ADAMW_BETAS = (0.9, 0.99)
_DROP_AT, _DROP_TO = 0.95, 0.1  # schedule "step": progress and factor
_WARM_UP, _LEAST_FACTOR = 0.02, 0.01  # schedule "cosine": progress at the end of the warm-up, and first factor


class Training(lightning.LightningModule):
    """Training of a mesh or voxel network from silhouettes only (section 4.1 of the paper).

    An epoch of Lightning is a round of ``every`` steps, followed by a validation. The number of steps is counted here
    and not in Lightning's loops, so that a resumed training continues exactly. The schedule is fitted into the time
    limit of ``minutes``; ``workers`` processes load batches ahead; ``features`` is the recognition network of the
    encoder "features".
    """

    def __init__(
        self,
        kind: str,
        config: Config,
        train: Split,
        val: Split | None = None,
        *,
        minutes: float = math.inf,
        every: int = 200,
        seed: int = 0,
        workers: int = 0,
        features: FeatureNetwork | None = None,
    ) -> None:
        super().__init__()
        self.config, self.train_split, self.val_split = config, train, val
        self.every, self.minutes, self.seed, self._workers = every, minutes, seed, workers
        torch.manual_seed(seed)
        self.network: Model = make_network(kind, config, features)
        self.network.encoder.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average: Model | None = copy.deepcopy(self.network).requires_grad_(False) if config.average else None
        self.steps_done = 0
        self.seconds = 0.0
        self.progress = 0.0
        self._clock = 0.0
        self.latest: dict[str, float] = {}
        self.rate_factor = 1.0

    @property
    def model(self) -> Model:
        """Network for predictions: the one with averaged weights, if there is one."""
        return self.network if self.average is None else self.average

    @property
    def done(self) -> bool:
        """Whether all steps are taken or the time is over."""
        return self.progress >= 1

    def train_dataloader(self) -> Any:
        """Make the loader of the batches of this round."""
        batches = self.batches(self.trainer.global_rank, self.trainer.world_size)
        return DataLoader(batches, batch_size=None, shuffle=False, num_workers=self._workers)

    def batches(self, rank: int = 0, world: int = 1) -> Batches:
        """Make the remaining batches of this round for one process."""
        last = min(self.config.steps, (self.steps_done // self.every + 1) * self.every)
        last = self.steps_done if self.done else last
        return Batches(self.train_split, self.config, self.seed, self.steps_done, last, rank, world)

    def val_dataloader(self) -> Any:
        """Make the loader of validation objects: up to 40 of each class."""
        split = self.val_split
        if split is None:
            return []
        self._val_images = split.images
        items = [(name, index) for name in split.classes for index in range(min(len(split.images[name]), _VALIDATED))]
        return DataLoader(items, batch_size=None, shuffle=False)  # type: ignore[arg-type]

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Make the optimiser of the configuration; "base" is the learning rate of a group before the schedule."""
        config, network = self.config, self.network
        learned = [value for value in network.parameters() if value.requires_grad]
        if config.optimiser == "adam":
            slow = list(network.decoder.global_bias.parameters()) if isinstance(network, MeshNetwork) else []
            fast = [value for value in learned if all(value is not other for other in slow)]
            groups = [{"params": fast, "lr": config.rate, "base": config.rate}]
            slow_rate = config.rate / _BIAS_SLOWDOWN
            groups += [{"params": slow, "lr": slow_rate, "base": slow_rate}] if slow else []
            return Adam(groups)
        matrices = [value for value in learned if value.ndim > 1]
        others = [value for value in learned if value.ndim <= 1]
        groups = [
            {"params": matrices, "weight_decay": config.decay, "base": config.rate},
            {"params": others, "weight_decay": 0.0, "base": config.rate},
        ]
        return torch.optim.AdamW(groups, lr=config.rate, betas=_ADAMW_BETAS, fused=True)

    def on_train_start(self) -> None:
        """Start the clock; the time of earlier runs counts."""
        self._clock = time.monotonic() - self.seconds

    def on_train_batch_start(self, batch: Any, batch_idx: int) -> None:
        """Set the learning rate of this step."""
        factor = schedule(self.config.schedule, self.progress)
        for group in self.optimizers().param_groups:  # type: ignore[union-attr]
            group["lr"] = group["base"] * factor * self.rate_factor

    def training_step(self, batch: dict[str, Tensor], batch_idx: int) -> Tensor:
        """Compute the loss of a batch."""
        images, alpha, views = prepare_batch(batch, self.config.inputs)
        shapes = self.network(images.flatten(0, 1).contiguous(memory_format=torch.channels_last))
        with torch.autocast(images.device.type, enabled=False):
            paired, paired_views, target = pair_with_views(shapes, alpha, views)
            silhouettes = self.network.silhouettes(paired, paired_views)
            error = soft_iou_loss(silhouettes, downsample_like(silhouettes, target))
            loss = error + self.network.regularizer(shapes)
        self.latest = {"loss": loss.detach(), "iou": 1 - error.detach()}  # type: ignore[dict-item]
        return loss

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:
        """Raise ValueError if the gradient, which is the mean over processes, is not finite."""
        gradients = [value.grad for value in self.network.parameters() if value.grad is not None]
        size = torch.nn.utils.get_total_norm(gradients)
        if not torch.isfinite(size):
            raise ValueError(
                f"loss: expected finite numbers, got {float(self.latest['loss']):g} with a gradient of size "
                f"{float(size):g} at step {self.steps_done}; the last checkpoint is from an earlier step"
            )

    def optimizer_step(self, *arguments: Any, **named: Any) -> None:
        """Take the step, count it, and average the weights."""
        super().optimizer_step(*arguments, **named)
        self.steps_done += 1
        self.seconds = time.monotonic() - self._clock
        self.progress = max(self.steps_done / self.config.steps, self.seconds / 60 / self.minutes)
        self.latest = {name: float(value) for name, value in self.latest.items()}
        if self.average is not None:
            # A faster decay at first, to forget the initial weights.
            keep = min(self.config.average, (1 + self.steps_done) / (10 + self.steps_done))
            pairs = zip(self.average.parameters(), self.network.parameters(), strict=True)
            means, values = zip(*((mean, value.detach()) for mean, value in pairs if value.requires_grad), strict=True)
            get_ema_multi_avg_fn(keep)(means, values, None)

    def validation_step(self, item: Any, batch_idx: int) -> None:
        """Compute the IoU of all silhouettes of an object, predicted from two of its views."""
        name, index = item
        images = torch.from_numpy(self._val_images[name][index].copy()).to(self.device).float() / 255
        views = torch.arange(VIEWS, device=self.device)
        first = batch_idx * _STRIDE
        inputs = torch.tensor([first % VIEWS, (first + _APART) % VIEWS], device=self.device)
        model = self.model
        shapes = model(images[inputs])
        with torch.autocast(images.device.type, enabled=False):
            silhouettes = model.silhouettes(shapes.repeat_interleave(VIEWS, 0), views.repeat(len(inputs)))
            target = downsample_like(silhouettes, images[:, 3]).repeat(len(inputs), 1, 1)
            self._scores.setdefault(name, []).append(1 - float(soft_iou_loss(silhouettes, target)))

    def on_validation_epoch_start(self) -> None:
        """Forget the scores of the last validation."""
        self._scores: dict[str, list[float]] = {}

    def on_validation_epoch_end(self) -> None:
        """Average over objects, then over classes."""
        if self._scores:
            means = [sum(values) / len(values) for values in self._scores.values()]
            self.latest["val_iou"] = sum(means) / len(means)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add the header and the state of the training to a checkpoint."""
        weights = "network." if self.average is None else "average."
        checkpoint[HEADER] = header(self.model, self.train_split.classes, weights)
        checkpoint["training"] = {"steps": self.steps_done, "seconds": self.seconds, "seed": self.seed}
        checkpoint.pop("loops", None)  # steps are counted here (see the class)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Restore the state of the training."""
        state = checkpoint["training"]
        self.steps_done, self.seconds, self.seed = state["steps"], state["seconds"], state["seed"]
        self.progress = max(self.steps_done / self.config.steps, self.seconds / 60 / self.minutes)


def schedule(name: str, progress: float) -> float:
    """Compute the factor on the learning rate at a fraction of the training, for "step" or "cosine" (see `Config`)."""
    if name == "step":
        return 1.0 if progress < _DROP_AT else _DROP_TO
    if progress < _WARM_UP:
        return max(progress / _WARM_UP, _LEAST_FACTOR)
    return 0.5 + 0.5 * math.cos(math.pi * min(1.0, (progress - _WARM_UP) / (1 - _WARM_UP)))


def pair_with_views(shapes: Tensor, alpha: Tensor, views: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Pair each of I predictions of n objects with all V views of its object.

    From shapes [I · n, ...], silhouettes [V, n, H, W] and numbers of views [V, n] follow shapes [I · V · n, ...], views
    [I · V · n] and target silhouettes [I · V · n, H, W].
    """
    count = views.shape[1]
    inputs = len(shapes) // count
    paired = shapes.unflatten(0, (inputs, 1, count)).expand(-1, len(views), *[-1] * shapes.ndim).flatten(0, 2)
    target = alpha.expand(inputs, *[-1] * alpha.ndim).flatten(0, 2)
    return paired, views.expand(inputs, -1, -1).flatten(), target


def downsample_like(silhouettes: Tensor, target: Tensor) -> Tensor:
    """Average target silhouettes [B, H, W] down to the size of the network's silhouettes, if that is smaller."""
    height, width = silhouettes.shape[-2:]
    return target if target.shape[-2:] == (height, width) else F.adaptive_avg_pool2d(target, (height, width))
