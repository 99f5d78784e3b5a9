"""glTF files beside Filament: ``python -m benchmarks.gltf_sheet [FILE …]``.

Rows: scenes that this package writes as GLB, each under a lamp and in an environment, then the files, such as those of
Khronos' glTF-Sample-Assets. Columns: this renderer, Filament if it is installed (``pip install filly``), and four times
the difference. Prints times and mean differences. Both renderers read the same file.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.pictures.sheet import sheet

from .shading_sheet import bumps, sky, timed, uv_sphere

ANGLE, LAYERS, BEHIND = 25.0, 4, 0.5
LAMP = nr.Light(0.0, 1.0, direction=(1 / 3, 2 / 3, 2 / 3))
ROUGHNESS = (0.15, 0.3, 0.5, 0.75, 1.0)


@dataclasses.dataclass
class View:
    """A camera that sees a whole mesh, and its depth range."""

    eye: Tensor
    at: Tensor
    near: float
    far: float

    @classmethod
    def of(cls, mesh: nr.UVMesh, direction: tuple[float, float, float]) -> View:
        low, high = torch.aminmax(mesh.vertices, dim=0)
        middle, radius = (low + high) / 2, float((high - low).norm()) / 2
        distance = 1.02 * radius / math.sin(math.radians(ANGLE))
        eye = middle + distance * torch.nn.functional.normalize(torch.tensor(direction), dim=0)
        return cls(eye, middle, distance - radius, distance + radius)

    @property
    def camera(self) -> nr.Camera:
        return nr.Camera.look_at(self.eye, self.at, viewing_angle=ANGLE)


def available() -> bool:
    """Whether Filament is installed."""
    try:
        import filly  # noqa: F401
    except ImportError:
        return False
    return True


def spheres() -> nr.UVMesh:
    """Two rows of spheres, plastic and gold, from smooth to rough."""
    vertices, faces, uv = uv_sphere(32, 64)
    own = []
    for row, (metallic, color) in enumerate(((0.0, (0.1, 0.25, 0.6)), (1.0, (1.0, 0.77, 0.34)))):
        for column, roughness in enumerate(ROUGHNESS):
            place = torch.tensor([2.2 * column, -2.2 * row, 0.0])
            material = nr.Material(f"{row} {column}", metallic=metallic, roughness=roughness, base_color=color)
            own.append(
                nr.UVMesh(vertices + place, faces, uv, torch.ones(2, 2, 3), **_of_sphere(vertices, faces, material))
            )
    return nr.join(own)


def relief() -> nr.UVMesh:
    """A sphere with a normal map, which a transform of its coordinates repeats, and stripes that emit light.

    The transform does not turn: Filament turns before it scales, glTF after.
    """
    vertices, faces, uv = uv_sphere()
    spots = (torch.linspace(0, 4 * math.pi, 128).sin().clamp(min=0) ** 4)[None, :, None].expand(64, -1, 3).contiguous()
    material = nr.Material(
        metallic=0.3,
        roughness=0.4,
        normal_texture=nr.Texture(bumps(), scale=(12.0, 6.0), offset=(0.1, 0.2)),
        emissive=(0.3, 0.1, 0.0),
        emissive_texture=nr.Texture(spots),
    )
    checks = ((torch.arange(64)[:, None] // 4 + torch.arange(128) // 4) % 2)[..., None] * 0.4 + 0.4
    return nr.UVMesh(
        vertices, faces, uv, checks.expand(-1, -1, 3).contiguous(), **_of_sphere(vertices, faces, material)
    )


def _of_sphere(vertices: Tensor, faces: Tensor, material: nr.Material) -> dict[str, Any]:
    """Return the material and the normals of a sphere. Filament ignores uv for normal maps of files without normals."""
    return {"materials": (material,), "normals": vertices[faces.long()]}


def scenes(folder: Path) -> Iterator[tuple[str, Path, tuple[float, float, float]]]:
    """Write the package's own scenes; yield name, file, and the direction from which each is seen."""
    for name, mesh, direction in (
        ("spheres", spheres(), (0.0, 0.0, 1.0)),
        ("relief", relief(), (0.0, 0.3, 1.0)),
    ):
        mesh.save(folder / f"{name}.glb")
        yield name, folder / f"{name}.glb", direction


