"""`Objective`: a loss on the images of an edited mesh."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from .deformation import Deformation


class Objective(Protocol):
    """Loss on the images of an edited mesh: `Style` or `Dream`."""

    name: str  # name of the main loss
    plain: Tensor  # [3], initial colour of a mesh without colours

    def background(self, count: int, generator: torch.Generator, /) -> Tensor:
        """Choose the background colours behind the object.

        Args:
            count: Number of images.
            generator: Random numbers, on the CPU.

        Returns:
            [count, 3].
        """
        ...

    def losses(self, images: Tensor, masks: Tensor, shape: Deformation, /) -> dict[str, Tensor]:
        """Compute the losses.

        Args:
            images: [B, 3, H, W] in [0, 1].
            masks: [B, H, W] in [0, 1], silhouettes of the object.
            shape: Deformation of the mesh.

        Returns:
            Weighted losses by name, scalars; their sum is to be minimised.

        Raises:
            TypeError, ValueError: The images do not fit or are too small for a layer.
        """
        ...

    def measure(self, images: Tensor, masks: Tensor, /) -> Tensor:
        """Compute the main measure of each image.

        Args:
            images, masks: As in `losses`.

        Returns:
            [B], without a gradient.

        Raises:
            TypeError, ValueError: As `losses`.
        """
        ...
