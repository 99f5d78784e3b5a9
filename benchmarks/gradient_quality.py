"""Quality of the gradients through visibility: ``python -m benchmarks.gradient_quality``.

1. A single triangle of 4, 16 and 64 pixels, at sub-pixel offsets and orientations, against closed forms.
2. Scenes against central finite differences of a heavily supersampled image, averaged over sub-pixel shifts.

Each estimator's mean gradient g is compared with the truth t: size = g . t / t . t (1 is right), and the cosine between
them. Noise is the deviation of the gradients of single offsets from their mean, relative to the truth.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

import neural_renderer as nr
from neural_renderer.raster.faces import world_corners
from neural_renderer.raster.rasterize import rasterize_images

SIDES = (4, 16, 64)
# Losses on the triangle as weights on the area at (x, y), in sides from its centre, with x towards a corner.
WISHES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "shrink": lambda x, y: torch.ones_like(x),
    "grow": lambda x, y: -torch.ones_like(x),
    "shift": lambda x, y: x,
    "rotate": lambda x, y: x * y,
}


@dataclass(frozen=True)
class Quality:
    """Comparison of an estimator's mean gradient with the truth, both flattened."""

    size: float
    cosine: float
    noise: float

    @classmethod
    def of(cls, samples: Tensor, truth: Tensor) -> Quality:
        """Compare samples with the truth, [N, D] each, one row per offset; the truth may differ between rows."""
        samples, truth = samples.double(), truth.double()
        mean, target = samples.mean(0), truth.mean(0)
        noise = (samples - truth - (mean - target)).norm(dim=1).mean() / truth.norm(dim=1).mean()
        size = (mean * target).sum() / (target * target).sum()
        return cls(float(size), float(torch.cosine_similarity(mean, target, dim=0)), float(noise))


def triangles(side: float, count: int, size: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Make N equilateral triangles near the middle of the image, at evenly spread sub-pixel offsets and orientations.

    Returns:
        Corners [N, 3, 2] and centres [N, 2], in pixels from the bottom left.
    """
    # An additive recurrence by powers of the root of x⁴ = x + 1, which fills the cube evenly.
    step = 1.2207440846057596 ** -torch.arange(1.0, 4, dtype=torch.float64)
    even = (torch.arange(1.0, count + 1, dtype=torch.float64)[:, None] * step + 0.5 + 0.1 * seed) % 1
    centre, angle = size / 2 + even[:, :2], even[:, 2:] * 2 * math.pi
    angle = angle + torch.arange(3) * 2 * math.pi / 3
    arms = side / math.sqrt(3) * torch.stack((angle.cos(), angle.sin()), -1)
    return centre[:, None] + arms, centre


def area_integral(corners: Tensor, centre: Tensor, axes: Tensor, wish: str) -> Tensor:
    """Integrate a polynomial weight exactly over triangles [N, 3, 2]; differentiable."""
    # Three points of equal weight integrate quadratic functions over a triangle exactly.
    shares = corners.new_tensor([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
    x, y = ((shares @ corners - centre[:, None]) @ axes).unbind(-1)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    return WISHES[wish](x, y).mean(1) * area


def triangle_quality(side: float, wish: str, gradient: str, count: int = 256) -> Quality:
    """Rotate gradients to the corners into each triangle's frame, so that they can be averaged."""
    size = 32 * math.ceil((2 * side + 16) / 32)
    corners, centre = triangles(side, count, size)
    first = torch.nn.functional.normalize(corners[:, 0] - centre, dim=1)
    axes = torch.stack((first, torch.stack((-first[:, 1], first[:, 0]), -1)), -1)  # [N, 2, 2], columns
    truth = corners.clone().requires_grad_()
    (expected,) = torch.autograd.grad(area_integral(truth, centre, axes / side, wish).sum(), truth)
    screen = torch.cat(((2 * corners + 1 - size) / size, torch.full((count, 3, 1), 2.0)), -1).float()[:, None]
    screen.requires_grad_()
    alpha = rasterize_images(screen, size, outputs=("alpha",), anti_aliasing=False, gradient=gradient).alpha
    pixel = torch.arange(size, dtype=torch.float64)
    places = torch.stack(torch.broadcast_tensors(pixel[None, :], pixel.flip(0)[:, None]), -1)
    weight = WISHES[wish](*(((places - centre[:, None, None]) / side) @ axes[:, None]).unbind(-1)).float()
    (found,) = torch.autograd.grad((alpha * weight).sum(), screen)
    found = found[:, 0, :, :2].double() * 2 / size
    return Quality.of((found @ axes).flatten(1), (expected @ axes).flatten(1))


@dataclass(frozen=True)
class Scene:
    """Scene with parameters, drawn at ``size`` pixels; ``steps`` are the steps of the finite differences."""

    parameters: dict[str, Tensor]
    steps: dict[str, float]
    build: Callable[..., dict[str, Tensor]]  # parameters -> vertices, faces, textures, camera, light
    size: int = 96


def _box(half: Tensor) -> tuple[Tensor, Tensor]:
    corner = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
    ]
    return corner * half, torch.tensor([*faces, [1, 5, 7], [1, 7, 3]])


