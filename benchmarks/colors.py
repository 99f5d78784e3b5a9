"""Colour against interpolated attributes of the same scene: ``python -m benchmarks.colors``.

The ratio is the processor time of `render`, forward and backward on one thread, over that of ``fragments``, its
``interpolate`` and ``composite`` with the same colours at the vertices. Vertices receive gradients, colours and
textures do not, unless a row says so. Both sides take turns, and the least time of each counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator

import torch

import neural_renderer as nr

from .deodr import least

# (images, side, icosphere level)
SCENES = [(1, 32, 1), (64, 128, 3), (8, 256, 3), (1, 512, 6)]
KINDS = {
    "silhouettes": "", "vertex colours": "≤ 1.1", "face colours": "≤ 1.1", "cubes, T = 2": "≤ 1.2",
    "cubes, T = 4": "≤ 1.5", "texture image": "≤ 1.5",
}  # fmt: skip
LIGHT = nr.Light(0.5, 0.5)

Row = tuple[str, str, str]  # subject, measured, goal


class Scene:
    """Scene of one noisy sphere and several cameras, with random colours."""

    def __init__(self, images: int, side: int, level: int) -> None:
        generator = torch.Generator().manual_seed(0)
        self.name = f"{images} × {side}², {20 * 4**level:,} faces"
        sphere, self.faces = nr.icosphere(level)
        push = 1 + 0.1 * torch.rand(len(sphere), 1, generator=generator)
        self.vertices = (0.7 * sphere * push).requires_grad_()
        self.colors = torch.rand(len(sphere), 3, generator=generator)
        count = len(self.faces)
        self.meshes: dict[str, object] = {
            "silhouettes": (self.vertices, self.faces),
            "vertex colours": nr.Mesh(self.vertices, self.faces, vertex_colors=self.colors),
            "face colours": nr.Mesh(self.vertices, self.faces, face_colors=torch.rand(count, 3, generator=generator)),
        }
        for size in (2, 4):
            cubes = torch.rand(count, size, size, size, 3, generator=generator)
            self.meshes[f"cubes, T = {size}"] = nr.Mesh(self.vertices, self.faces, cubes)
        uv = 0.5 + 0.5 * self.vertices.detach()[self.faces.long()][..., :2]
        image = torch.rand(256, 256, 3, generator=generator)
        self.meshes["texture image"] = nr.UVMesh(self.vertices, self.faces, uv, image)
        self.grad = torch.randn(images, 3, side, side, generator=generator)
        eye = nr.get_points_from_angles(2.732, 20.0, torch.arange(images) * (360.0 / images))
        self.camera = nr.Camera.look_at(eye, viewing_angle=20.0)
        self.size = side

    def attributes(self, anti_aliasing: bool = False) -> Callable[[], None]:
        """Interpolate colours of vertices, forward and backward."""
        options = {"size": self.size, "anti_aliasing": anti_aliasing, "two_sided": False}

        def run() -> None:
            self.vertices.grad = None
            fragments = nr.fragments((self.vertices, self.faces), self.camera, **options)
            fragments.composite(fragments.interpolate(self.colors)).backward(self.grad)

        return run

    def step(self, kind: str, light: nr.Light | None = None, **options: object) -> Callable[[], None]:
        """Render one of KINDS, forward and backward."""
        given = {"size": self.size, "anti_aliasing": False, "two_sided": False, "light": light} | options
        outputs = ("alpha",) if kind == "silhouettes" else ("rgb",)
        grad = self.grad[:, 0].contiguous() if kind == "silhouettes" else self.grad

        def run() -> None:
            self.vertices.grad = None
            drawn = nr.render(self.meshes[kind], self.camera, outputs=outputs, **given)
            getattr(drawn, outputs[0]).backward(grad)

        return run


def rows(rounds: int) -> Iterator[Row]:
    """Measure all ratios of colour."""
    for case in SCENES:
        scene = Scene(*case)
        each = rounds * (20 if case[1] < 64 else 1)
        kinds = list(KINDS)
        jobs = [scene.attributes()]
        jobs += [scene.step(kind) for kind in kinds] + [scene.step(kind, LIGHT) for kind in kinds[1:]]
        attributes, *times = (used for used, _ in least([(1, job) for job in jobs], each))
        yield f"attributes, {scene.name}, ms", f"{attributes:.2f}", ""
        lit = [None, *times[len(kinds) :]]
        for kind, plain, under in zip(kinds, times, lit, strict=False):
            measured = f"{plain / attributes:.2f}" + ("" if under is None else f" | {under / attributes:.2f}")
            yield f"{kind} ÷ attributes, {scene.name}, unlit | lit", measured, KINDS[kind]
    for case in SCENES[1:]:
        scene = Scene(*case)
        for kind in ("silhouettes", "vertex colours", "cubes, T = 4", "texture image"):
            jobs = [scene.step(kind, anti_aliasing=smooth) for smooth in (True, False)]
            (smooth, _), (plain, _) = least([(1, job) for job in jobs], rounds)
            yield f"anti-aliased ÷ plain, {kind}, {scene.name}", f"{smooth / plain:.2f}", "≤ 1.8"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.colors", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    print("| subject | measured | goal |\n|---|---:|---:|")
    for row in rows(parser.parse_args().rounds):
        print("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |", flush=True)
