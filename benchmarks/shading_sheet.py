"""A sheet of pictures, one for each kind of shading, beside Mitsuba 3: ``python -m benchmarks.shading_sheet``.

Columns: this renderer, Mitsuba if it is installed, and four times the difference. Prints times and mean differences.
Mitsuba casts shadows, so that the meshes are convex where numbers are compared.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.pictures.sheet import sheet

from . import mitsuba_scenes

EYE, ANGLE = (0.0, 1.0, 3.0), 25.0
LAMP = nr.PointLight((2.0, 2.5, 2.5), intensity=9.0, color=(1.0, 0.95, 0.9))
SPOT = nr.SpotLight((1.0, 2.0, 2.5), 9.0, direction=(-0.8, -1.8, -2.5), inner=10.0, outer=10.5)
GOLD, BLUE = (1.0, 0.86, 0.57), (0.2, 0.45, 0.8)  # display values


@dataclasses.dataclass
class Picture:
    """One row: a mesh, its lights, how it is drawn here and by Mitsuba."""

    name: str
    mesh: Any
    lights: list[Any]
    shading: Any
    surface: dict[str, Any] | None
    linear: bool = False  # whether Mitsuba's radiance is converted to display values
    smooth: bool = True


def sky(height: int = 64) -> Tensor:
    """Make an environment [H, 2 H, 3]: a blue sky with a sun, clouds of light, a brown ground."""
    row = torch.linspace(1, -1, height)[:, None].expand(height, 2 * height)
    turn = torch.linspace(-math.pi, math.pi, 2 * height).expand(height, 2 * height)
    blue, ground = torch.tensor([0.35, 0.55, 1.0]), torch.tensor([0.30, 0.22, 0.15])
    image = torch.where(row[..., None] > 0, 0.25 + blue * (0.4 + 0.6 * row[..., None]), ground * (1 + row[..., None]))
    image = image + 0.4 * torch.exp(-(((row - 0.15) / 0.08) ** 2))[..., None] * (1 + torch.cos(3 * turn))[..., None]
    sun = torch.exp(-(((row - 0.6) / 0.06) ** 2 + ((turn - 2.4) / 0.12) ** 2))
    return image + 30 * sun[..., None] * torch.tensor([1.0, 0.9, 0.7])


def uv_sphere(rows: int = 48, columns: int = 96) -> tuple[Tensor, Tensor, Tensor]:
    """Make a sphere with texture coordinates: vertices, faces, uv [F, 3, 2]."""
    down = torch.linspace(0, math.pi, rows + 1)[:, None].expand(-1, columns)
    turn = (torch.arange(columns) * (2 * math.pi / columns)).expand(rows + 1, -1)
    points = torch.stack((down.sin() * turn.sin(), down.cos(), down.sin() * turn.cos()), -1).reshape(-1, 3)
    i, j = (part.reshape(-1) for part in torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij"))
    corner = torch.stack((i, i + 1, i + 1, i), 1), torch.stack((j, j, j + 1, j + 1), 1)
    index = corner[0] * columns + corner[1] % columns
    uv = torch.stack((corner[1] / columns, 1 - corner[0] / rows), -1)
    order = torch.tensor([[0, 1, 2], [0, 2, 3]])
    kept = torch.stack((i < rows - 1, i > 0), 1)  # without the empty triangles at the poles
    return points, index[:, order][kept].int(), uv[:, order][kept].float()


def bumps(size: int = 128) -> Tensor:
    """Make a normal map [H, W, 3] of round bumps."""
    x = torch.linspace(0, 2 * math.pi, size + 1)[:-1]
    slope = 0.6 * torch.stack((torch.sin(x).expand(size, -1), -torch.sin(x)[:, None].expand(-1, size)), -1)
    normal = torch.cat((slope, torch.ones(size, size, 1)), -1)
    return 0.5 + 0.5 * torch.nn.functional.normalize(normal, dim=-1)


def colored(mesh: nr.Mesh, color: tuple[float, ...]) -> nr.Mesh:
    return nr.Mesh(mesh.vertices, mesh.faces, face_colors=torch.tensor(color).expand(mesh.num_faces, 3))


def principled(color: tuple[float, ...], metallic: float, roughness: float) -> dict[str, Any]:
    rgb = nr.srgb_to_linear(torch.tensor(color)).tolist()
    return {
        "type": "principled",
        "base_color": {"type": "rgb", "value": rgb},
        "metallic": metallic,
        "roughness": roughness,
    }


def pictures() -> Iterator[Picture]:
    """List the rows of the sheet."""
    red = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.3, 0.25]}}
    ball = colored(nr.Mesh.icosphere(2), (0.8, 0.3, 0.25))
    yield Picture("flat", ball, [LAMP], "flat", red, smooth=False)
    yield Picture("smooth", ball, [LAMP], "smooth", red)
    yield Picture("spot light", ball, [SPOT], "smooth", red)
    vertices, faces, uv = uv_sphere()
    checks = ((torch.arange(64)[:, None] // 4 + torch.arange(128) // 4) % 2)[..., None] * 0.4 + 0.5
    image = (checks * torch.tensor([0.6, 0.8, 0.9])).float()
    relief = nr.Material(normal_texture=nr.Texture(bumps(), scale=(16.0, 8.0)))
    plain = nr.UVMesh(vertices, faces, uv, image)
    texture = mitsuba_scenes.bitmap(image, True) if mitsuba_scenes.available() else {}
    matt = {"type": "diffuse", "reflectance": texture}
    yield Picture("texture", plain, [LAMP], "smooth", matt)
    bumpy = dataclasses.replace(plain, materials=(relief,))
    surface = None
    if mitsuba_scenes.available():
        tiles = mitsuba_scenes.bitmap(bumps().repeat(8, 16, 1), True)
        surface = {"type": "normalmap", "normalmap": tiles, "bsdf": matt}
    yield Picture("normal map", bumpy, [LAMP], "smooth", surface)
    yield Picture("Phong", colored(nr.Mesh.icosphere(5), (0.8, 0.3, 0.25)), [LAMP], nr.Phong(0.6, 40), None)
    white = colored(nr.Mesh.icosphere(5), (1.0, 1.0, 1.0))
    environment = nr.EnvironmentLight(sky())
    chalk = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    yield Picture("environment, matt", white, [environment], "smooth", chalk)
    for metallic, color in ((1.0, GOLD), (0.0, BLUE)):
        for roughness in (0.1, 0.3, 0.5, 0.75, 1.0):
            mesh = colored(nr.Mesh.icosphere(5), color)
            name = f"{'metal' if metallic else 'plastic'}, roughness {roughness}"
            surface = principled(color, metallic, roughness)
            yield Picture(name, mesh, [environment], nr.PBR(metallic, roughness), surface, linear=True)
            if roughness in (0.3, 0.75):
                yield Picture(f"{name}, lamp", mesh, [LAMP], nr.PBR(metallic, roughness), surface, linear=True)


def drawn(picture: Picture, size: int) -> Tensor:
    """Draw a picture with this renderer, [3, H, W] display values."""
    camera = nr.Camera.look_at(EYE, viewing_angle=ANGLE)
    behind: Any = 0.0
    if isinstance(picture.lights[0], nr.EnvironmentLight) and picture.linear:
        behind = picture.lights[0].background(camera, size)
    options: dict[str, Any] = {"light": picture.lights, "shading": picture.shading, "background": behind}
    return nr.render(picture.mesh, camera, size, outputs=("rgb",), **options).rgb[0]


def reference(picture: Picture, size: int, samples: int) -> Tensor | None:
    """Draw a picture with Mitsuba, [3, H, W] display values; None if it is not there."""
    if picture.surface is None or not mitsuba_scenes.available():
        return None
    mesh, uv = picture.mesh, getattr(picture.mesh, "uv", None)
    arguments = (mesh.vertices.detach(), mesh.faces, EYE, ANGLE, size, picture.lights, picture.surface)
    found = mitsuba_scenes.draw(*arguments, uv=uv, smooth=picture.smooth, samples=samples)
    if picture.linear:
        return nr.linear_to_srgb(found)
    behind = isinstance(picture.lights[0], nr.EnvironmentLight)  # Mitsuba shows it
    mask = nr.render(mesh, nr.Camera.look_at(EYE, viewing_angle=ANGLE), size, outputs=("alpha",)).alpha.detach()
    return found * (mask > 0.999) if behind else found


def timed(call: Callable[[], Any], repeats: int = 3) -> float:
    """Return the median time in milliseconds, after a first call."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1000 * statistics.median(times)