def _colors(faces: Tensor, size: int, seed: int, smooth: float = 0.3) -> Tensor:
    """Make cubes [F, T, T, T, 3]: a random colour for each face, with some variation within it."""
    generator = torch.Generator().manual_seed(seed)
    flat = 0.2 + 0.8 * torch.rand(len(faces), 1, 1, 1, 3, generator=generator)
    return flat * (1 - smooth * torch.rand(len(faces), size, size, size, 3, generator=generator))


def scenes() -> dict[str, Scene]:
    """Make the scenes of the table, by name."""
    eye = torch.tensor([0.7, 0.9, -2.6])
    ball, ball_faces = nr.icosphere(1)
    ball = ball * 0.6
    wall = torch.tensor([[-1.5, -1.5, 0.8], [1.5, -1.5, 0.8], [1.5, 1.5, 0.8], [-1.5, 1.5, 0.8]])
    wall_faces = torch.tensor([[0, 1, 2], [0, 2, 3]]) + len(ball)
    both, both_faces = torch.cat((ball, wall)), torch.cat((ball_faces, wall_faces))
    box, box_faces = _box(torch.tensor([0.55, 0.45, 0.5]))
    turn = torch.linalg.matrix_exp(torch.tensor([[0.0, -0.6, 0.4], [0.6, 0, -0.7], [-0.4, 0.7, 0]]))
    boxes = torch.cat((box, box @ turn.T * 0.8 + torch.tensor([0.35, 0.25, -0.2])))
    boxes_faces = torch.cat((box_faces, box_faces + 8))

    def fixed(faces: Tensor, cubes: Tensor, light: nr.Light | None = None) -> Callable[..., dict]:
        def build(vertices: Tensor, eye: Tensor = eye, **light_parameters: Tensor) -> dict:
            lamp = nr.Light(**light_parameters) if light_parameters else light
            textures = light_parameters.pop("textures", cubes)
            return {"vertices": vertices, "faces": faces, "textures": textures, "eye": eye, "light": lamp}

        return build

    def textured(vertices: Tensor, textures: Tensor) -> dict:
        return {"vertices": vertices, "faces": ball_faces, "textures": textures, "eye": eye, "light": None}

    ball_cubes = _colors(ball_faces, 3, 1)
    return {
        "sphere before a plane": Scene(
            {"vertices": both}, {"vertices": 0.005}, fixed(both_faces, _colors(both_faces, 2, 0), None)
        ),
        "two boxes through each other": Scene(
            {"vertices": boxes}, {"vertices": 0.005}, fixed(boxes_faces, _colors(boxes_faces, 2, 2), None)
        ),
        "textured mesh": Scene(
            {"vertices": ball, "textures": ball_cubes}, {"vertices": 0.005, "textures": 0.1}, textured
        ),
        "camera orbit": Scene(
            {"eye": eye}, {"eye": 0.005}, lambda eye: fixed(both_faces, _colors(both_faces, 2, 0))(both, eye)
        ),
        "light": Scene(
            {"vertices": ball, "direction": torch.tensor([0.4, 0.8, -0.6]), "directional_color": torch.ones(3)},
            {"vertices": 0.005, "direction": 0.02, "directional_color": 0.1},
            fixed(ball_faces, _colors(ball_faces, 2, 3)),
        ),
    }


def draw(scene: dict, size: int, shift: Tensor, gradient: str) -> Tensor:
    """Draw colours [B, 3, size, size] without anti-aliasing, shifted by ``shift`` [B, 2] pixels on the screen."""
    camera = nr.Camera.look_at(scene["eye"], viewing_angle=25)
    screen = camera(scene["vertices"])
    offset = torch.cat((2 * shift / size, torch.zeros(len(shift), 1)), 1)[:, None]
    screen = screen + offset
    textures, light = scene["textures"][None], None
    if scene["light"] is not None:
        light = scene["light"].two_sided(world_corners(scene["vertices"], scene["faces"], 1), camera.mirrored)
    return rasterize_images(
        nr.vertices_to_faces(screen, scene["faces"]),
        size,
        outputs=("rgb",),
        textures=textures,
        light=light,
        background=(0.1, 0.3, 0.2),
        anti_aliasing=False,
        two_sided=True,
        gradient=gradient,
    ).rgb  # type: ignore[return-value]


