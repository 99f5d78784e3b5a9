"""The training of one network, as Lightning runs it."""

from __future__ import annotations

import copy
import math
import time
from typing import Any

import lightning
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.data import DataLoader

from ....compat.adam import Adam
from ....features import FeatureNetwork
from ....losses import silhouette_iou_loss
from ..data.arrays import Split
from ..data.framing import VIEWS
from ..networks.checkpoint import HEADER, header
from ..networks.configs import Config
from ..networks.make_network import Model, make_network
from ..networks.mesh_network import MeshNetwork
from .sampling import Batches, prepared

_MEASURED = 40  # objects of a class at each validation


class Training(lightning.LightningModule):
    """Silhouettes as the only teacher: section 4.1 of the paper, for meshes and for voxels.

    An epoch of Lightning is a round of ``every`` steps, after which the network is validated. The number of steps
    taken, and all that follows from it, is kept here and not in Lightning's loops, so that a training resumed from a
    checkpoint does what it would have done.

    Args:
        kind: "mesh" or "voxel".
        config: the recipe.
        train, val: what to learn from and to measure on; None where there is nothing of the kind.
        minutes: end after so long, and let the schedule fit into that time (math.inf: after ``config.steps``).
        every: steps between two validations.
        seed: of the network's start and of the batches.
        workers: processes that read batches ahead; 0 reads them in the training process.
        features: for the recipe's encoder, if that is "features".
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

    @property
    def model(self) -> Model:
        """The network that predictions are made with: that of averaged weights, if there is one."""
        return self.network if self.average is None else self.average

    @property
    def done(self) -> bool:
        """Whether all steps, or all minutes, are over."""
        return self.progress >= 1

    def train_dataloader(self) -> Any:
        """The batches of this round."""
        batches = self.batches(self.trainer.global_rank, self.trainer.world_size)
        return DataLoader(batches, batch_size=None, shuffle=False, num_workers=self._workers)

    def batches(self, rank: int = 0, world: int = 1) -> Batches:
        """What this process learns from until the end of the round."""
        last = min(self.config.steps, (self.steps_done // self.every + 1) * self.every)
        last = self.steps_done if self.done else last
        return Batches(self.train_split, self.config, self.seed, self.steps_done, last, rank, world)

    def val_dataloader(self) -> Any:
        """The objects of the validation split, one at a time: of large classes the first ones."""
        split = self.val_split
        if split is None:
            return []
        self._val_images = split.images
        items = [(name, index) for name in split.classes for index in range(min(len(split.images[name]), _MEASURED))]
        return DataLoader(items, batch_size=None, shuffle=False)  # type: ignore[arg-type]

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """The recipe's optimiser; each group of parameters keeps its own rate as "base"."""
        config, network = self.config, self.network
        learned = [value for value in network.parameters() if value.requires_grad]
        if config.optimiser == "adam":
            # The published code lets the global bias learn ten times more slowly than all else.
            slow = list(network.decoder.global_bias.parameters()) if isinstance(network, MeshNetwork) else []
            fast = [value for value in learned if all(value is not other for other in slow)]
            groups = [{"params": fast, "lr": config.rate, "base": config.rate}]
            groups += [{"params": slow, "lr": config.rate / 10, "base": config.rate / 10}] if slow else []
            return Adam(groups)
        matrices = [value for value in learned if value.ndim > 1]
        others = [value for value in learned if value.ndim <= 1]
        groups = [
            {"params": matrices, "weight_decay": config.decay, "base": config.rate},
            {"params": others, "weight_decay": 0.0, "base": config.rate},
        ]
        return torch.optim.AdamW(groups, lr=config.rate, betas=(0.9, 0.99), fused=True)

    def on_train_start(self) -> None:
        self._clock = time.monotonic() - self.seconds

    def on_train_batch_start(self, batch: Any, batch_idx: int) -> None:
        """The learning rate of this step."""
        factor = schedule(self.config.schedule, self.progress)
        for group in self.optimizers().param_groups:  # type: ignore[union-attr]
            group["lr"] = group["base"] * factor

    def training_step(self, batch: dict[str, Tensor], batch_idx: int) -> Tensor:
        """The loss of one batch."""
        images, alpha, views = prepared(batch, self.config.inputs)
        shapes = self.network(images.flatten(0, 1).contiguous(memory_format=torch.channels_last))
        with torch.autocast(images.device.type, enabled=False):
            seen, looks, target = beside_views(shapes, alpha, views)
            drawn = self.network.silhouettes(seen, looks)
            error = silhouette_iou_loss(drawn, sized_like(drawn, target))
            loss = error + self.network.regulariser(shapes)
        self.latest = {"loss": loss.detach(), "iou": 1 - error.detach()}  # type: ignore[dict-item]
        return loss

    def on_before_optimizer_step(self, optimizer: torch.optim.Optimizer) -> None:
        """The gradient, which all processes share by now, must be finite before it moves the weights."""
        gradients = [value.grad for value in self.network.parameters() if value.grad is not None]
        size = torch.stack(torch._foreach_norm(gradients)).norm()
        if not torch.isfinite(size):
            raise ValueError(
                f"loss: expected finite numbers, got {float(self.latest['loss']):g} with a gradient of size "
                f"{float(size):g} at step {self.steps_done}; the checkpoints are those of earlier steps"
            )

    def optimizer_step(self, *arguments: Any, **named: Any) -> None:
        """Take the step, count it, and average the weights."""
        super().optimizer_step(*arguments, **named)
        self.steps_done += 1
        self.seconds = time.monotonic() - self._clock
        self.progress = max(self.steps_done / self.config.steps, self.seconds / 60 / self.minutes)
        self.latest = {name: float(value) for name, value in self.latest.items()}
        if self.average is not None:
            # A short memory at first: the first weights are not worth remembering.
            keep = min(self.config.average, (1 + self.steps_done) / (10 + self.steps_done))
            pairs = zip(self.average.parameters(), self.network.parameters(), strict=True)
            means, values = zip(*((mean, value.detach()) for mean, value in pairs if value.requires_grad), strict=True)
            torch._foreach_lerp_(means, values, 1 - keep)

    def validation_step(self, item: Any, batch_idx: int) -> None:
        """IoU of the silhouettes of an object in all its views, predicted from one of them."""
        name, index = item
        images = torch.from_numpy(self._val_images[name][index].copy()).to(self.device).float() / 255
        views = torch.arange(VIEWS, device=self.device)
        look = torch.tensor([batch_idx * 7 % VIEWS, (batch_idx * 7 + 11) % VIEWS], device=self.device)
        model = self.model
        shapes = model(images[look])
        with torch.autocast(images.device.type, enabled=False):
            seen = shapes.repeat_interleave(VIEWS, 0)
            drawn = model.silhouettes(seen, views.repeat(len(look)))
            target = sized_like(drawn, images[:, 3]).repeat(len(look), 1, 1)
            self._scores.setdefault(name, []).append(1 - float(silhouette_iou_loss(drawn, target)))

    def on_validation_epoch_start(self) -> None:
        self._scores: dict[str, list[float]] = {}

    def on_validation_epoch_end(self) -> None:
        """The mean over classes of the mean over objects."""
        if self._scores:
            means = [sum(values) / len(values) for values in self._scores.values()]
            self.latest["val_iou"] = sum(means) / len(means)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        weights = "network." if self.average is None else "average."
        checkpoint[HEADER] = header(self.model, self.train_split.classes, weights)
        checkpoint["training"] = {"steps": self.steps_done, "seconds": self.seconds, "seed": self.seed}
        checkpoint.pop("loops", None)  # see the class

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        state = checkpoint["training"]
        self.steps_done, self.seconds, self.seed = state["steps"], state["seconds"], state["seed"]
        self.progress = max(self.steps_done / self.config.steps, self.seconds / 60 / self.minutes)


