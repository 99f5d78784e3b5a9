"""Images of small scenes by recordings of earlier calls, which saves most of their time; see `raster.warp.replay`."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from functools import partial
from typing import Any

from torch import Tensor, nn, strided

from ..base import private, validate
from ..base.recording import Unrepeatable
from ..meshes.batch import kind_of_colors
from ..meshes.mesh import Mesh
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

    Vertices and colours of a tuple or `Mesh` may change, and what else there is must be equal to the bit.
    """
    parts, kind, outputs = mesh, "", options[4]
    if type(mesh) is Mesh:
        kind = kind_of_colors(mesh)
        parts = (mesh.vertices, mesh.faces, getattr(mesh, kind))
    if type(parts) is not tuple or len(parts) < 2 or not {*map(type, parts)} <= {Tensor, nn.Parameter}:
        return None
    if type(outputs) is tuple and "rgb" not in outputs:
        parts, kind = parts[:2], ""
    if not is_plain(parts) or private.may_have_tangents():
        return None
    global _missed
    _missed += 1
    if _missed > _PATIENCE and _missed % _PATIENCE:
        return None
    vertices, faces, *colors = parts

    constants = (kind, faces, camera, *options)
    key = (*constants, validate.values_are_checked(vertices))
    found = replay(lambda: partial(_drawn, draw, _copied(constants)), (vertices, *colors), lambda: _key(key))
    if found is None:
        return None
    _missed = 0
    return Images(**dict(zip([name for name in OUTPUTS + SURFACE if name in outputs], found, strict=True)))


def _drawn(draw: Callable[..., Images], constants: Any, vertices: Tensor, *colors: Tensor) -> tuple[Tensor, ...]:
    kind, faces, camera, *options = constants
    scene: Any = (vertices, faces, *colors)
    if kind:  # a mesh without the checks of its class, which the caller's has passed
        scene = Mesh.__new__(Mesh)
        vars(scene).update({"vertices": vertices, "faces": faces, "_colored": kind, kind: colors[0]})
    return tuple(vars(draw(scene, camera, *options)).values())


def _copied(value: Any) -> Any:
    """Copy what `_key` describes by its values, because a caller may change its tensors later."""
    if type(value) is Tensor:
        return value.clone() if value.is_cpu else value
    if type(value) in (tuple, list):
        return type(value)(map(_copied, value))
    if type(value) in _ours:
        result = copy.copy(value)
        vars(result).update({name: _copied(part) for name, part in vars(value).items()})
        return result
    return value


def _key(values: Iterable[Any]) -> tuple[Any, ...]:
    """Describe constants by their values, and tensors on a GPU by their counters of changes.

    Raises Unrepeatable for a tensor that requires a gradient or is too large, and for objects of other packages.
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
            unseen = value.is_neg() or value.layout is not strided  # by NumPy
            if value.requires_grad or unseen or version is None or (on_cpu and value.numel() > _MOST):
                raise Unrepeatable
            found += value.shape, value.dtype, value.device, value.numpy().tobytes() if on_cpu else (id(value), version)
        elif kind in _ours or (is_dataclass(value) and __name__.partition(".")[0] == kind.__module__.partition(".")[0]):
            _ours.add(kind)
            found += kind, _key(vars(value).values())
        else:
            raise Unrepeatable
    return tuple(found)
