"""`TensorProperties`: parameters of cameras, lights and materials, with a common batch."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

if TYPE_CHECKING:
    from typing_extensions import Self


class TensorProperties:
    """Attributes that are tensors [N, ...]. Numbers, lists and tensors of batch 1 are repeated N times."""

    def __init__(self, device: Any = "cpu", **values: Any) -> None:
        self.device = torch.device(device)
        batches = {name: batched(value, self.device) for name, value in values.items() if value is not None}
        self._N = max(map(len, batches.values()), default=1)
        for name, value in values.items():
            batch = batches.get(name, value)
            setattr(self, name, batch.expand(self._N, *batch.shape[1:]) if isinstance(batch, Tensor) else batch)

    def __len__(self) -> int:
        return self._N

    def __getitem__(self, index: Any) -> Self:
        rows = torch.atleast_1d(torch.arange(self._N)[index])
        found = self._each(
            lambda value: value[rows.to(value.device)] if value.ndim and len(value) == self._N else value
        )
        found._N = len(rows)
        return found

    def to(self, device: Any) -> Self:
        moved = self._each(lambda value: value.to(device))
        moved.device = torch.device(device)
        return moved

    def clone(self, other: Self | None = None) -> Self:
        made = self._each(Tensor.clone)
        if other is None:
            return made
        vars(other).update(vars(made))
        return other

    def _each(self, change: Any) -> Self:
        result = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, Tensor):
                setattr(result, name, change(value))
        return result


def batched(value: Any, device: Any) -> Tensor:
    """Convert a number, list or tensor to a floating tensor [N, ...]."""
    tensor = value if isinstance(value, Tensor) else torch.tensor(value, dtype=torch.float32)
    return torch.atleast_1d(tensor).to(device)


def convert_to_tensors_and_broadcast(*args: Any, dtype: Any = torch.float32, device: Any = "cpu") -> list[Tensor]:
    """Convert values as `batched`, repeated to the largest batch among them."""
    tensors = [batched(value, device).to(dtype) for value in args]
    most = max(map(len, tensors))
    return [tensor.expand(most, *tensor.shape[1:]) for tensor in tensors]