def loss_weight(size: int, seed: int = 0) -> Tensor:
    """Make weights [3, size, size] of the loss Σ weight · image: smooth over some pixels, of both signs."""
    coarse = torch.randn(1, 3, size // 8, size // 8, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.interpolate(coarse, (size, size), mode="bicubic", align_corners=False)[0]


def difference(scene: Scene, name: str, supersampling: int, most: int | None = None) -> tuple[Tensor, Tensor]:
    """Compute central differences of the loss: the chosen elements of a parameter [N], and the slopes [N] float64."""
    weight = loss_weight(scene.size).double()
    value = scene.parameters[name]
    order = torch.randperm(value.numel(), generator=torch.Generator().manual_seed(0))[: most or value.numel()]
    result = torch.zeros(len(order), dtype=torch.float64)
    for n, k in enumerate(order.tolist()):
        losses = []
        for sign in (1, -1):
            moved = value.flatten().clone()
            moved[k] += sign * scene.steps[name]
            built = scene.build(**{**scene.parameters, name: moved.view(value.shape)})
            fine = draw(built, scene.size * supersampling, torch.zeros(1, 2), "nmr")
            blocks = torch.nn.functional.avg_pool2d(fine.double(), supersampling)
            losses.append((blocks[0] * weight).sum())
        result[n] = (losses[0] - losses[1]) / (2 * scene.steps[name])
    return order, result


def estimates(scene: Scene, gradient: str, shifts: int, seed: int = 1) -> dict[str, Tensor]:
    """Compute each parameter's gradient [shifts, numel] by an estimator, at random sub-pixel shifts."""
    generator = torch.Generator().manual_seed(seed)
    weight = loss_weight(scene.size)
    rows: dict[str, list[Tensor]] = {name: [] for name in scene.parameters}
    side = math.isqrt(shifts)
    cells = torch.cartesian_prod(torch.arange(side), torch.arange(side))
    for shift in (cells + torch.rand(len(cells), 2, generator=generator)) / side - 0.5:
        leaves = {name: value.clone().requires_grad_() for name, value in scene.parameters.items()}
        image = draw(scene.build(**leaves), scene.size, shift[None], gradient)
        found = torch.autograd.grad((image[0] * weight).sum(), list(leaves.values()), allow_unused=True)
        for (name, leaf), part in zip(leaves.items(), found, strict=True):
            rows[name].append((torch.zeros_like(leaf) if part is None else part).flatten())
    return {name: torch.stack(parts) for name, parts in rows.items()}


def plot(rows: list[dict], path: Path) -> None:
    """Plot size and cosine of both estimators, one line for each row of the table, beside the truth."""
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(f"{row['scene']}: {row['of']}" for row in rows))
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 0.28 * len(names) + 1), sharey=True)
    for gradient, marker in (("nmr", "x"), ("edge", "o")):
        own = [row for row in rows if row["gradient"] == gradient]
        places = [names.index(f"{row['scene']}: {row['of']}") for row in own]
        left.plot([row["size"] for row in own], places, marker, label=f'"{gradient}"')
        right.plot([row["cosine"] for row in own], places, marker)
    left.set_xscale("log")
    left.set_xlabel("size (1: the derivative)")
    right.set_xlabel("cosine (1: its direction)")
    left.set_yticks(range(len(names)), names)
    left.invert_yaxis()
    for axes in (left, right):
        axes.axvline(1, color="grey", linewidth=0.8)
        axes.grid(alpha=0.3)
    figure.tight_layout(rect=(0, 0, 1, 0.96))
    figure.legend(loc="upper right", ncols=2, frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gradient_quality", description=__doc__)
    parser.add_argument("--shifts", type=int, default=256, help="sub-pixel offsets")
    parser.add_argument("--supersampling", type=int, default=32)
    parser.add_argument("--elements", type=int, default=60, help="of each parameter that are moved")
    parser.add_argument("--json", type=Path, help="also write the numbers here")
    parser.add_argument("--plot", type=Path, help="also draw them here, as PNG or SVG (needs matplotlib)")
    options = parser.parse_args()
    rows = []
    for side in SIDES:
        for wish in WISHES:
            for gradient in ("nmr", "edge"):
                found = triangle_quality(side, wish, gradient, options.shifts)
                rows.append({"scene": f"triangle of {side} px", "of": wish, "gradient": gradient, **vars(found)})
    for title, scene in scenes().items():
        for name in scene.parameters:
            order, truth = difference(scene, name, options.supersampling, options.elements)
            for gradient in ("nmr", "edge"):
                samples = estimates(scene, gradient, options.shifts)[name][:, order]
                found = Quality.of(samples, truth.expand(len(samples), -1))
                rows.append({"scene": title, "of": name, "gradient": gradient, **vars(found)})
    table = Table(title="Mean gradient against the truth")
    for column in ("scene", "of", "gradient", "size", "cosine", "noise"):
        table.add_column(column, justify="right" if column in ("size", "cosine", "noise") else "left")
    for row in rows:
        table.add_row(*(f"{v:.4f}" if isinstance(v, float) else str(v) for v in row.values()))
    Console().print(table)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")
    if options.plot:
        plot(rows, options.plot)


if __name__ == "__main__":
    main()