def inside(picture: Picture, size: int) -> Tensor:
    """Find the pixels that the mesh covers, but for a border of one pixel, [H, W] bool."""
    camera = nr.Camera.look_at(EYE, viewing_angle=ANGLE)
    alpha = nr.render(picture.mesh, camera, size, outputs=("alpha",)).alpha.detach()
    return -torch.nn.functional.max_pool2d(-alpha[None], 3, 1, 1)[0, 0] > 0.999


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/shading.png"))
    parser.add_argument("--size", type=int, default=192, help="side of each picture")
    parser.add_argument("--samples", type=int, default=1024, help="of Mitsuba, for each pixel")
    arguments = parser.parse_args()
    size, cells, labels = arguments.size, [], []
    print("picture | ms | ms with gradient | mean difference | largest")
    for picture in pictures():
        with torch.no_grad():
            ours = drawn(picture, size)
            forward = timed(lambda picture=picture: drawn(picture, size))
        mesh = picture.mesh
        if not isinstance(mesh, nr.Mesh):
            picture = dataclasses.replace(
                picture, mesh=dataclasses.replace(mesh, vertices=mesh.vertices.requires_grad_())
            )
        both = timed(lambda picture=picture: drawn(picture, size).square().mean().backward())
        theirs = reference(picture, size, arguments.samples)
        text = "no reference"
        row = [ours]
        if theirs is not None:
            apart = (ours - theirs).abs().amax(0)[inside(picture, size)]
            text = f"{apart.mean():.4f} | {apart.max():.3f}"
            row += [theirs, 4 * (ours - theirs).abs()]
        row += [torch.zeros_like(ours)] * (3 - len(row))
        print(f"{picture.name} | {forward:.1f} | {both:.1f} | {text}", flush=True)
        cells.append([part.detach().clamp(0, 1) for part in row])
        labels.append(picture.name)
    half = (len(cells) + 1) // 2
    columns = [sheet(cells[k : k + half], labels[k : k + half]) for k in (0, half)]
    columns[1] = torch.nn.functional.pad(columns[1], (0, 0, 0, 0, 0, columns[0].shape[0] - columns[1].shape[0]))
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    nr.save_image(arguments.output, torch.cat(columns, 1).float() / 255)
    print(arguments.output)


if __name__ == "__main__":
    main()
