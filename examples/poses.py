"""Poses of two objects that hide each other, and of an object together with the plane that it stands on.

    python examples/poses.py -o poses.png

One picture holds the whole scene, and Gauss-Newton moves all of its numbers at once: what hides what follows from the
drawing. The start is a rough guess, such as `nr.find_pose` gives for each object alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.rotations import from_axis_angle

DATA = Path(__file__).resolve().parent / "data"
SIZE, STEPS = 128, 25
CAMERA = nr.Camera.look_at((0.0, 0.0, 6.0), viewing_angle=20)
LIGHT = nr.Light(direction=(0.4, 0.8, 0.6))

Part = tuple[Tensor, Tensor, Tensor]  # vertices [V, 3], faces [F, 3] and colours of their corners [F, 3, 3]


def part(name: str, color: tuple[float, float, float]) -> Part:
    """Load a mesh of one colour."""
    vertices, faces = nr.load_obj(DATA / name)
    return vertices, faces, torch.tensor(color).expand(len(faces), 3, 3)


def board(cells: int = 8) -> Part:
    """Make a chequered plane of 4 x 4 units at height 0, which is the objects' lowest point."""
    at = torch.linspace(-2, 2, cells + 1)
    x, z = torch.meshgrid(at, at, indexing="ij")
    vertices = torch.stack((x, torch.zeros_like(x), z), -1).flatten(0, 1)
    i, j = torch.meshgrid(torch.arange(cells), torch.arange(cells), indexing="ij")
    first = (i * (cells + 1) + j).flatten()
    quads = torch.stack((first, first + 1, first + cells + 2, first, first + cells + 2, first + cells + 1), 1)
    gray = torch.where(((i + j) % 2 == 0).flatten(), 0.9, 0.35).repeat_interleave(2)
    return vertices, quads.reshape(-1, 3).int(), gray[:, None, None].expand(-1, 3, 3)


def drawn(parts: list[Part], poses: Tensor) -> Tensor:
    """Draw parts in poses [N, 6], rotation vectors and places: [1, 3, H, W]."""
    vertices, faces, colors = zip(*parts, strict=True)
    moved = [own @ from_axis_angle(pose[:3]).T + pose[3:] for own, pose in zip(vertices, poses, strict=True)]
    first = [sum(len(own) for own in vertices[:n]) for n in range(len(parts))]
    joined = torch.cat([own + n for own, n in zip(faces, first, strict=True)])
    return nr.render((torch.cat(moved), joined, torch.cat(colors)), CAMERA, SIZE, light=LIGHT).rgb


def solved(draw: Callable[[Tensor], Tensor], truth: Tensor, start: Tensor, name: str) -> Tensor:
    """Fit numbers to their picture; return the picture, the start and the result side by side, [3, H, 3 W]."""
    with torch.no_grad():
        target, before = draw(truth), draw(start)
    found = start.clone()
    optimizer = nr.optim.GaussNewton([found], loss="huber", scale=0.2)
    for _ in range(STEPS):
        loss = optimizer.step(lambda numbers: nr.optim.pyramid(draw(numbers) - target, levels=6))
    print(f"{name}: loss {float(loss):.4f}, largest error {float((found - truth).abs().max()):.4f}")
    with torch.no_grad():
        return torch.cat((target, before, draw(found)), 3)[0]


def main() -> None:
    """Solve both scenes, and save their pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("poses.png"))
    output = parser.parse_args().output
    cow, pot = part("spot.obj", (0.8, 0.7, 0.5)), part("teapot.obj", (0.4, 0.6, 0.8))
    poses = torch.tensor([[0.1, 2.4, 0.0, -0.3, 0.0, 0.0], [0.3, 0.5, 0.1, 0.5, -0.3, 0.9]])
    rough = poses + torch.tensor([[0.1, -0.2, 0.1, -0.1, 0.1, 0.1], [-0.1, 0.2, 0.1, 0.1, 0.1, -0.1]])
    two = solved(lambda numbers: drawn([cow, pot], numbers), poses, rough, "two objects, 12 numbers")

    standing = cow[0] - torch.tensor([0.0, 1.0, 0.0]) * cow[0][:, 1].min(), *cow[1:]

    def on_plane(numbers: Tensor) -> Tensor:
        """Draw the cow on the plane: tilt of the plane about x and z, its height; the cow's turn and place on it."""
        tilt_x, tilt_z, height, turn, x, z = numbers
        zero = torch.zeros_like(turn)
        plane = from_axis_angle(torch.stack((tilt_x, zero, tilt_z)))
        turned = standing[0] @ from_axis_angle(torch.stack((zero, turn, zero))).T + torch.stack((x, zero, z))
        lift = torch.stack((zero, height, zero))
        parts = [(own @ plane.T, *rest) for own, *rest in ((turned, *standing[1:]), board())]
        return drawn(parts, torch.cat((zero.expand(2, 3), lift.expand(2, 3)), 1))

    truth = torch.tensor([0.5, 0.1, -0.7, 2.2, 0.3, 0.2])
    start = truth + torch.tensor([0.1, -0.08, 0.1, -0.25, -0.15, 0.15])
    plane = solved(on_plane, truth, start, "an object on a plane, 6 numbers")
    nr.save_image(output, torch.cat((two, plane), 1))
    print(f"truth, start and result of both scenes: {output}")


if __name__ == "__main__":
    main()
