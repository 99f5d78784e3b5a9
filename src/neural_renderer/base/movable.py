"""`Movable` and `Replaceable`: dataclasses of tensors, copied to another device or with changed attributes."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from typing_extensions import Self


class Movable:
    """Base of dataclasses whose tensors are copied to another device together."""

    def to(self, device: torch.device | str) -> Self:
        """Copy all tensors to another device.

        Args:
            device: Device of the copy, such as "cuda".

        Returns:
            The copy. Gradients flow back to the original.

        Raises:
            RuntimeError: There is no such device.

        Example:
            >>> gold = nr.Material("gold", metallic=1.0).to("cpu")
        """

        def moved(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(moved, value))
            return value.to(device) if hasattr(value, "to") else value

        parts = {part.name: moved(getattr(self, part.name)) for part in dataclasses.fields(self)}  # type: ignore[arg-type]
        return dataclasses.replace(self, **parts)  # type: ignore[type-var]


class Replaceable(Movable):
    """Base of dataclasses that are copied with changed attributes."""

    def replace(self, **parts: Any) -> Self:
        """Copy the object with some attributes replaced, such as moved vertices. Gradients flow through the copy.

        Args:
            **parts: New values of attributes, by name.

        Returns:
            The copy. It shares the other attributes.

        Raises:
            TypeError, ValueError: An attribute does not exist, or the values do not fit together.

        Example:
            >>> rig = nr.Rig(nr.Mesh.icosphere(1), [-1], torch.zeros(1, 3), torch.ones(42, 1))
            >>> rig.replace(names=("hip",)).names
            ('hip',)
        """
        return dataclasses.replace(self, **parts)  # type: ignore[type-var]
