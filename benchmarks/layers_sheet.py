"""Transparency and shadows beside Mitsuba 3: ``python -m benchmarks.layers_sheet``.

Columns: this renderer, Mitsuba if it is installed, and four times the difference. Prints times and mean differences.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.pictures.sheet import sheet

from . import mitsuba_scenes
from .shading_sheet import timed

EYE, ANGLE = (0.0, 1.2, 3.0), 25.0
GLASS = ((0.9, 0.25, 0.2), (0.2, 0.75, 0.35), (0.25, 0.4, 0.95))
OPACITY, BEHIND = 0.4, 0.85
SUN = nr.Light(0.0, 0.8, direction=(0.6, 0.75, 0.28))
SPOT = nr.SpotLight((1.2, 2.4, 1.4), 6.0, direction=(-1.2, -2.6, -1.4), inner=23.5, outer=24.0)


def panes() -> tuple[Tensor, Tensor, Tensor]:
    """Three squares that intersect, turned towards the eye: vertices, faces, and the number of each face's square."""
    vertices, faces = [], []
    square = torch.tensor([[-0.75, -0.75, 0.0], [0.75, -0.75, 0.0], [0.75, 0.75, 0.0], [-0.75, 0.75, 0.0]])
    for n in range(3):
        turn = math.radians(2 * 20 * (n - 1))
        rotation = torch.tensor(
            [[math.cos(turn), 0, math.sin(turn)], [0, 1.0, 0], [-math.sin(turn), 0, math.cos(turn)]]
        )
        vertices.append(square @ rotation.T + torch.tensor([0.35 * (n - 1), 0.2 * (n - 1), 0.12 * n]))
        faces.append(torch.tensor([[0, 1, 2], [0, 2, 3]]) + 4 * n)
    return torch.cat(vertices), torch.cat(faces), torch.arange(3).repeat_interleave(2)


def glass() -> nr.UVMesh:
    """The squares as transparent materials."""
    vertices, faces, owner = panes()
    colors = torch.tensor(GLASS)[owner][:, None].expand(-1, 3, 3)
    count = len(faces)
    materials = (nr.Material("glass", opacity=OPACITY, alpha_mode="BLEND"),)
    return nr.UVMesh(
        vertices, faces, torch.zeros(count, 3, 2), torch.full((count,), -1), (), colors, (), materials=materials
    )


def still_life() -> nr.Mesh:
    """A ball, a ring and a cube on a ground."""
    ball, ball_faces = nr.icosphere(5, 0.3)
    cube, cube_faces = nr.cube()
    cube = cube[cube_faces.long()].reshape(-1, 3)  # each face has vertices of its own, so that its edges are sharp
    cube_faces = torch.arange(len(cube)).view(-1, 3)
    ring, ring_faces = nr.torus()
    ring = 0.35 * ring / ring.abs().max()
    ground = torch.tensor([[-3.0, -0.5, -3.0], [-3.0, -0.5, 3.0], [3.0, -0.5, 3.0], [3.0, -0.5, -3.0]])
    parts = [
        (ball + torch.tensor([0.45, -0.2, 0.25]), ball_faces),
        (0.22 * cube / cube.abs().max() + torch.tensor([-0.6, -0.28, 0.35]), cube_faces),
        (ring + torch.tensor([0.0, 0.12, -0.3]), ring_faces),
        (ground, torch.tensor([[0, 1, 2], [0, 2, 3]])),
    ]
    firsts = np.cumsum([0, *(len(points) for points, _ in parts)]).tolist()
    faces = torch.cat([corners.long() + first for (_, corners), first in zip(parts, firsts, strict=False)])
    return nr.Mesh(torch.cat([points for points, _ in parts]), faces)


