"""The renderers of the benchmark. To add one, write an `Adapter` and name it in `available`."""

from __future__ import annotations

import importlib.util
from typing import Protocol

from torch import Tensor

from ..picture import Picture


class Adapter(Protocol):
    """A renderer: a picture in, its image and gradient out.

    Attributes:
        name: In tables.
        most_shifts: Sub-pixel shifts that it has time for.

    A renderer whose image is not exact, but smoothed, also has a method ``image(picture)``, for losses in practice.
    """

    name: str
    most_shifts: int

    def draw(self, picture: Picture, pull: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Draw a picture and send a gradient back.

        Args:
            picture: The scene, without gradients.
            pull: Gradient of a loss to the image, [3, size, size] float64, row 0 at the top.

        Returns:
            The image, [3, size, size]; the gradients to ``vertices``, [V, 3], in pixels, and to ``colors``, [F, 3, 3].
        """


def available(names: list[str] | None = None) -> tuple[list[Adapter], list[str]]:
    """Make the adapters that can run here, of these names or all; also return a sentence for each that cannot."""
    from .ours import Ours, Reinforce

    adapters: list[Adapter] = [Ours("edge"), Ours("nmr"), Ours("opendr"), Reinforce()]
    missing = ["nvdiffrast, kaolin: not measured, they need CUDA"]
    if importlib.util.find_spec("deodr"):
        from .deodr import Deodr

        adapters.append(Deodr())
    else:
        missing.append("DEODR: skipped, it is not installed here (pip install deodr)")
    if importlib.util.find_spec("drtk"):
        from .drtk import Drtk

        adapters.append(Drtk())
    else:
        missing.append("DRTK: skipped, it is not installed here (from source, github.com/facebookresearch/DRTK)")
    if importlib.util.find_spec("pytorch3d"):
        from .pytorch3d import PyTorch3D

        adapters += [PyTorch3D(soft=False), PyTorch3D(soft=True)]
    else:
        missing.append(
            "PyTorch3D: skipped, it is not installed here (from source, github.com/facebookresearch/pytorch3d)"
        )
    if importlib.util.find_spec("mitsuba"):
        from .mitsuba import Mitsuba

        adapters.append(Mitsuba())
    else:
        missing.append("Mitsuba 3: skipped, it is not installed here (pip install mitsuba; LLVM 19 on the CPU)")
    return [one for one in adapters if names is None or one.name in names], missing
