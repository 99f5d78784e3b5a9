"""Reading and writing of rigs in glTF files."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...camera.rotations import from_quaternion, to_quaternion
from ...io.formats import read_rigged
from ...io.gltf.rig_reader import RigFile, Track
from ...io.gltf.writer import glb_bytes
from ..uv_mesh import UVMesh


def read_rig(path: str | os.PathLike[str], grey: float, allow_outside: bool) -> dict[str, Any]:
    """Read the arguments of a `Rig`; errors as `Rig.load`."""
    points, corners, surface, rig = read_rigged(path, allow_outside)
    mesh = UVMesh._of_surface(points, corners, surface, grey)
    if len(rig.targets):
        mesh = mesh.replace(normals=None, tangents=None)
    animations: dict[str, list[Track]] = {}
    for number, (name, tracks) in enumerate(rig.animations):
        animations[name if name not in animations else f"{name} ({number})"] = tracks
    names = ("translations", "weights", "scales", "inverse_bind", "targets", "target_weights")
    return {
        "mesh": mesh,
        "parents": tuple(rig.parents),
        "indices": torch.from_numpy(rig.indices),
        "bones": torch.from_numpy(rig.bones),
        "rotations": from_quaternion(torch.from_numpy(rig.rotations[:, [3, 0, 1, 2]]).float()),
        "names": tuple(rig.names),
        "animations": animations,
        **{name: torch.from_numpy(getattr(rig, name)).float() for name in names},
    }


def encoded_rig(rig: Any, inverse: Any) -> bytes:
    """Encode a `Rig` as GLB, with inverse bind matrices [B, 4, 4], or their parts [B, 3, 3] and [B, 3]."""
    if isinstance(inverse, tuple):
        matrix = torch.eye(4).repeat(len(rig.bones), 1, 1).to(inverse[0])
        matrix[:, :3, :3], matrix[:, :3, 3] = inverse
        inverse = matrix
    names = ("translations", "scales", "bones", "indices", "weights", "targets", "target_weights")
    file = RigFile(
        names=list(rig.names),
        parents=list(rig.parents),
        rotations=_array(to_quaternion(rig.rotations)[:, [1, 2, 3, 0]]),
        inverse_bind=_array(inverse),
        animations=[(name, list(tracks)) for name, tracks in rig.animations.items()],
        **{name: _array(getattr(rig, name)) for name in names},
    )
    return glb_bytes(_array(rig.mesh.vertices), _array(rig.mesh.faces), rig.mesh._surface(), file)


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().numpy()