def drawn(mesh: nr.UVMesh, view: View, size: int, light: Any) -> Tensor:
    """Draw a mesh with this renderer, [3, H, W] display values."""
    behind: Any = light.background(view.camera, size) if isinstance(light, nr.EnvironmentLight) else BEHIND
    blends = any(material.alpha_mode != "OPAQUE" or not material.double_sided for material in mesh.materials)
    options: dict[str, Any] = {"light": light, "shading": "pbr", "background": behind, "outputs": ("rgb",)}
    options |= {"near": 0.5 * view.near, "far": 2 * view.far, "layers": LAYERS if blends else None}
    return nr.render(mesh, view.camera, size, **options).rgb[0]


def reference(path: Path, view: View, size: int, light: Any) -> Tensor | None:
    """Draw a file with Filament, [3, H, W] display values; None if it is not there."""
    if not available():
        return None
    import filly

    with filly.Renderer() as renderer:
        scene = renderer.create_scene()
        scene.load(str(path))
        camera = scene.camera = renderer.create_camera()
        camera.set_perspective(fov_y_deg=2 * ANGLE, near=0.5 * view.near, far=2 * view.far)
        camera.position = view.eye.tolist()
        camera.look_at(view.at.tolist())
        camera.exposure = -math.log2(1.2)  # a radiance of 1 becomes a pixel of 1
        scene.tone_mapping, scene.antialiasing, scene.dithering = "linear", "none", False
        if isinstance(light, nr.EnvironmentLight):
            image = torch.as_tensor(light.image)
            # Filament's left column is -z, ours the middle one.
            pixels = np.ascontiguousarray(image.roll(image.shape[1] // 2, 1).numpy(), dtype=np.float32)
            scene.environment, scene.environment_intensity = renderer.create_environment(pixels), 1.0
            scene.environment_visible = True
        else:
            away = [-value for value in light.direction]
            scene.add_directional_light(direction=away, intensity=math.pi * light.directional)
            grey = float(nr.srgb_to_linear(torch.tensor(BEHIND)))
            scene.background = [grey, grey, grey, 1.0]
        target = renderer.create_render_target(width=2 * size, height=2 * size)
        renderer.render(scene, target)
        image = torch.from_numpy(target.read()[..., :3].copy()).movedim(2, 0) / 255
    return torch.nn.functional.avg_pool2d(image[None], 2)[0]  # as this renderer's anti-aliasing


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="*", metavar="FILE", help=".glb or .gltf")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/gltf.png"))
    parser.add_argument("--size", type=int, default=256, help="side of each picture")
    parser.add_argument("--from", type=float, nargs=3, default=(0.4, 0.3, 1.0), dest="direction", help="of the files")
    arguments = parser.parse_args()
    size, cells, labels = arguments.size, [], []
    lights = {"lamp": LAMP, "environment": nr.EnvironmentLight(sky())}
    print("picture | ms | mean difference | largest")
    with tempfile.TemporaryDirectory() as folder:
        given = [(path.stem, path, tuple(arguments.direction)) for path in arguments.files]
        for name, path, direction in [*scenes(Path(folder)), *given]:
            mesh = nr.UVMesh.load(path)
            view = View.of(mesh, direction)
            alpha = nr.render(mesh, view.camera, size, outputs="alpha", near=0.5 * view.near, far=2 * view.far).alpha
            inside = -torch.nn.functional.max_pool2d(-alpha[None], 3, 1, 1)[0, 0] > 0.999  # without a border
            for kind, light in lights.items():
                with torch.no_grad():
                    ours = drawn(mesh, view, size, light)
                    spent = timed(lambda mesh=mesh, view=view, light=light: drawn(mesh, view, size, light))
                theirs = reference(path, view, size, light)
                text, row = "no reference", [ours]
                if theirs is not None:
                    apart = (ours.clamp(0, 1) - theirs).abs()
                    text = f"{apart.mean(0)[inside].mean():.4f} | {apart.amax(0)[inside].max():.3f}"
                    row += [theirs, 4 * apart]
                row += [torch.zeros_like(ours)] * (3 - len(row))
                print(f"{name}, {kind} | {spent:.1f} | {text}", flush=True)
                cells.append([part.clamp(0, 1) for part in row])
                labels.append(f"{name}, {kind}")
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    nr.save_image(arguments.output, sheet(cells, labels).float() / 255)
    print(arguments.output)


if __name__ == "__main__":
    main()
