"""The range of depths that is drawn: what lies behind everything, and a warning about what is cut away."""

from __future__ import annotations

import sys
import warnings
from functools import partial
from types import FrameType
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..base import validate
from ..base.recording import recorded
from ..io.files import warn
from .ops.project_corners import LEAST_DEPTH
from .warp.elementwise import are_for_numpy

FAR = 100.0
"""Depth of the background where no far plane is given and the mesh does not reach so far."""
_BEHIND = 1.05  # depth of the background relative to the farthest corner, if the mesh reaches farther than FAR
_FARTHEST_DRAWN = 1e12  # faces with a corner beyond it are not drawn

_warned: set[tuple[str, int, float | None, float | None]] = set()


def background_depth(corners: Tensor) -> Tensor:
    """Return the depth of the background of each image without a far plane, [B], from corners [B, F, 3, 3].

    It is `FAR`, or 1.05 times the depth of the farthest corner if that is more than `FAR`.
    """
    if not corners.shape[1]:
        return corners.new_full(corners.shape[:1], FAR)
    depth = corners.detach()[..., 2].flatten(1)
    if are_for_numpy(depth):  # without torch's threads
        drawn = depth.numpy()
        farthest = drawn.max(1)
        if not (farthest <= _FARTHEST_DRAWN).all():
            farthest = drawn.max(1, initial=0.0, where=drawn <= _FARTHEST_DRAWN)
        farthest = torch.from_numpy(farthest)
    else:
        farthest = torch.where(depth <= _FARTHEST_DRAWN, depth, 0.0).amax(1)
    return torch.where(farthest <= FAR, FAR, _BEHIND * farthest)


@recorded
def tell_what_is_cut(corners: Tensor, near: float | None, far: float | None) -> None:
    """Warn if given planes cut a part of the mesh away, or if all of it is behind every camera, too near or too far.

    Corners [B, F, 3, 3] are those on the screen; None stands for a plane that is not given. Each line of a program
    that calls a function `checked_together` gets one warning for the same planes; calls from inside this package get
    none. On CUDA the test is judged with the checks of values, and it is left out with them.
    """
    if not validate.values_are_checked(corners) or not corners.numel():
        return
    depth, is_open = corners.detach()[..., 2], near is None and far is None
    if depth.device.type == "cpu":
        if is_open and LEAST_DEPTH < float(depth.numpy()[0, 0, 0]) <= _FARTHEST_DRAWN:
            return  # a part is in front of a camera, and all of that is drawn
        low, high = float(depth.numpy().min()), float(depth.numpy().max())
        if low > (near or 0.0) and (far is None or high < far) and high > LEAST_DEPTH and low <= _FARTHEST_DRAWN:
            return

    caller = _caller()
    if caller is None:
        return
    check = partial(_tell, depth, near, far, caller)
    if is_open:
        late = validate.postponed(depth, depth.amax, check, lambda high: not LEAST_DEPTH < high <= _FARTHEST_DRAWN)
    else:
        late = validate.postponed(depth, lambda: ~_drawable(depth).any() | _cut(depth, near, far).any(), check)
    if not late:
        check()


def tell_what_is_too_far(corners: Tensor, far: float) -> None:
    """Warn if a far plane lies where nothing is drawn, and a corner of [B, F, 3, 3], too."""
    if far <= _FARTHEST_DRAWN or not corners.numel() or not validate.values_are_checked(corners):
        return
    depth = corners.detach()[..., 2]

    def check() -> None:
        farthest = float(depth.amax())
        if farthest > _FARTHEST_DRAWN:
            limit = f"faces with a corner beyond {_FARTHEST_DRAWN:g} are not drawn; choose another unit"
            warn(f"faces: depths reach {farthest:.4g}, but {limit}")

    if not validate.postponed(depth, depth.amax, check, lambda farthest: farthest > _FARTHEST_DRAWN):
        check()


def _drawable(depth: Tensor) -> Tensor:
    return (depth > LEAST_DEPTH) & (depth <= _FARTHEST_DRAWN)


def _cut(depth: Tensor, near: float | None, far: float | None) -> Tensor:
    """Test which corners in front of a camera are outside the near and far planes."""
    outside = depth <= (near or 0.0)
    return (depth > 0) & (outside if far is None else outside | (depth >= far))


class _Line(NamedTuple):
    """A line of a program."""

    file: str
    number: int
    names: dict[str, Any]  # global ones


def _caller() -> _Line | None:
    """Find the call of the function `checked_together` that is at work; None if this package calls it."""
    frame: FrameType | None = sys._getframe(2)
    while frame is not None and frame.f_globals.get("__name__") != validate.__name__:
        frame = frame.f_back
    frame = None if frame is None else frame.f_back
    is_ours = frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == __name__.partition(".")[0]
    return None if is_ours or frame is None else _Line(frame.f_code.co_filename, frame.f_lineno, frame.f_globals)


def _tell(depth: Tensor, near: float | None, far: float | None, caller: _Line) -> None:
    front = depth > 0
    total, cut = int(front.sum()), int(_cut(depth, near, far).sum())
    line = (caller.file, caller.number, near, far)
    is_extreme = bool(total) and not bool(_drawable(depth).any())
    if (total and not cut and not is_extreme) or line in _warned:
        return
    _warned.add(line)
    low, high = (depth[front] if total else depth).aminmax()
    place = f"{float(low):.4g} … {float(high):.4g}"
    if is_extreme:
        message = (
            f"camera: the mesh is at depths {place}, but only depths of {LEAST_DEPTH:g} to {_FARTHEST_DRAWN:g} are "
            "drawn; choose another unit for the mesh and the camera"
        )
    elif total:
        planes = ", ".join(f"{name} {plane:g}" for name, plane in (("near", near), ("far", far)) if plane is not None)
        share = "all of it" if cut == total else f"{100 * cut / total:.2g} % of its corners"
        message = f"near, far: the mesh is at depths {place}, and {planes} cut {share} away"
        message += "; without near and far, render draws all that is in front of the camera"
    else:
        message = f"camera: the whole mesh is behind it, at depths {place}; the images show nothing"
    registry = caller.names.setdefault("__warningregistry__", {})
    warnings.warn_explicit(message, UserWarning, caller.file, caller.number, caller.names.get("__name__"), registry)
