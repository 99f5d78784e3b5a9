"""`Snapshot`: a copy of a mesh on the CPU, taken in the thread that changes the mesh."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from ....base import private, validate
from ....meshes.mesh import Mesh
from ....meshes.uv_mesh import UVMesh

_Value = TypeVar("_Value")


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Copy of a mesh, on the CPU."""

    vertices: Tensor  # [V, 3] float32
    faces: Tensor  # [F, 3] int32
    textures: Tensor | None = None  # [F, T, T, T, 3] float32
    uv_mesh: UVMesh | None = None  # the mesh with its images

    def finite(self) -> tuple[Snapshot, int]:
        """Leave out faces with a vertex that is not finite, as after an optimisation diverged; count them, too.

        Unusable vertices are at the origin.
        """
        finite = np.isfinite(self.vertices.numpy())
        if finite.all():
            return self, 0
        good = torch.from_numpy(finite.all(1))
        vertices = torch.where(good[:, None], self.vertices, 0.0)
        kept = good[self.faces.long()].all(1)
        textures = None if self.textures is None else self.textures[kept]
        uv_mesh = self.uv_mesh
        if uv_mesh is not None:
            names = ("uv", "image_index", "colors", "material_index", "normals", "tangents", "uv1", "tints")
            values = {name: getattr(uv_mesh, name) for name in names}
            of_kept: dict[str, Any] = {name: value[kept] for name, value in values.items() if value is not None}
            uv_mesh = replace(uv_mesh, vertices=vertices, faces=self.faces[kept], **of_kept)
        return Snapshot(vertices, self.faces[kept], textures, uv_mesh), int((~kept).sum())

    def scaled(self, factor: float) -> Snapshot:
        """Return the mesh at another size."""
        vertices = self.vertices * factor
        uv_mesh = None if self.uv_mesh is None else replace(self.uv_mesh, vertices=vertices)
        return Snapshot(vertices, self.faces, self.textures, uv_mesh)

    def shape(self) -> UVMesh | tuple[Tensor, ...]:
        """Return the mesh in a form that `render` takes; without colours it is white."""
        if self.uv_mesh is not None:
            return self.uv_mesh
        textures = torch.ones(len(self.faces), 1, 1, 1, 3) if self.textures is None else self.textures
        return self.vertices, self.faces, textures

    def moved(self, vertices: Tensor) -> UVMesh | tuple[Tensor, ...]:
        """Return the mesh as `shape`, with other vertices."""
        shape = self.shape()
        return replace(shape, vertices=vertices) if isinstance(shape, UVMesh) else (vertices, *shape[1:])

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the least and greatest coordinates of the faces' vertices, [3] each; 0 without faces."""
        used = self.vertices.numpy()[self.faces.numpy().reshape(-1)]
        if not len(used):
            return np.zeros(3), np.zeros(3)
        return used.min(0).astype(float), used.max(0).astype(float)


def take_snapshot(mesh: Any) -> Snapshot:
    """Copy one mesh: a `Mesh`, a `UVMesh`, or (vertices, faces) or (vertices, faces, textures) as in `render`.

    TypeError, ValueError: It is none of these, or its tensors do not fit together.
    """
    if isinstance(mesh, Snapshot):
        return mesh
    if isinstance(mesh, UVMesh):
        names = ("vertices", "faces", "uv", "image_index", "colors", "tints", "material_index")
        copied: dict[str, Any] = {name: _copy(value) for name in names if (value := getattr(mesh, name)) is not None}
        copy = replace(mesh, **copied, images=tuple(_copy(image) for image in mesh.images))
        return Snapshot(*_checked(copy.vertices, copy.faces), None, copy)
    vertices, faces, textures = _parts(mesh)
    vertices, faces = _checked(_copy(vertices), _copy(faces))
    return Snapshot(vertices, faces, None if textures is None else _copy(textures).float())


def check_mesh(mesh: Any) -> None:
    """Raise what `take_snapshot` raises, without a copy: from types and shapes, not from values."""
    if not isinstance(mesh, (Snapshot, UVMesh)):
        _parts(mesh)