def schedule(name: str, progress: float) -> float:
    """The factor on the learning rate when this part, in [0, 1], of the training is over."""
    if name == "step":
        return 1.0 if progress < 0.95 else 0.1
    if progress < 0.02:
        return max(progress / 0.02, 0.01)
    return 0.5 + 0.5 * math.cos(math.pi * min(1.0, (progress - 0.02) / 0.98))


def beside_views(shapes: Tensor, alpha: Tensor, views: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Every prediction beside all views of its object.

    shapes: [I · n, ...], I predictions of each of n objects. alpha: [V, n, H, W] and views: [V, n], of the objects.
    Returns shapes [I · V · n, ...], views [I · V · n] and what should be seen there [I · V · n, H, W].
    """
    count = views.shape[1]
    inputs = len(shapes) // count
    seen = shapes.unflatten(0, (inputs, 1, count)).expand(-1, len(views), *[-1] * shapes.ndim).flatten(0, 2)
    target = alpha.expand(inputs, *[-1] * alpha.ndim).flatten(0, 2)
    return seen, views.expand(inputs, -1, -1).flatten(), target


def sized_like(drawn: Tensor, target: Tensor) -> Tensor:
    """Silhouettes [B, H, W] averaged down to the size that a network draws, where that is smaller."""
    height, width = drawn.shape[-2:]
    return target if target.shape[-2:] == (height, width) else F.adaptive_avg_pool2d(target, (height, width))
