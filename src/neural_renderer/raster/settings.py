"""How faces are drawn, checked once: what all ways to an image have in common."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from .. import validate
from .ops.coverage import coverage
from .visibility.edge import boundaries
from .visibility.nmr import nmr_edges
from .visibility.rings import edge_rings

GRADIENTS = ("nmr", "edge")
_CGROUPS = Path("/proc/self/cgroup")
_LIMITS = {
    "": (Path("/sys/fs/cgroup"), "memory.max"),
    "memory": (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"),
}
FARTHEST = 1e37  # so that the sum of four depths is finite in float32


@dataclass(frozen=True)
class Settings:
    """Sizes in pixels of the image that is returned; the other fields as in `rasterize_images`."""

    height: int
    width: int
    near: float
    far: float
    eps: float
    anti_aliasing: bool
    two_sided: bool
    perspective: bool
    gradient: str

    @classmethod
    def checked(
        cls,
        size: int | tuple[int, int],
        near: float,
        far: float,
        eps: float,
        anti_aliasing: bool,
        two_sided: bool,
        perspective: bool,
        gradient: str,
        name: str = "image_size",
    ) -> Settings:
        """TypeError or ValueError for what does not fit; ``name`` is what ``size`` is called there."""
        height, width = image_size(name, size)
        two_sided, anti_aliasing = validate.flag("two_sided", two_sided), validate.flag("anti_aliasing", anti_aliasing)
        if not isinstance(gradient, str) or gradient not in GRADIENTS:
            raise ValueError(f"gradient: expected one of {', '.join(GRADIENTS)}, got {gradient!r}")
        near, far, eps = (validate.number(n, v) for n, v in (("near", near), ("far", far), ("eps", eps)))
        if not 0 <= near < far <= FARTHEST:
            raise ValueError(f"near, far: expected 0 <= near < far <= {FARTHEST:g}, got near {near}, far {far}")
        if not 0 <= eps < 1:
            raise ValueError(f"eps: expected 0 <= eps < 1, got {eps}")
        return cls(height, width, near, far, eps, anti_aliasing, two_sided, bool(perspective), gradient)

    @property
    def scale(self) -> int:
        """How many pixels are drawn for each pixel returned, along each axis."""
        return 2 if self.anti_aliasing else 1

    def corners(self, faces: Tensor, channels: int) -> Tensor:
        """``faces`` [B, F, 3, 3] in float32, checked: on a device that can draw, where ``channels`` an image fit."""
        validate.floating("faces", faces, ("B", "F", 3, 3))
        validate.finite("faces", faces)
        if faces.device.type not in ("cpu", "cuda", "meta"):
            raise ValueError(f"faces: expected a tensor on the CPU or on CUDA, got device {faces.device}")
        _check_memory(len(faces), self.height * self.scale, self.width * self.scale, channels, faces.device)
        return faces.float()

    def face_index(self, corners: Tensor) -> Tensor:
        """The faces seen, [B, H, W] int32 at the scale drawn; see `coverage`."""
        height, width = self.height * self.scale, self.width * self.scale
        return coverage(corners.detach(), height, width, self.near, self.far, self.two_sided, self.perspective)

    def rings(self, corners: Tensor, triangles: Tensor) -> Tensor | None:
        """The `edge_rings` of ``triangles``, which the corners were gathered by; None if no gradient will need them."""
        needed = self.gradient == "edge" and corners.requires_grad and torch.is_grad_enabled()
        return edge_rings(triangles) if needed else None

    def through_visibility(
        self,
        image: Tensor,
        corners: Tensor,
        face_index: Tensor,
        seams: bool = False,
        binary: bool = False,
        marks: Callable[[], Tensor] | None = None,
        rings: Tensor | None = None,
    ) -> Tensor:
        """The image [B, C, H, W] unchanged, with the gradient to the corners of `nmr_edges` or `boundaries`.

        marks: gives those of `boundaries`, if they are needed. rings: as `rings` gives them.
        """
        if not (corners.requires_grad and torch.is_grad_enabled()):
            return image
        if self.gradient == "edge":
            own = marks() if marks is not None and seams else None
            return boundaries(image, corners, face_index, self.two_sided, self.perspective, seams, own, rings)
        if not self.perspective:  # depth has no part in it: a corner behind an orthographic camera is like any other
            corners = torch.cat((corners[..., :2], torch.ones_like(corners[..., 2:])), -1)
        return nmr_edges(image, corners, face_index, self.eps, self.two_sided, binary)


def image_size(name: str, size: Any) -> tuple[int, int]:
    """(height, width) of a size given as one side or as a pair; TypeError or ValueError for anything else."""
    pair = size if isinstance(size, (tuple, list)) else (size, size)
    if len(pair) != 2:
        raise ValueError(f"{name}: expected a side or (height, width), got {size!r}")
    sides = []
    for side in pair:
        if isinstance(side, bool) or int(validate.number(name, side)) != side:
            raise TypeError(f"{name}: expected whole numbers of pixels, got {size!r}")
        if not 1 <= side <= 32768:
            raise ValueError(f"{name}: expected between 1 and 32768 pixels, got {size!r}")
        sides.append(int(side))
    return sides[0], sides[1]


def _check_memory(batch: int, height: int, width: int, channels: int, device: torch.device) -> None:
    # The key, index, weights and depth, and four copies of the image on the way back.
    each = 28 + 16 * channels
    need = batch * height * width * each
    if need < 1 << 30:
        return
    have = torch.cuda.get_device_properties(device).total_memory if device.type == "cuda" else _machine_memory()
    if have is not None and need > have:
        raise ValueError(
            f"image_size: expected images that fit into the {have / 2**30:.1f} GiB of {device}, got {batch} of "
            f"{height} x {width} drawn pixels, which take {need / 2**30:.1f} GiB; {have // each // 10**6} million "
            "drawn pixels fit in one call"
        )


def _machine_memory() -> int | None:
    """Bytes that this process may use: the machine's, or fewer where a container has a limit; None if nobody tells."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")] if hasattr(os, "sysconf") else []
    try:
        groups = [line.split(":", 2) for line in _CGROUPS.read_text().splitlines()]
    except OSError:
        groups = []
    for _, controllers, path in groups:  # of version 2, without controllers, or of version 1
        if controllers in ("", "memory"):
            root, name = _LIMITS[controllers]
            own = root / path.lstrip("/")
            for folder in (own, *own.parents):
                with suppress(OSError, ValueError):  # "max" is no limit
                    limits.append(int((folder / name).read_text()))
                if folder == root:
                    break
    return min(limits, default=None)
