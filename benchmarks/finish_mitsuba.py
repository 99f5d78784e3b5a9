"""Pictures of a `UVMesh` by Mitsuba 3 (``pip install mitsuba``), matt, with its normal map: for `finish_quality`."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.pictures.outputs import distance_to_see
from neural_renderer.apps.compare.stage import VIEWING_ANGLE, sphere_points
from neural_renderer.meshes.bounds import bounding_box

_SAMPLES = 16  # of a pixel
_SIDE = 1024  # of images: larger ones of the original are averaged


def drawn_by_mitsuba(mesh: nr.UVMesh, around: nr.UVMesh, views: int, pixels: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Draw a mesh from cameras around another one: display values [1, 3, S, S] and coverage [1, S, S] of each view."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    center = bounding_box(around.vertices)[0]
    distance = distance_to_see(float((around.vertices - center).norm(dim=1).max()), VIEWING_ANGLE, 1.0)
    film = {"type": "hdrfilm", "width": pixels, "height": pixels, "pixel_format": "rgba", "rfilter": {"type": "box"}}
    with tempfile.TemporaryDirectory() as folder:
        scene: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "direct", "hide_emitters": True},
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.4}},
            "sun": {"type": "directional", "direction": [0.3, -0.8, -0.5], "irradiance": {"type": "rgb", "value": 1.8}},
        } | _surfaces(mesh, Path(folder))
        loaded = mi.load_dict(scene)
        for direction in sphere_points(views).float():
            eye = (center + distance * direction).tolist()
            place = mi.ScalarTransform4f().look_at(eye, center.tolist(), [0.0, 1.0, 0.0])
            camera = {"type": "perspective", "fov": 2 * VIEWING_ANGLE, "fov_axis": "y", "to_world": place, "film": film}
            near = {"near_clip": 0.01 * distance, "far_clip": 10 * distance}
            sensor = mi.load_dict(camera | near | {"sampler": {"type": "multijitter", "sample_count": _SAMPLES}})
            drawn = torch.from_numpy(np.array(mi.render(loaded, sensor=sensor, spp=_SAMPLES))).float().movedim(-1, 0)
            color, alpha = drawn[:3], drawn[3].clamp(0, 1)
            yield nr.linear_to_srgb((color + 1 - alpha).clamp(0, 1))[None], alpha[None]


def _surfaces(mesh: nr.UVMesh, folder: Path) -> dict[str, Any]:
    """Describe the faces of each image."""
    found = {}
    for number in mesh.image_index.unique().tolist():
        rows = mesh.image_index == number
        path = folder / f"{number}.ply"
        _write_ply(path, mesh, rows)
        reflectance: dict[str, Any] = {"type": "rgb", "value": 0.5}
        if number >= 0:
            reflectance = _bitmap(nr.srgb_to_linear(mesh.images[number].detach().clamp(0, 1)))
        matt: dict[str, Any] = {"type": "diffuse", "reflectance": reflectance}
        texture = mesh.materials[0].normal_texture if mesh.materials else None
        if texture is not None:
            matt = {"type": "normalmap", "normalmap": _bitmap(texture.image), "bsdf": matt}
        found[f"part_{number}"] = {"type": "ply", "filename": str(path), "bsdf": {"type": "twosided", "bsdf": matt}}
    return found


def _bitmap(image: Tensor) -> dict[str, Any]:
    import mitsuba as mi

    factor = max(1, image.shape[0] // _SIDE)
    small = torch.nn.functional.avg_pool2d(image.detach().float().movedim(2, 0)[None], factor)[0].movedim(0, 2)
    return {"type": "bitmap", "bitmap": mi.Bitmap(small.contiguous().numpy()), "raw": True, "wrap_mode": "clamp"}


def _write_ply(path: Path, mesh: nr.UVMesh, rows: Tensor) -> None:
    """Write faces that share no vertices, with normals and coordinates, v down."""
    corners = mesh.vertices[mesh.faces[rows].long()].reshape(-1, 3)
    given = mesh.normals
    smooth = nr.vertex_normals(mesh.vertices, mesh.faces)[0][mesh.faces.long()] if given is None else given
    uv = mesh.uv[rows].reshape(-1, 2) * torch.tensor([1.0, -1.0]) + torch.tensor([0.0, 1.0])
    values = torch.cat((corners, smooth[rows].reshape(-1, 3), uv), 1).detach().float().numpy().astype("<f4")
    count = len(values)
    faces = np.empty(count // 3, dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, np.arange(count).reshape(-1, 3)
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{names}element face {count // 3}\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    path.write_bytes(head.encode() + values.tobytes() + faces.tobytes())
