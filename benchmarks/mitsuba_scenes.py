"""Scenes of `benchmarks.shading_sheet` in Mitsuba 3 (``pip install mitsuba``), by direct light."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import neural_renderer as nr


def available() -> bool:
    """Whether Mitsuba is installed."""
    try:
        import mitsuba
    except ImportError:
        return False
    mitsuba.set_variant("scalar_rgb")
    return True


def draw(
    vertices: Tensor,
    faces: Tensor,
    eye: tuple[float, float, float],
    angle: float,
    size: int,
    lights: list[Any],
    surface: dict[str, Any],
    *,
    uv: Tensor | None = None,
    smooth: bool = True,
    samples: int = 256,
) -> Tensor:
    """Draw a mesh from ``eye`` towards the origin.

    Args:
        vertices: [V, 3].
        faces: [F, 3].
        eye: Position of the camera.
        angle: Half the vertical field of view in degrees.
        size: Side of the image.
        lights: Lights of `neural_renderer`, without ambient light.
        surface: Mitsuba's dictionary of a BSDF.
        uv: [F, 3, 2].
        smooth: Interpolate `vertex_normals`.
        samples: Samples of each pixel.

    Returns:
        Linear radiance [3, H, W].
    """
    import mitsuba as mi

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.obj"
        path.write_text(_obj(vertices, faces, uv))
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
        place = mi.ScalarTransform4f().look_at(list(eye), [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        scene = {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1},
            "sensor": {"type": "perspective", "fov": 2 * angle, "fov_axis": "y", "to_world": place, "film": film},
            "mesh": {"type": "obj", "filename": str(path), "face_normals": not smooth, "bsdf": surface},
        }
        scene |= {f"light_{number}": _emitter(light) for number, light in enumerate(lights)}
        pixels = np.array(mi.render(mi.load_dict(scene), spp=samples))[..., :3]
    return torch.from_numpy(pixels).float().movedim(-1, 0)


def bitmap(image: Tensor, raw: bool) -> dict[str, Any]:
    """Return Mitsuba's dictionary of a texture [H, W, 3]: raw numbers, or sRGB."""
    import mitsuba as mi

    if raw:
        return {"type": "bitmap", "bitmap": mi.Bitmap(image.numpy()), "raw": True}
    return {"type": "bitmap", "bitmap": mi.Bitmap(nr.srgb_to_linear(image).numpy()), "raw": True}


def _emitter(light: Any) -> dict[str, Any]:
    import mitsuba as mi

    def rgb(color: Any, strength: float) -> dict[str, Any]:
        return {"type": "rgb", "value": [float(part) * float(strength) for part in color]}

    if isinstance(light, nr.EnvironmentLight):
        turned = mi.ScalarTransform4f().rotate([0, 1, 0], 180)  # its middle column is +z
        return {"type": "envmap", "bitmap": mi.Bitmap(light.image.numpy()), "to_world": turned}
    if isinstance(light, nr.SpotLight):
        target = [float(a + b) for a, b in zip(light.position, light.direction, strict=True)]
        place = mi.ScalarTransform4f().look_at(list(light.position), target, [0.0, 1.0, 0.01])
        strength = rgb(light.color, math.pi * light.intensity)
        return {
            "type": "spot",
            "to_world": place,
            "intensity": strength,
            "cutoff_angle": light.outer,
            "beam_width": light.inner,
        }
    if isinstance(light, nr.PointLight):
        strength = rgb(light.color, math.pi * light.intensity)
        return {"type": "point", "position": list(light.position), "intensity": strength}
    strength = rgb(light.directional_color, math.pi * light.directional)
    return {"type": "directional", "direction": [-part for part in light.direction], "irradiance": strength}


def _obj(vertices: Tensor, faces: Tensor, uv: Tensor | None) -> str:
    normals = nr.vertex_normals(vertices, faces)[0]
    lines = [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in vertices.tolist()]
    lines += [f"vn {x:.8f} {y:.8f} {z:.8f}" for x, y, z in normals.tolist()]
    if uv is not None:
        lines += [f"vt {u:.8f} {v:.8f}" for u, v in uv.reshape(-1, 2).tolist()]
    for number, face in enumerate(faces.tolist()):
        text = (f"{v + 1}/{3 * number + k + 1 if uv is not None else ''}/{v + 1}" for k, v in enumerate(face))
        lines.append("f " + " ".join(text))
    return "\n".join(lines) + "\n"
