"""Settings of a drawing, validated once: image size, depth range, sides, projection and gradient estimator."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..base import validate
from .colors.downsample import averaged
from .ops.coverage import coverage
from .ops.half_edges import HalfEdges, find_half_edges
from .visibility.estimators import DrawnFaces, Estimator, estimator
from .warp.elsewhere import check_devices
from .warp.registration import P, R, needs_gradient

_CGROUPS = Path("/proc/self/cgroup")
_LIMITS = {
    "": (Path("/sys/fs/cgroup"), "memory.max"),
    "memory": (Path("/sys/fs/cgroup/memory"), "memory.limit_in_bytes"),
}
FARTHEST = 1e30  # largest depth; the gradient of a jump to it at outlines is finite in float32


def _kept(function: Callable[P, R]) -> Callable[P, R]:
    """Cache the results for plain values; others may not be hashable, or equal values of another type."""
    cached = lru_cache(maxsize=64, typed=True)(function)

    @wraps(function)
    def call(*options: P.args, **named: P.kwargs) -> R:
        sides, others = options[0], options[1:]
        plain = {*map(type, sides if isinstance(sides, tuple) else (sides,))} == {int}
        plain = plain and {*map(type, others)} <= {int, float, bool, str, type(None)} and not named
        if plain and not torch.compiler.is_compiling():  # torch.compile warns of caches
            return cached(*options)
        return function(*options, **named)

    return call


@dataclass(frozen=True)
class Settings:
    """Options of a drawing."""

    height: int  # pixels of the returned image
    width: int
    near: float  # least visible depth in world units, >= 0
    far: float  # greatest visible depth in world units; also the depth of the background, unless it is open
    eps: float  # added to distances in the denominators of "nmr", in screen units; cube coordinates end at T - 1 - eps
    anti_aliasing: bool  # faces are drawn at twice the size and averaged over 2 x 2 pixels
    two_sided: bool  # faces whose corners run clockwise on the screen are drawn, too
    perspective: bool  # else orthographic
    gradient: Estimator  # estimator of the gradient through visibility
    below: int = 0  # rows of the whole image below, if these settings are for a strip of it (`strip`)
    above: int = 0  # rows above
    is_open: bool = False  # no far plane is given: the depth of the background is that of `background_depth`

    @staticmethod
    @_kept
    def checked(
        size: int | tuple[int, int],
        near: float | None,
        far: float | None,
        eps: float,
        anti_aliasing: bool,
        two_sided: bool,
        perspective: bool,
        gradient: str | Estimator,
    ) -> Settings:
        """Validate arguments; raise TypeError or ValueError. See `image_size` and `estimator`.

        Without ``near`` or ``far``, nothing in front of the camera is too near or too far.
        """
        height, width = image_size("size", size)
        two_sided, anti_aliasing = validate.flag("two_sided", two_sided), validate.flag("anti_aliasing", anti_aliasing)
        through = estimator(gradient)
        is_open, given = far is None, {"near": 0.0 if near is None else near, "far": FARTHEST if far is None else far}
        near, far, eps = (validate.number(name, value) for name, value in {**given, "eps": eps}.items())
        if not 0 <= near < far <= FARTHEST:
            raise ValueError(f"near, far: expected 0 <= near < far <= {FARTHEST:g}, got near {near}, far {far}")
        if not 0 <= eps < 1:
            raise ValueError(f"eps: expected 0 <= eps < 1, got {eps}")
        options = (anti_aliasing, two_sided, bool(perspective), through)
        return Settings(height, width, near, far, eps, *options, is_open=is_open)

    @property
    def scale(self) -> int:
        """Drawn pixels for each returned pixel, along each axis."""
        return 2 if self.anti_aliasing else 1

    @property
    def drawn_strip(self) -> tuple[int, int]:
        """Drawn rows below and above the strip."""
        return self.below * self.scale, self.above * self.scale

    def strip(self, first: int, last: int) -> Settings:
        """Make the settings of the rows [first, last) of a whole image, counted from its top."""
        return replace(self, height=last - first, above=first, below=self.height - last)

    def corners(self, faces: Tensor, channels: int) -> Tensor:
        """Validate screen-space corners [B, F, 3, 3] floating, and convert them to float32; differentiable.

        Raises TypeError for another dtype, and ValueError for another shape, a device that `fall_back_to_cpu` forbids,
        NaN and infinity, or images of so many channels that they are larger than the memory.
        """
        validate.floating("faces", faces, ("B", "F", 3, 3))
        validate.finite("faces", faces)
        check_devices([faces], "faces")
        _check_memory(len(faces), self.height * self.scale, self.width * self.scale, channels, faces.device)
        return faces.float()

    def face_index(self, corners: Tensor) -> Tensor:
        """Find the visible face of each drawn pixel, [B, H, W] int32; see `coverage`."""
        height, width = self.height * self.scale, self.width * self.scale
        marked = needs_gradient(corners) and self.gradient.needs_mask(corners.device)
        options = (self.near, self.far, self.two_sided, self.perspective, marked, *self.drawn_strip)
        return coverage(corners.detach(), height, width, *options)

    def half_edges(self, corners: Tensor, triangles: Tensor) -> HalfEdges | None:
        """Find the half-edges of the faces with these vertex indices; None if no gradient needs them."""
        needed = self.gradient.needs_half_edges and needs_gradient(corners)
        return find_half_edges(triangles) if needed else None

    def through_visibility(
        self,
        image: Tensor | None,
        corners: Tensor,
        face_index: Tensor,
        seams: bool = False,
        edge_hashes: Callable[[], Tensor] | None = None,
        half_edges: HalfEdges | None = None,
        corner_values: Tensor | None = None,
    ) -> Tensor:
        """Average an image for anti-aliasing to [B, C, height, width] float32; attach the gradient through visibility.

        The image [B, C, H, W] float32, with its background, is that before anti-aliasing; None stands for the
        silhouette. Corners, face_index and half_edges are as in `VisibleFaces`; ``seams`` and the hashes, which are
        computed only if they are needed, and ``corner_values`` as in `edge_gradient`.
        """
        if not needs_gradient(corners):
            if image is not None and not self.anti_aliasing:
                return image
            return averaged(image, face_index, self.anti_aliasing)
        drawn = self.drawn(corners, face_index, half_edges, corner_values)
        return self.gradient.attach(image, drawn, seams, edge_hashes)

    def drawn(
        self, corners: Tensor, face_index: Tensor, half_edges: HalfEdges | None, corner_values: Tensor | None = None
    ) -> DrawnFaces:
        """Collect the data for an estimator; arguments as for `through_visibility`."""
        options = (self.eps, self.two_sided, self.perspective, self.anti_aliasing, self.drawn_strip)
        return DrawnFaces(corners, face_index, half_edges, *options, corner_values)


def image_size(name: str, size: Any) -> tuple[int, int]:
    """Validate an image size, a side or (height, width) of 1 to 32768 pixels, as (height, width).

    Raises TypeError or ValueError with the name of the argument.
    """
    pair = size if isinstance(size, (tuple, list)) else (size, size)
    if [type(side) for side in pair] == [int, int] and 1 <= min(pair) <= max(pair) <= 32768:
        return pair[0], pair[1]
    several_sizes = any(isinstance(side, (tuple, list)) for side in pair)
    if len(pair) != 2 or several_sizes:
        several = "; images of different sizes are drawn by a call each" if several_sizes else ""
        raise ValueError(f"{name}: expected a side or (height, width), got {size!r}{several}")
    sides = []
    for side in pair:
        if isinstance(side, bool) or not float(validate.number(name, side)).is_integer():
            raise TypeError(f"{name}: expected whole numbers of pixels, got {size!r}")
        if not 1 <= side <= 32768:
            raise ValueError(f"{name}: expected between 1 and 32768 pixels, got {size!r}")
        sides.append(int(side))
    return sides[0], sides[1]


def _check_memory(batch: int, height: int, width: int, channels: int, device: torch.device) -> None:
    # The key, index, weights and depth, and four copies of the image in the backward pass.
    each = 28 + 16 * channels
    need = batch * height * width * each
    if need < 1 << 30:
        return
    have = torch.cuda.get_device_properties(device).total_memory if device.type == "cuda" else _machine_memory()
    if have is not None and need > have:
        raise ValueError(
            f"size: expected images that fit into the {have / 2**30:.1f} GiB of {device}, got {batch} of "
            f"{height} x {width} drawn pixels, which take {need / 2**30:.1f} GiB; {have // each // 10**6} million "
            "drawn pixels fit in one call; `render` draws larger images strip by strip with tile=2048"
        )


def _machine_memory() -> int | None:
    """Return the bytes that this process may use: the machine's, or a container's limit; None if unknown."""
    limits = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")] if hasattr(os, "sysconf") else []
    try:
        groups = [line.split(":", 2) for line in _CGROUPS.read_text().splitlines()]
    except OSError:
        groups = []
    for _, controllers, path in groups:  # cgroups: version 2 names no controllers
        if controllers in ("", "memory"):
            root, name = _LIMITS[controllers]
            group = root / path.lstrip("/")
            for folder in (group, *group.parents):
                with suppress(OSError, ValueError):  # "max" is no limit
                    limits.append(int((folder / name).read_text()))
                if folder == root:
                    break
    return min(limits, default=None)
