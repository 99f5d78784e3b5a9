"""Images of small scenes by recordings of earlier calls, which saves most of their time; see `raster.warp.replay`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from typing import Any

from torch import Tensor, nn

from ..base import private, validate
from ..raster.outputs import OUTPUTS, SURFACE, Images
from ..raster.warp.registration import is_plain
from ..raster.warp.replay import replay

_MOST = 1 << 15  # numbers of a constant tensor on the CPU, which each call compares
_PATIENCE = 16  # after so many calls in a row without a recording, only one in as many compares its constants
_plain: set[type] = {int, float, bool, str, type(None)}
_ours: set[type] = set()  # dataclasses of this package
_missed = 0  # calls in a row without a recording, as with a new camera in each; other threads may disturb the count


def replayed(draw: Callable[..., Images], mesh: Any, camera: Any, *options: Any) -> Images | None:
    """Return ``draw(mesh, camera, *options)``, of the arguments of `render`, by a recording; None without one.

    Vertices and colours of a mesh may change, and what else there is must be equal to the bit.
    """
    if type(mesh) is not tuple or not {*map(type, mesh)} <= {Tensor, nn.Parameter}:
        return None
    if not is_plain(mesh) or private.may_have_tangents():
        return None
    global _missed
    _missed += 1
    if _missed > _PATIENCE and _missed % _PATIENCE:
        return None
    vertices, faces, *colors = mesh
    try:
        key = _key((faces, camera, *options, validate.values_are_checked(vertices)))
    except TypeError:
        return None

    def function(vertices: Tensor, *colors: Tensor) -> tuple[Tensor, ...]:
        return tuple(vars(draw((vertices, faces, *colors), camera, *options)).values())

    found = replay(function, (vertices, *colors), key)
    if found is None:
        return None
    _missed = 0
    return Images(**dict(zip([name for name in OUTPUTS + SURFACE if name in options[4]], found, strict=True)))


def _key(values: Iterable[Any]) -> tuple[Any, ...]:
    """Describe constants by their values, and tensors on a GPU by their counters of changes.

    Raises TypeError for a tensor that requires a gradient or is too large, and for objects of other packages.
    """
    found: list[Any] = []
    for value in values:
        kind = type(value)
        if kind in _plain:
            found.append(value)
        elif kind is tuple or kind is list:
            found.append(_key(value))
        elif kind is Tensor:
            on_cpu, version = value.is_cpu, private.version_of(value)
            if value.requires_grad or value.is_neg() or version is None or (on_cpu and value.numel() > _MOST):
                raise TypeError
            found += value.shape, value.dtype, value.device, value.numpy().tobytes() if on_cpu else (id(value), version)
        elif kind in _ours or (is_dataclass(value) and __name__.partition(".")[0] == kind.__module__.partition(".")[0]):
            _ours.add(kind)
            found += kind, _key(vars(value).values())
        else:
            raise TypeError
    return tuple(found)
