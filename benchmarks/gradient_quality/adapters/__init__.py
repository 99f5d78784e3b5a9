"""The renderers of the benchmark. To add one, write an `Adapter` and a function `adapters`; name it in `PEERS`."""

from __future__ import annotations

import importlib
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


# Modules of this folder, named as the packages that they need: the name in tables, and how to install it.
PEERS = {
    "deodr": ("DEODR", "pip install deodr"),
    "drtk": ("DRTK", "from source, github.com/facebookresearch/DRTK"),
    "pytorch3d": ("PyTorch3D", "from source, github.com/facebookresearch/pytorch3d"),
    "mitsuba": ("Mitsuba 3", "pip install mitsuba; LLVM 19 on the CPU"),
}


def available(names: list[str] | None = None) -> tuple[list[Adapter], list[str]]:
    """Make the adapters that can run here, of these names or all; also return a sentence for each that cannot."""
    from .ours import Ours, Reinforce
    from .silhouettes import Antialias

    adapters: list[Adapter] = [Ours("edge"), Ours("nmr"), Ours("opendr"), Reinforce(), Antialias()]
    missing = ["nvdiffrast, kaolin: not measured, they need CUDA; nvdiffrast's antialiasing by our implementation"]
    for module, (title, how) in PEERS.items():
        if names is not None and not any(name.startswith(title) for name in names):
            continue
        if importlib.util.find_spec(module) is None:
            missing.append(f"{title}: skipped, it is not installed here ({how})")
            continue
        try:
            adapters += importlib.import_module(f".{module}", __package__).adapters()
        except ImportError as error:
            missing.append(f"{title}: skipped, its import failed ({error})")
    return [one for one in adapters if names is None or one.name in names], missing
