"""Several meshes as a batch, one for each image, or joined into one scene."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, overload

import torch
from torch import Tensor, nn

from ..base import validate
from ..io.files import as_tensor
from ..io.trimesh_meshes import is_trimesh
from ..raster.cube_colors import PackedCubes
from .mesh import Mesh
from .normals import vertex_normals
from .uv_mesh import UVMesh


def pad(tensors: Sequence[Tensor], value: float = 0) -> Tensor:
    """Stack tensors [N_b, ...] that differ in N only into [B, max N, ...], padded with ``value`` at the end."""
    longest = max(len(tensor) for tensor in tensors)
    spaces = ([0, 0] * (tensor.dim() - 1) + [0, longest - len(tensor)] for tensor in tensors)
    return torch.stack([nn.functional.pad(t, space, value=value) for t, space in zip(tensors, spaces, strict=True)])


@overload
def batch(meshes: Sequence[Mesh]) -> tuple[Tensor, Tensor, Tensor]: ...
@overload
def batch(meshes: Sequence[UVMesh]) -> UVMesh: ...
def batch(meshes: Sequence[Any]) -> tuple[Tensor, Tensor, Tensor] | UVMesh:
    """Pad meshes of different sizes to one batch. `render` and `fragments` do this with a list of meshes.

    Args:
        meshes: B meshes on one device: `Mesh` with one texture size, or `UVMesh`.

    Returns:
        For `Mesh`: vertices [B, V, 3], padded with 0; faces [B, F, 3], padded with (−1, −1, −1); textures
        [B, F, T, T, T, 3]. For `UVMesh`: a `UVMesh` with padded vertices, faces and attributes of faces, and the images
        and materials of all. Gradients reach the tensors of each mesh.

    Raises:
        TypeError, ValueError: An item is not a mesh, both kinds are mixed, or devices or texture sizes differ.

    Example:
        >>> vertices, faces, textures = batch([nr.Mesh.icosphere(1), nr.Mesh.icosphere(2)])
        >>> faces.shape
        torch.Size([2, 320, 3])
    """
    if _are_uv_meshes(meshes):
        parts, shared = _merged_attributes(meshes)
        padded = {name: pad(values, -1 if name.endswith("index") else 0) for name, values in parts.items()}
        vertices, faces = _padded_shapes(meshes)
        return replace(meshes[0], vertices=vertices, faces=faces, **(padded | shared))
    return (*_padded_shapes(meshes), pad(_cubes_of_one_size(meshes)))


def packed(meshes: Sequence[Any]) -> tuple[Tensor, Tensor, PackedCubes] | UVMesh:
    """Batch meshes like `batch`, but with packed colours, because padding takes memory.

    Colours are those of `Mesh.colors_of_faces` if all have the same shape; otherwise they are baked into cubes.
    """
    if _are_uv_meshes(meshes):
        return batch(meshes)
    colors = [mesh.colors_of_faces() for mesh in meshes]
    if len({part.shape[1:] for part in colors}) > 1:
        colors = _cubes_of_one_size(meshes)
    firsts = list(itertools.accumulate(map(len, colors), initial=0))
    offsets = torch.tensor(firsts, dtype=torch.int32, device=colors[0].device)
    return (*_padded_shapes(meshes), PackedCubes(torch.cat(colors), offsets))


def _padded_shapes(meshes: Sequence[Any]) -> tuple[Tensor, Tensor]:
    return pad([mesh.vertices for mesh in meshes]), pad([mesh.faces for mesh in meshes], -1)


def _cubes_of_one_size(meshes: Sequence[Mesh]) -> list[Tensor]:
    sizes = sorted({mesh.texture_size for mesh in meshes})
    if len(sizes) > 1:
        raise ValueError(f"meshes: expected textures of one size, got {' and '.join(map(str, sizes))}")
    return [mesh.cubes() for mesh in meshes]


@overload
def join(meshes: Sequence[Mesh]) -> tuple[Tensor, Tensor, Tensor]: ...
@overload
def join(meshes: Sequence[UVMesh]) -> UVMesh: ...
def join(meshes: Sequence[Any]) -> tuple[Tensor, Tensor, Tensor] | UVMesh:
    """Join several meshes into one scene.

    Args:
        meshes: Meshes on one device: `Mesh` with one texture size, or `UVMesh`.

    Returns:
        For `Mesh`: vertices [V, 3], faces [F, 3] and textures [F, T, T, T, 3] for `render` or
        ``Mesh(*join(meshes))``. For `UVMesh`: a `UVMesh` with the images and materials of all; if only some have
        normals, the others get `vertex_normals`. Gradients reach the tensors of each mesh.

    Raises:
        TypeError, ValueError: An item is not a mesh, both kinds are mixed, or devices or texture sizes differ.

    Example:
        >>> vertices, faces, textures = join([nr.Mesh.icosphere(1), nr.Mesh.icosphere(2)])
        >>> faces.shape
        torch.Size([400, 3])
    """
    is_uv = _are_uv_meshes(meshes)
    firsts = itertools.accumulate((len(mesh.vertices) for mesh in meshes[:-1]), initial=0)
    faces = torch.cat([mesh.faces + first for mesh, first in zip(meshes, firsts, strict=True)])
    vertices = torch.cat([mesh.vertices for mesh in meshes])
    if not is_uv:
        return vertices, faces, torch.cat(_cubes_of_one_size(meshes))
    parts, shared = _merged_attributes(meshes)
    joined = {name: torch.cat(values) for name, values in parts.items()}
    return replace(meshes[0], vertices=vertices, faces=faces, **(joined | shared))


def as_mesh(mesh: Any) -> Any:
    """Convert a mesh or scene of trimesh to a `UVMesh`, and a list of meshes to a batch; return other values."""
    if isinstance(mesh, list):
        return packed([as_mesh(one) for one in mesh])
    if isinstance(mesh, (Mesh, UVMesh, tuple)):  # torch.compile must not trace trimesh's classes
        return mesh
    return UVMesh.from_trimesh(mesh) if is_trimesh(mesh) else mesh


def mesh_parts(mesh: Any) -> tuple[Tensor, Tensor, Tensor | PackedCubes | None]:
    """Return (vertices, faces, colours or None) of a `Mesh`, a list of meshes, or a tuple; raise TypeError otherwise.

    Colours are those of a tuple, or `Mesh.colors_of_faces`.
    """
    if isinstance(mesh, Mesh):
        return mesh.vertices, mesh.faces, mesh.colors_of_faces()
    mesh = as_mesh(mesh)
    if isinstance(mesh, tuple) and not isinstance(mesh[0], Mesh):
        mesh = tuple(map(_floats, mesh))
    if isinstance(getattr(mesh, "vertices", None), Tensor) and isinstance(getattr(mesh, "faces", None), Tensor):
        return mesh.vertices, mesh.faces, None
    if isinstance(mesh, tuple) and len(mesh) in (2, 3):
        return mesh[0], mesh[1], mesh[2] if len(mesh) == 3 else None
    raise TypeError(
        f"mesh: expected a Mesh, a list of them, a UVMesh, a Trimesh, (vertices, faces) or (vertices, faces, "
        f"textures), got {type(mesh).__name__}"
    )


def kind_of_colors(mesh: Any) -> str:
    """Return the name of the attribute that has the colours of a `Mesh`; "textures" for other meshes."""
    named = (name for name in ("vertex_colors", "face_colors") if getattr(mesh, name, None) is not None)
    return next(named, "textures")


def _floats(value: Any) -> Any:
    """Convert an array or lists to a tensor, floats to float32; return other values unchanged."""
    if isinstance(value, (Tensor, PackedCubes)):
        return value
    value = as_tensor(value)
    return value.float() if getattr(value, "dtype", None) == torch.float64 else value


def _are_uv_meshes(meshes: Any) -> bool:
    """Return whether a list holds `UVMesh`; raise TypeError or ValueError unless its meshes have one type."""
    if not isinstance(meshes, (list, tuple)) or not all(isinstance(mesh, (Mesh, UVMesh)) for mesh in meshes):
        kinds = [type(mesh).__name__ for mesh in meshes] if isinstance(meshes, (list, tuple)) else type(meshes).__name__
        raise TypeError(f"meshes: expected a list of Mesh, or of UVMesh, got {kinds}")
    if not meshes:
        raise ValueError("meshes: expected at least one Mesh, got an empty list")
    validate.same_device(**{f"meshes[{i}]": mesh.vertices for i, mesh in enumerate(meshes)})
    if len({isinstance(mesh, UVMesh) for mesh in meshes}) > 1:
        raise TypeError(
            "meshes: expected all of one kind, got Mesh and UVMesh; Mesh.load, or UVMesh.load, reads all files"
        )
    if not isinstance(meshes[0], UVMesh):
        return False
    for i, mesh in enumerate(meshes):
        if mesh.faces.dim() != 2 or mesh.vertices.dim() != 2:
            raise ValueError(f"meshes[{i}]: expected one mesh, got a batch")
    return True


def _merged_attributes(meshes: Sequence[UVMesh]) -> tuple[dict[str, list[Tensor]], dict[str, Any]]:
    """Merge the images and materials of several meshes. A shared image with the same wrapping appears once.

    Returns attributes of faces, a list of one tensor for each mesh; and the shared images, wraps and materials.
    """
    pictures: dict[tuple[int, Any], tuple[Tensor, Any]] = {}
    materials: dict[int, Any] = {}
    shared: dict[str, Any] = {}
    parts: dict[str, list[Tensor]] = {"uv": [], "image_index": [], "colors": [], "material_index": []}
    for mesh in meshes:
        pairs = list(zip(mesh.images, mesh.wraps, strict=True))
        keys = [(id(image), wrap) for image, wrap in pairs]
        pictures.update(zip(keys, pairs, strict=True))
        materials.update((id(one), one) for one in mesh.materials)
        index = mesh.material_index
        if index is None:  # all faces have the only material, or none
            index = torch.full_like(mesh.image_index, 0 if mesh.materials else -1)
        parts["uv"].append(mesh.uv)
        parts["colors"].append(mesh.colors)
        parts["image_index"].append(_renumbered(mesh.image_index, keys, pictures))
        parts["material_index"].append(_renumbered(index, [id(one) for one in mesh.materials], materials))
    if not materials:
        shared["material_index"] = None
        del parts["material_index"]
    for name in ("normals", "tangents", "uv1", "tints"):
        given = [getattr(mesh, name) is not None for mesh in meshes]
        # Keep tangents if all meshes have them; otherwise shading computes them.
        if any(given) if name != "tangents" else all(given):
            attributes = [_corner_attribute(name, mesh) for mesh in meshes]
            width = max(value.shape[-1] for value in attributes)
            parts[name] = [
                nn.functional.pad(value, (0, width - value.shape[-1])) for value in attributes
            ]  # sets of ``uv1``
        else:
            shared[name] = None
    images, wraps = zip(*pictures.values(), strict=True) if pictures else ((), ())
    return parts, shared | {"images": images, "wraps": wraps, "materials": tuple(materials.values())}


def _renumbered(index: Tensor, keys: list[Any], merged: dict[Any, Any]) -> Tensor:
    """Replace each index into ``keys`` by the position of its key in ``merged``; keep −1."""
    order = {key: number for number, key in enumerate(merged)}
    return torch.tensor([*(order[key] for key in keys), -1], device=index.device)[index.long()]


def _corner_attribute(name: str, mesh: UVMesh) -> Tensor:
    """Get an attribute of corners; make one that changes nothing if the mesh has none."""
    value: Tensor | None = getattr(mesh, name)
    if value is not None:
        return value
    if name == "normals":
        return vertex_normals(mesh.vertices, mesh.faces)[0][mesh.faces.long()]
    return mesh.uv.new_ones(*mesh.uv.shape[:-1], 4) if name == "tints" else torch.zeros_like(mesh.uv)
