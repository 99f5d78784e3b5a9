"""Scenes against central finite differences of an image drawn at a multiple of the size."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.raster.faces import world_corners

from .adapters import Adapter
from .adapters.ours import mean_loss
from .picture import Picture


@dataclass(frozen=True)
class Scene:
    """Scene with parameters; ``steps`` are the steps of the finite differences.

    Attributes:
        parameters: Tensors, float64.
        steps: For each of them.
        build: Parameters to a `Picture`, differentiable.
        supersampling: Most that fits the memory.
    """

    parameters: dict[str, Tensor]
    steps: dict[str, float]
    build: Callable[..., Picture]
    supersampling: int = 32


def scenes() -> dict[str, Scene]:
    """Make the scenes of the table, by name."""
    eye = torch.tensor([0.7, 0.9, -2.6], dtype=torch.float64)
    ball, ball_faces = nr.icosphere(1)
    ball = ball.double() * 0.6
    wall = torch.tensor([[-1.5, -1.5, 0.8], [1.5, -1.5, 0.8], [1.5, 1.5, 0.8], [-1.5, 1.5, 0.8]]).double()
    both = torch.cat((ball, wall))
    both_faces = torch.cat((ball_faces, torch.tensor([[0, 1, 2], [0, 2, 3]]) + len(ball)))
    box, box_faces = nr.cube()
    box = box.double() * torch.tensor([0.55, 0.45, 0.5]).double()
    turn = torch.linalg.matrix_exp(torch.tensor([[0.0, -0.6, 0.4], [0.6, 0, -0.7], [-0.4, 0.7, 0]]).double())
    boxes = torch.cat((box, box @ turn.T * 0.8 + torch.tensor([0.35, 0.25, -0.2]).double()))
    boxes_faces = torch.cat((box_faces, box_faces + len(box)))
    smooth_ball, smooth_faces = nr.icosphere(2)
    smooth_ball = smooth_ball.double() * 0.6
    many, many_faces = nr.icosphere(4)
    ring, ring_faces = nr.torus(segments=320, sides=160)

    def colored(faces: Tensor, colors: Tensor, size: int = 96) -> Callable[..., Picture]:
        def build(vertices: Tensor, eye: Tensor = eye) -> Picture:
            return project(vertices, faces, colors, eye, size)

        return build

    def textured(vertices: Tensor, colors: Tensor) -> Picture:
        return project(vertices, smooth_faces, colors[smooth_faces], eye, 96)

    def painted(count: int, seed: int) -> Tensor:
        return 0.2 + 0.8 * torch.rand(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)

    def lit(vertices: Tensor, direction: Tensor, directional_color: Tensor) -> Picture:
        light = nr.Light(direction=direction, directional_color=directional_color)
        factors = light.two_sided(world_corners(vertices, ball_faces, 1), False)
        picture = project(vertices, ball_faces, corner_colors(ball_faces, 3), eye, 96)
        front = _front(picture)
        factor = torch.where(front[:, None], factors[0, 0], factors[0, 1])[:, None].double()
        return Picture(picture.vertices, picture.faces, picture.colors * factor, 96)

    found = {
        "occlusion": Scene(
            {"vertices": both}, {"vertices": 0.005}, colored(both_faces, painted(len(both), 0)[both_faces])
        ),
        "crossing faces": Scene(
            {"vertices": boxes}, {"vertices": 0.005}, colored(boxes_faces, painted(len(boxes), 2)[boxes_faces])
        ),
        "smooth texture": Scene(
            {"vertices": smooth_ball, "colors": 0.5 + 0.5 * (6 * smooth_ball).sin()},
            {"vertices": 0.005, "colors": 0.1},
            textured,
        ),
        "light on faces": Scene(
            {
                "vertices": ball,
                "direction": torch.tensor([0.4, 0.8, -0.6]).double(),
                "directional_color": torch.ones(3).double(),
            },
            {"vertices": 0.005, "direction": 0.02, "directional_color": 0.1},
            lit,
        ),
        "camera orbit": Scene(
            {"eye": eye}, {"eye": 0.005}, lambda eye: colored(both_faces, painted(len(both), 0)[both_faces])(both, eye)
        ),
    }
    for width in (0.3, 1.0, 3.0):
        found[f"wire of {width:g} px"] = _flat(*_wire(width), plain=True)
    found["over the border"] = _flat(
        torch.tensor([[-9.3, 22.0, 2], [31.7, -7.1, 2], [38.2, 53.4, 2]]), torch.tensor([[0, 1, 2]])
    )
    found["T-junction"] = _junction()
    for side in (1.0, 2.0):
        found[f"faces of {side:g} px, random colours"] = _flat(*lattice(side), step=0.05)
    for strips in (1, 3):
        found[f"outline behind {strips} strip{'s' * (strips > 1)} of 0.02 px"] = _bevel(strips)
    found[f"{len(many_faces):,} faces of a pixel"] = _orbit(many.double(), many_faces, eye, 64)
    found[f"{len(ring_faces):,} faces of a pixel"] = _orbit(ring.double(), ring_faces, eye, 448, 16)
    return found


def _orbit(vertices: Tensor, faces: Tensor, eye: Tensor, size: int, supersampling: int = 32) -> Scene:
    """Make a scene of faces in random colours whose camera moves."""
    colors = corner_colors(faces, 5, 0.0)
    step = 0.5 / size  # moves the faces by some 0.2 pixels
    return Scene({"eye": eye}, {"eye": step}, lambda eye: project(vertices, faces, colors, eye, size), supersampling)


def project(vertices: Tensor, faces: Tensor, colors: Tensor, eye: Tensor, size: int) -> Picture:
    """Project world vertices; depth on the screen is 2 - 1 / z."""
    x, y, z = nr.Camera.look_at(eye, viewing_angle=25)(vertices)[0].double().unbind(-1)
    places = torch.stack(((x + 1) * size / 2, (y + 1) * size / 2, 2 - 1 / z), -1)
    return Picture(places, faces, colors.double(), size)


def corner_colors(faces: Tensor, seed: int, smooth: float = 0.3) -> Tensor:
    """Make colours [F, 3, 3] of corners: a random one for each face, with some variation within it."""
    generator = torch.Generator().manual_seed(seed)
    flat = 0.2 + 0.8 * torch.rand(len(faces), 1, 3, generator=generator, dtype=torch.float64)
    return flat * (1 - smooth * torch.rand(len(faces), 3, 3, generator=generator, dtype=torch.float64))


def lattice(side: float, size: int = 48) -> tuple[Tensor, Tensor]:
    """Make a disc of nearly equilateral triangles with jittered corners: vertices [V, 3] and faces."""
    count = int(1.6 * size / side) + 2
    row, column = torch.meshgrid(torch.arange(count), torch.arange(count), indexing="ij")
    points = torch.stack((column + 0.5 * (row % 2), row * math.sqrt(3) / 2), -1).double().view(-1, 2) * side
    points = points + 0.3 * side * (torch.rand(points.shape, generator=torch.Generator().manual_seed(0)).double() - 0.5)
    angle = torch.tensor(0.3)
    turn = torch.tensor([[angle.cos(), angle.sin()], [-angle.sin(), angle.cos()]]).double()
    points = (points - points.mean(0)) @ turn + size / 2
    v = (row * count + column)[:-1, :-1].flatten()
    odd = (row[:-1, :-1] % 2).flatten()[:, None].bool()
    lower = torch.where(odd, torch.stack((v, v + 1, v + count + 1), 1), torch.stack((v, v + 1, v + count), 1))
    upper = torch.where(
        odd, torch.stack((v, v + count + 1, v + count), 1), torch.stack((v + 1, v + count + 1, v + count), 1)
    )
    faces = torch.cat((lower, upper))
    faces = faces[((points - size / 2).norm(dim=1) < size / 2 - 6)[faces].all(1)]
    used, faces = faces.unique(return_inverse=True)
    return torch.nn.functional.pad(points[used], (0, 1), value=2.0), faces


def _flat(places: Tensor, faces: Tensor, step: float = 0.2, plain: bool = False) -> Scene:
    """Make a scene of triangles on the screen whose corners move; depth is fixed."""
    depth = places[:, 2:].double()
    colors = torch.ones(len(faces), 3, 3).double() if plain else corner_colors(faces, 4, 0.0)

    def build(places: Tensor) -> Picture:
        return Picture(torch.cat((places, depth), 1), faces, colors, 48)

    return Scene({"places": places[:, :2].double()}, {"places": step}, build)


def _wire(width: float) -> tuple[Tensor, Tensor]:
    along = torch.tensor([math.cos(0.4), math.sin(0.4)])
    across = torch.tensor([-along[1], along[0]]) * width / 2
    ends = torch.tensor([24.0, 24]) + torch.tensor([[-18.0], [18]]) * along
    places = torch.stack((ends[0] - across, ends[1] - across, ends[1] + across, ends[0] + across))
    return torch.nn.functional.pad(places, (0, 1), value=2.0), torch.tensor([[0, 1, 2], [0, 2, 3]])


def _bevel(strips: int) -> Scene:
    """Make a square whose right side ends in a rim of strips, each 0.02 pixels wide; it moves rigidly."""
    square = torch.tensor([[10.3, 9.2, 2.0], [9.6, 36.4, 2]]).double()
    rims = [
        torch.tensor([[33.4, 10.1, 2], [32.7, 37.2, 2]]) + n * torch.tensor([0.02, 0, 0.2]) for n in range(strips + 1)
    ]
    places = torch.cat((square, *(rim.double() for rim in rims)))  # pairs: the lower end, the upper end
    lower = 2 * torch.arange(strips + 1)
    faces = torch.cat((torch.stack((lower, lower + 2, lower + 3), 1), torch.stack((lower, lower + 3, lower + 1), 1)))

    def build(move: Tensor) -> Picture:
        moved = torch.cat((places[:, :2] + move, places[:, 2:]), 1)
        return Picture(moved, faces, torch.ones(len(faces), 3, 3).double(), 48)

    return Scene({"move": torch.zeros(2).double()}, {"move": 0.2}, build)


def _junction() -> Scene:
    """Make a long edge that meets two short ones at its middle, a T-junction; the corner there stays on the edge."""
    free = torch.tensor([[6.2, 5.1], [24.3, 6.0], [23.1, 42.7], [7.4, 40.2], [42.1, 23.8]]).double()
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [1, 4, 5], [5, 4, 2]])
    colors = corner_colors(faces, 4, 0.0)

    def build(places: Tensor) -> Picture:
        corners = torch.cat((places, (places[1:2] + places[2:3]) / 2))
        return Picture(torch.nn.functional.pad(corners, (0, 1), value=2.0), faces, colors, 48)

    return Scene({"places": free}, {"places": 0.2}, build)


def _front(picture: Picture) -> Tensor:
    """Test for each face whether its corners run counter-clockwise on the screen, [F] bool."""
    p, q, r = picture.vertices.detach()[picture.faces, :2].unbind(1)
    a, b = q - p, r - p
    return a[:, 0] * b[:, 1] > a[:, 1] * b[:, 0]


def loss_weight(size: int, seed: int = 0) -> Tensor:
    """Make weights [3, size, size] of the loss Σ weight · image: smooth over some pixels, of both signs."""
    coarse = torch.randn(1, 3, size // 8, size // 8, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.interpolate(coarse, (size, size), mode="bicubic", align_corners=False)[0].double()


def difference(scene: Scene, name: str, supersampling: int, most: int | None = None) -> tuple[Tensor, Tensor]:
    """Compute central differences of the mean loss over shifts.

    Returns:
        The chosen elements of a parameter [N], and the slopes [N] float64.
    """
    supersampling = min(supersampling, scene.supersampling)
    value = scene.parameters[name]
    order = torch.randperm(value.numel(), generator=torch.Generator().manual_seed(0))[: most or value.numel()]
    result = torch.zeros(len(order), dtype=torch.float64)
    weight = None
    for n, k in enumerate(order.tolist()):
        losses = []
        for sign in (1, -1):
            moved = value.flatten().clone()
            moved[k] += sign * scene.steps[name]
            picture = scene.build(**{**scene.parameters, name: moved.view(value.shape)})
            weight = loss_weight(picture.size) if weight is None else weight
            losses.append(mean_loss(picture, weight, supersampling))
        result[n] = (losses[0] - losses[1]) / (2 * scene.steps[name])
    return order, result


def estimates(scene: Scene, adapter: Adapter, shifts: int, seed: int = 1) -> dict[str, Tensor]:
    """Compute each parameter's gradient [shifts, numel] by a renderer, at random sub-pixel shifts."""
    generator = torch.Generator().manual_seed(seed)
    leaves = {name: value.clone().requires_grad_() for name, value in scene.parameters.items()}
    picture = scene.build(**leaves)
    still, weight = picture.detached(), loss_weight(picture.size)
    rows: dict[str, list[Tensor]] = {name: [] for name in leaves}
    side = math.isqrt(shifts)
    cells = torch.cartesian_prod(torch.arange(side), torch.arange(side))
    for shift in (cells + torch.rand(len(cells), 2, generator=generator)) / side - 0.5:
        _, to_vertices, to_colors = adapter.draw(still.moved(shift), weight)
        moving = [(picture.vertices, to_vertices), (picture.colors, to_colors)]
        moving = [(own, to.to(own.dtype)) for own, to in moving if own.requires_grad]
        found = torch.autograd.grad(
            [own for own, _ in moving], list(leaves.values()), [to for _, to in moving],
            allow_unused=True, retain_graph=True,
        )  # fmt: skip
        for (name, leaf), part in zip(leaves.items(), found, strict=True):
            rows[name].append((torch.zeros_like(leaf) if part is None else part).flatten())
    return {name: torch.stack(parts) for name, parts in rows.items()}
