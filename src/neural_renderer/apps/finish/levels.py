"""`save_levels`: several levels of detail in one GLB file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ...io.atomic_write import write_file
from ...io.files import mesh_to_write
from ...io.gltf.writer import glb_of_levels
from ...meshes.uv_mesh import UVMesh

_SCREEN = 1920 * 1080  # pixels
_PIXELS_OF_A_FACE = 16  # a level looks coarse where a face covers more pixels than this


def save_levels(path: str | os.PathLike[str], meshes: Sequence[UVMesh]) -> None:
    """Write levels of detail as one GLB file with the extension ``MSFT_lod``.

    Programs that do not know the extension show the finest level. The shares of the screen at which levels change,
    ``MSFT_screencoverage``, let a visible face of the next level cover at most 16 pixels of 1920 × 1080. The last level
    is never hidden.

    Args:
        path: Name that ends in ``.glb``. A file of this name is replaced.
        meshes: Two levels or more, in any order.

    Raises:
        TypeError, ValueError, OSError: As `UVMesh.save`.

    Example:
        >>> levels = nr.finish(nr.Mesh.icosphere(3), [200, 50], size=64, steps=0)
        >>> nr.save_levels("levels.glb", [level.mesh for level in levels])
        >>> nr.UVMesh.load("levels.glb").num_faces  # the finest
        200
    """
    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise ValueError(f"path: expected a name that ends in .glb, got {path.name!r}")
    if len(meshes) < 2:
        raise ValueError(f"meshes: expected at least two, got {len(meshes)}")
    for mesh in meshes:
        if not isinstance(mesh, UVMesh):
            raise TypeError(f"meshes: expected UVMesh, got {type(mesh).__name__}")
    ordered = sorted(meshes, key=lambda mesh: -mesh.num_faces)
    arrays = [(*mesh_to_write(mesh.vertices, mesh.faces)[:2], mesh._surface()) for mesh in ordered]
    write_file(path, glb_of_levels(arrays, screen_coverage([mesh.num_faces for mesh in ordered])))


def screen_coverage(faces: Sequence[int]) -> list[float]:
    """Compute the least share of the screen for levels with these numbers of faces, half of which are visible."""
    shares = [count / 2 * _PIXELS_OF_A_FACE / _SCREEN for count in faces[1:]]
    return [round(min(share, 1.0), 6) for share in shares] + [0.0]