def _parts(mesh: Any) -> tuple[Tensor, Tensor, Tensor | None]:
    """Return vertices, faces and textures of one mesh; check their types and shapes."""
    if isinstance(mesh, Mesh):
        mesh = mesh.vertices, mesh.faces, mesh.cubes()
    if not isinstance(mesh, (tuple, list)) or len(mesh) not in (2, 3):
        raise TypeError(
            f"mesh: expected a Mesh, a UVMesh, (vertices, faces) or (vertices, faces, textures), got "
            f"{type(mesh).__name__}"
        )
    vertices = validate.floating("vertices", _single(mesh[0]), ("V", 3))
    faces = validate.indices("faces", _single(mesh[1]), ("F", 3))
    if len(mesh) == 2 or mesh[2] is None:
        return vertices, faces, None
    return vertices, faces, validate.cubes("textures", _single(mesh[2], 5), len(faces))


def _checked(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Check indices; vertices may be infinite or NaN in an optimisation that diverges."""
    faces = validate.indices("faces", faces, ("F", 3), always=True).int()
    numbers = faces.numpy()  # torch would start threads, which cost more than they save
    if numbers.size and not 0 <= numbers.min() <= numbers.max() < len(vertices):
        raise ValueError(
            f"faces: expected vertex indices from 0 to {len(vertices) - 1}, got {numbers.min()} to {numbers.max()}"
        )
    return vertices.float(), faces


def _single(value: Any, dimensions: int = 2) -> Tensor:
    """Return the only mesh of a batch of one, as a tensor."""
    if isinstance(value, np.ndarray):
        value = torch.from_numpy(value)
    if not isinstance(value, Tensor):
        raise TypeError(f"mesh: expected tensors or arrays, got {type(value).__name__}")
    return value[0] if value.ndim == dimensions + 1 and len(value) == 1 else value


def _copy(value: Tensor) -> Tensor:
    """Copy a tensor to the CPU, without its gradient; an unchanged tensor is copied once."""
    return _COPIES.get(value, _copied)


def _copied(value: Tensor) -> Tensor:
    """Copy a tensor to the CPU; 64-bit indices become 32-bit ones."""
    dtype = torch.int32 if value.dtype == torch.int64 and value.ndim == 2 else value.dtype
    return value.detach().to("cpu", dtype, copy=True)


def _is_same(value: Tensor, copy: Tensor) -> bool:
    """Return whether a tensor still has the bits of its copy."""
    now = value.detach().to("cpu", copy.dtype)
    return now.shape == copy.shape and np.array_equal(_bits(now), _bits(copy))


def _bits(value: Tensor) -> np.ndarray:
    """Return the bits of a tensor, in words that numpy compares fast."""
    data = value.contiguous().reshape(-1).view(torch.uint8).numpy()
    return data.view(np.uint64) if data.size % 8 == 0 else data


class Memo(Generic[_Value]):
    """Cache of results for tensors that are alive and not changed in place. Thread-safe.

    torch counts changes of a tensor, but neither those by ``tensor.data`` nor those by an array of numpy that shares
    its memory. ``holds`` can find these: it tests whether a result still belongs to a tensor without a counted change.
    """

    def __init__(self, holds: Callable[[Tensor, _Value], bool] | None = None) -> None:
        self._holds = holds
        self._found = WeakTensorKeyDictionary()
        self._lock = threading.Lock()

    def get(self, tensor: Tensor, make: Callable[[Tensor], _Value]) -> _Value:
        """Return ``make(tensor)``, or the result of an earlier call."""
        version = private.version_of(tensor)
        if version is None:
            return make(tensor)
        with self._lock:
            known, value = self._found.get(tensor, (None, None))
        if known != version or (self._holds is not None and not self._holds(tensor, value)):
            value = make(tensor)
            with self._lock:
                self._found[tensor] = version, value
        return value


_COPIES: Memo[Tensor] = Memo(holds=_is_same)
