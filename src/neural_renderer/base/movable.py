"""`Movable` and `Replaceable`: dataclasses of tensors, copied to another device or with other attributes."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from typing_extensions import Self


class Movable:
    """Base of dataclasses whose tensors go to another device together."""

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
    """Base of dataclasses that are copied with other attributes."""

    def replace(self, **parts: Any) -> Self:
        """Copy with some of the attributes exchanged, such as vertices that move, without losing gradients.

        Args:
            **parts: Attributes by their names.

        Returns:
            The copy. It shares all others.

        Raises:
            TypeError, ValueError: A name is not that of an attribute, or the parts do not fit together.

        Example:
            >>> rig = nr.Rig(nr.Mesh.icosphere(1), [-1], torch.zeros(1, 3), torch.ones(42, 1))
            >>> rig.replace(names=("hip",)).names
            ('hip',)
        """
        return dataclasses.replace(self, **parts)  # type: ignore[type-var]
