"""The range of depths that is drawn: what lies behind everything, and a warning about what is cut away."""

from __future__ import annotations

import sys
import warnings
from functools import partial

import torch
from torch import Tensor

from .. import validate

FAR = 100.0
"""Depth of the background where no far plane is given and the mesh does not reach so far."""
_BEHIND = 1.05  # depth of the background, in that of the farthest corner, where the mesh reaches farther
_FARTHEST_DRAWN = 1e12  # faces with a corner beyond it are not drawn
_OWN = tuple(f"{__name__.partition('.')[0]}.{name}" for name in ("validate", "raster", "rendering", "deferred"))

_told: set[tuple[str, int, float | None, float | None]] = set()


def background_depth(corners: Tensor) -> Tensor:
    """Return the depth of the background of each image without a far plane, [B], from corners [B, F, 3, 3].

    It is `FAR`, or 1.05 times the depth of the farthest corner if that is more than `FAR`.
    """
    if not corners.shape[1]:
        return corners.new_full(corners.shape[:1], FAR)
    depth = corners.detach()[..., 2]
    farthest = torch.where(depth <= _FARTHEST_DRAWN, depth, 0.0).flatten(1).amax(1)
    return torch.where(farthest <= FAR, FAR, _BEHIND * farthest)


def tell_what_is_cut(corners: Tensor, near: float | None, far: float | None) -> None:
    """Warn if given planes cut a part of the mesh away, or if all of it is behind every camera.

    Corners [B, F, 3, 3] are those on the screen; None stands for a plane that is not given. Each line of a program
    that calls gets one warning for the same planes; calls from inside this package get none. On CUDA the test waits for
    the end of the call, with the checks of values, and it is left out with them.
    """
    if not validate.values_are_checked(corners) or not corners.numel():
        return
    depth = corners.detach()[..., 2]
    on_cpu = depth.device.type == "cpu"
    if near is None and far is None and on_cpu and bool((depth[:, 0, 0] > 0).any()):
        return  # a part is in front of a camera, and all of that is drawn
    test = partial(_cut, depth, near, far)
    check = partial(_tell, depth, near, far)
    if not validate.postponed(depth, lambda: test().any() | ~(depth > 0).any(), check):
        check()


def _cut(depth: Tensor, near: float | None, far: float | None) -> Tensor:
    """Tell which corners in front of a camera are outside of the planes."""
    outside = depth <= (near or 0.0)
    return (depth > 0) & (outside if far is None else outside | (depth >= far))


def _tell(depth: Tensor, near: float | None, far: float | None) -> None:
    front = depth > 0
    total, cut = int(front.sum()), int(_cut(depth, near, far).sum())
    if total and not cut:
        return
    low, high = (depth[front] if total else depth).aminmax()
    place = f"{float(low):.4g} … {float(high):.4g}"
    if not total:
        message = f"camera: the whole mesh is behind it, at depths {place}; the images show nothing"
    else:
        planes = ", ".join(f"{name} {plane:g}" for name, plane in (("near", near), ("far", far)) if plane is not None)
        share = "all of it" if cut == total else f"{100 * cut / total:.2g} % of its corners"
        message = f"near, far: the mesh is at depths {place}, and {planes} cut {share} away"
        message += "; without near and far, render draws all that is in front of the camera"
    frame, level = sys._getframe(), 1
    while frame.f_back and frame.f_globals.get("__name__", "").startswith(_OWN):
        frame, level = frame.f_back, level + 1
    name = frame.f_globals.get("__name__", "")
    line = (frame.f_code.co_filename, frame.f_lineno, near, far)
    if name.partition(".")[0] != __name__.partition(".")[0] and line not in _told:
        _told.add(line)
        warnings.warn(message, stacklevel=level)