def mitsuba_glass(size: int, samples: int) -> Tensor:
    """The panes as surfaces that shine with a · colour and let 1 − a of the light behind them pass."""
    import mitsuba as mi

    vertices, faces, owner = panes()
    camera = mi.ScalarTransform4f().look_at(list(EYE), [0.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 12, "rr_depth": 100},
        "sensor": {"type": "perspective", "fov": 2 * ANGLE, "fov_axis": "y", "to_world": camera, "film": film},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": BEHIND}},
    }
    with tempfile.TemporaryDirectory() as folder:
        for n, color in enumerate(GLASS):
            corners = vertices[faces[owner == n].long()].reshape(-1, 3).tolist()
            text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\nf 4 5 6\n"
            path = Path(folder) / f"{n}.obj"
            path.write_text(text)
            black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
            shine = {"type": "rgb", "value": [OPACITY * part for part in color]}
            scene[f"pane_{n}"] = {
                "type": "obj",
                "filename": str(path),
                "face_normals": True,
                "bsdf": {"type": "mask", "opacity": OPACITY, "nested": {"type": "twosided", "nested": black}},
                "emitter": {"type": "area", "radiance": shine},
            }
        pixels = np.array(mi.render(mi.load_dict(scene), spp=samples))[..., :3]
    return torch.from_numpy(pixels).float().movedim(-1, 0)


def mitsuba_shadow(light: Any, size: int, samples: int) -> Tensor:
    """The still life by direct light."""
    mesh, surface = still_life(), {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    surface = {"type": "twosided", "nested": surface}
    return mitsuba_scenes.draw(mesh.vertices, mesh.faces, EYE, ANGLE, size, [light], surface, samples=samples)


def main() -> None:
    """Draw the sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/layers.png"))
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--samples", type=int, default=256, help="of Mitsuba, for each pixel")
    arguments = parser.parse_args()
    samples = arguments.samples
    size, camera = arguments.size, nr.Camera.look_at(EYE, viewing_angle=ANGLE)
    compares = mitsuba_scenes.available()

    def see_through(mesh: nr.UVMesh) -> Tensor:
        return nr.render(mesh, camera, size, light=None, background=BEHIND, layers=3).rgb[0]

    def shadowed(light: Any, mesh: nr.Mesh) -> Tensor:
        lamp = nr.ShadowedLight(light, mesh, size=1024, softness=1.0)
        return nr.render(mesh, camera, size, light=lamp, shading="smooth").rgb[0]

    def shadow(light: Any) -> tuple[Any, Callable[[Any], Tensor], Callable[[], Tensor]]:
        return still_life(), lambda mesh: shadowed(light, mesh), lambda: mitsuba_shadow(light, size, samples)

    rows: list[tuple[str, Any, Callable[[Any], Tensor], Callable[[], Tensor]]] = [
        ("glass in three layers", glass(), see_through, lambda: mitsuba_glass(size, samples)),
        ("shadow of the sun", *shadow(SUN)),
        ("shadow of a spot", *shadow(SPOT)),
    ]
    cells = []
    print("picture | ms | ms with gradient | mean difference | share of pixels apart by 0.05")
    for name, mesh, draw, reference in rows:
        ours = draw(mesh).detach()
        with torch.no_grad():
            forward = timed(lambda draw=draw, mesh=mesh: draw(mesh))
        vertices = mesh.vertices.clone().requires_grad_()
        moving = (
            nr.Mesh(vertices, mesh.faces) if isinstance(mesh, nr.Mesh) else dataclasses.replace(mesh, vertices=vertices)
        )
        both = timed(lambda draw=draw, moving=moving: draw(moving).square().mean().backward())
        row, text = [ours, torch.zeros_like(ours), torch.zeros_like(ours)], "no reference"
        if compares:
            theirs = reference()
            apart = (ours - theirs).abs()
            row, text = [ours, theirs, 4 * apart], f"{apart.mean():.4f} | {(apart.amax(0) > 0.05).float().mean():.4f}"
        print(f"{name} | {forward:.1f} | {both:.1f} | {text}", flush=True)
        cells.append([part.clamp(0, 1) for part in row])
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    nr.save_image(arguments.output, sheet(cells, [row[0] for row in rows]).float() / 255)
    print(arguments.output)


if __name__ == "__main__":
    main()
