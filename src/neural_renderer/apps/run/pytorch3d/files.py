"""Files of meshes: OBJ with materials and images, and PLY."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ....io.files import existing
from ....io.formats import read_mesh
from ....io.images import load_image
from ....io.mesh_writer import save_mesh
from ....io.named_files import find_file
from ....io.obj.parse import ObjFile, read_obj
from ....io.obj.reader import obj_materials
from ....meshes.uv_mesh import UVMesh
from .meshes import Meshes, join_meshes_as_batch
from .textures import TexturesUV

_COLORS = {"color": "diffuse_color", "specular": "specular_color"}


class Faces(NamedTuple):
    """Indices of corners; -1 where there is none."""

    verts_idx: Tensor  # [F, 3]
    normals_idx: Tensor  # [F, 3]
    textures_idx: Tensor  # [F, 3]
    materials_idx: Tensor  # [F]


class Properties(NamedTuple):
    """What else an OBJ file has; None for what it has not."""

    normals: Tensor | None
    verts_uvs: Tensor | None
    material_colors: dict[str, dict[str, Tensor]] | None
    texture_images: dict[str, Tensor] | None
    texture_atlas: None = None


def load_obj(
    f: Any, load_textures: bool = True, create_texture_atlas: bool = False, texture_atlas_size: int = 4,
    texture_wrap: str | None = "repeat", device: Any = "cpu", path_manager: Any = None,
) -> tuple[Tensor, Faces, Properties]:  # fmt: skip
    """Read an OBJ file. Texture coordinates and normals are listed once each, in an order of their own."""
    if create_texture_atlas:
        raise NotImplementedError("load_obj(create_texture_atlas=True): not in neural-renderer run")
    obj = read_obj(existing(f), with_uv=True)
    uvs, textures_idx = _listed(obj.uv, device)
    normals, normals_idx = _listed(obj.normals if obj.normals is not None else obj.uv * np.nan, device)
    verts = torch.from_numpy(obj.vertices).float().to(device)
    faces = Faces(
        torch.from_numpy(obj.faces).to(device),
        normals_idx,
        textures_idx,
        torch.from_numpy(np.asarray(obj.material)).long().to(device),
    )
    colors, images = _materials(obj, device) if load_textures else (None, None)
    return verts, faces, Properties(normals, uvs, colors, images)


def load_objs_as_meshes(
    files: Sequence[Any], device: Any = "cpu", load_textures: bool = True, **unknown: Any
) -> Meshes:
    """Read OBJ files as one batch; with the first image of each as `TexturesUV`."""
    if unknown.get("create_texture_atlas"):
        raise NotImplementedError("load_objs_as_meshes(create_texture_atlas=True): not in neural-renderer run")
    meshes = []
    for file in files:
        verts, faces, more = load_obj(file, load_textures, device=device)
        textures = None
        if more.texture_images and more.verts_uvs is not None:
            image = next(iter(more.texture_images.values())).to(device)
            textures = TexturesUV([image], [faces.textures_idx.clamp(min=0)], [more.verts_uvs])
        meshes.append(Meshes([verts], [faces.verts_idx], textures))
    return meshes[0] if len(meshes) == 1 else join_meshes_as_batch(meshes)


def save_obj(
    f: Any, verts: Tensor, faces: Tensor, decimal_places: int | None = None, path_manager: Any = None, *,
    verts_uvs: Tensor | None = None, faces_uvs: Tensor | None = None, texture_map: Tensor | None = None, **unknown: Any,
) -> None:  # fmt: skip
    """Write an OBJ file, with all digits, and its image and material beside it."""
    if any(value is not None for value in unknown.values()):
        raise NotImplementedError(f"save_obj({', '.join(unknown)}): not in neural-renderer run")
    if texture_map is None or verts_uvs is None or faces_uvs is None:
        save_mesh(f, verts.detach(), faces, overwrite=True)
        return
    uv = verts_uvs.detach(), faces_uvs
    UVMesh(verts.detach(), faces, uv, texture_map.detach().clamp(0, 1)).save(f, overwrite=True)


def load_ply(f: Any, *, path_manager: Any = None) -> tuple[Tensor, Tensor]:
    """Read the vertices [V, 3] and triangles [F, 3] of a PLY file."""
    vertices, faces, *_ = read_mesh(f)
    return torch.from_numpy(np.asarray(vertices)).float(), torch.from_numpy(np.asarray(faces)).long()


def save_ply(f: Any, verts: Tensor, faces: Tensor | None = None, **_: Any) -> None:
    """Write vertices and triangles as PLY."""
    save_mesh(f, verts.detach(), verts.new_zeros(0, 3).long() if faces is None else faces)


def _open_file(f: Any, path_manager: Any = None, mode: str = "r") -> Any:
    """Open a path, or return the open file, as a context manager; PyTorch3D's, which programs import."""
    return open(f, mode) if isinstance(f, (str, Path)) else contextlib.nullcontext(f)


def _listed(values: np.ndarray, device: Any) -> tuple[Tensor | None, Tensor]:
    """List the rows of [F, 3, C] once each, and return their indices [F, 3]; -1 for NaN."""
    rows = values.reshape(-1, values.shape[2])
    known = np.isfinite(rows).all(1)
    listed, index = np.unique(rows[known], axis=0, return_inverse=True)
    found = np.full(len(rows), -1)
    found[known] = index.reshape(-1)
    table = torch.from_numpy(listed).float().to(device) if len(listed) else None
    return table, torch.from_numpy(found.reshape(-1, 3)).long().to(device)


def _materials(obj: ObjFile, device: Any) -> tuple[dict[str, dict[str, Tensor]], dict[str, Tensor]]:
    """Read the colours and images of materials, by their names."""
    colors: dict[str, dict[str, Tensor]] = {}
    images: dict[str, Tensor] = {}
    for name, material in obj_materials(obj, allow_outside=False).items():
        known = {_COLORS[key]: value for key, value in material.colors.items() if key in _COLORS}
        colors[name] = {key: torch.tensor(value, device=device).float() for key, value in known.items()}
        if "shininess" in material.numbers:
            colors[name]["shininess"] = torch.tensor([material.numbers["shininess"]], device=device)
        path = find_file(obj.path, material.maps["color"].image, material.folder) if "color" in material.maps else None
        if path is not None:
            images[name] = load_image(Path(path))[..., :3].to(device)
    return colors, images
