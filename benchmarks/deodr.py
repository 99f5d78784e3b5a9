"""Comparison with DEODR, a differentiable rasteriser in C++: ``python -m benchmarks.deodr``.

Both draw the same one-sided spheres with colours at the vertices from an orthographic camera (DEODR's backward has no
perspective), and compute gradients to vertices and colours. DEODR gets vertices on the screen and the edges of the
silhouette; ours starts from vertices in space and finds the visible edges itself. The images are compared first.

Needs ``pip install deodr``; otherwise it ends with a message. Times are processor times, the least of several rounds in
which both take turns; each job runs twice in a row, and the second run counts. DEODR has one thread.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import time
from collections.abc import Callable

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

import neural_renderer as nr

# (images, side, icosphere level)
SCENES = [(64, 128, 3), (8, 256, 3), (1, 512, 6), (1, 1024, 7)]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.deodr", description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    table = compare(options.rounds)
    Console(width=140).print(table or "DEODR is not installed: pip install deodr, to compare with it")


def is_installed() -> bool:
    return importlib.util.find_spec("deodr") is not None


def compare(rounds: int) -> Table | None:
    """Measure all scenes; return the table, or None without DEODR."""
    if not is_installed():
        return None
    table = Table(title="colour at vertices, processor time in ms: forward | forward + backward")
    for column in ("scene", "faces", "DEODR", "ours, 1 thread", "DEODR / ours", "2 threads, passed", "faster by 2"):
        table.add_column(column, justify="right")
    for images, side, level in SCENES:
        scene = Scene(images, side, level)
        different = scene.different_pixels()
        if different > 2e-2 * images * side**2:
            raise RuntimeError(f"{images} x {side}²: expected equal images, got {different} pixels that differ")
        jobs = [
            (1, lambda s=scene: s.theirs(False)), (1, lambda s=scene: s.theirs(True)),
            (1, lambda s=scene: s.ours(False)), (1, lambda s=scene: s.ours(True)),
            (2, lambda s=scene: s.ours(False)), (2, lambda s=scene: s.ours(True)),
        ]  # fmt: skip
        best = least(jobs, rounds)
        used, passed = [[time[k] for time in best] for k in (0, 1)]
        table.add_row(
            f"{images} × {side}²", str(20 * 4**level), _pair(used[:2]), _pair(used[2:4]),
            _pair([a / b for a, b in zip(used[:2], used[2:4], strict=True)], 2), _pair(passed[4:6]),
            _pair([a / b for a, b in zip(passed[2:4], passed[4:6], strict=True)], 2),
        )  # fmt: skip
    return table


def least(jobs: list[tuple[int, Callable[[], object]]], rounds: int) -> list[tuple[float, float]]:
    """Measure milliseconds (processor, wall clock) of each job; every round runs all jobs."""
    best = [(math.inf, math.inf)] * len(jobs)
    before = torch.get_num_threads()
    for turn in range(rounds + 1):
        for n, (threads, job) in enumerate(jobs):
            torch.set_num_threads(threads)
            job()  # so that its memory is in the processor's cache, as in a loop, whatever ran before
            used, passed = time.process_time(), time.perf_counter()
            job()
            taken = 1e3 * (time.process_time() - used), 1e3 * (time.perf_counter() - passed)
            if turn > 0:  # the first warms up
                best[n] = min(best[n][0], taken[0]), min(best[n][1], taken[1])
    torch.set_num_threads(before)
    return best


class Scene:
    """Scene of noisy spheres, one per image, with random colours at the vertices."""

    def __init__(self, images: int, side: int, level: int) -> None:
        from deodr.triangulated_mesh import TriMeshAdjacencies

        self.side = side
        generator = torch.Generator().manual_seed(0)
        vertices, faces = nr.icosphere(level)
        push = 1 + 0.1 * torch.rand(images, len(vertices), 1, generator=generator)
        self.faces = faces
        self.vertices = (0.7 * vertices * push).requires_grad_()
        self.colors = torch.rand(images, len(vertices), 3, generator=generator).requires_grad_()
        self.grad = torch.randn(images, 3, side, side, generator=generator)
        self.camera = nr.Camera.look_at((0.0, 0.0, -2.0), orthographic=True)
        with torch.no_grad():
            screen = self.camera(self.vertices.detach())
        self.adjacencies = TriMeshAdjacencies(faces.numpy().astype(np.uint32), clockwise=False)
        self.scenes = [self._deodr(points, colors) for points, colors in zip(screen, self.colors, strict=True)]
        self.buffers = np.zeros((side, side, 3)), np.zeros((side, side))
        self.image_grads = np.ascontiguousarray(self.grad.permute(0, 2, 3, 1).double().numpy())

    def _deodr(self, screen: Tensor, colors: Tensor):  # type: ignore[no-untyped-def]
        from deodr.differentiable_renderer import Scene2D

        faces, side = self.faces.numpy().astype(np.uint32), self.side
        points = screen.double().numpy()
        ij = np.stack([(side * points[:, 0] + side - 1) / 2, side - 1 - (side * points[:, 1] + side - 1) / 2], 1)
        count, shape = len(points), (len(faces),)
        edges = np.ascontiguousarray(self.adjacencies.edge_on_silhouette(ij))
        return Scene2D(
            faces, np.zeros_like(faces), ij, points[:, 2].copy(), np.zeros(shape, bool), np.zeros((1, 2)),
            np.zeros(count), colors.detach().double().numpy(), np.zeros(shape, bool), edges, side, side, 3,
            np.zeros((0, 0, 3)), background_color=np.zeros(3), clockwise=False, backface_culling=True,
        )  # fmt: skip

    def theirs(self, backward: bool) -> None:
        """Draw into one image repeatedly; ours makes an image for each call."""
        from deodr.differentiable_renderer import renderScene, renderSceneB

        image, depth = self.buffers
        for scene, grad in zip(self.scenes, self.image_grads, strict=True):
            renderScene(scene, 1.0, image, depth, check_valid=False)
            if backward:
                scene.clear_gradients()
                renderSceneB(scene, 1.0, image, depth, grad, check_valid=False)

    def ours(self, backward: bool) -> Tensor:
        self.vertices.grad = self.colors.grad = None
        with torch.set_grad_enabled(backward):
            mesh = (self.vertices, self.faces)
            fragments = nr.fragments(
                mesh, self.camera, self.side, anti_aliasing=False, two_sided=False, gradient="edge"
            )
            images = fragments.composite(fragments.interpolate(self.colors))
        if backward:
            images.backward(self.grad)
        return images

    def different_pixels(self) -> int:
        """Count the pixels that differ, except at edges, because DEODR smooths them over a pixel."""
        theirs = []
        for scene in self.scenes:
            flags, scene.edgeflags = scene.edgeflags, np.zeros_like(scene.edgeflags)
            theirs.append(scene.render(1.0)[0])
            scene.edgeflags = flags
        difference = np.abs(np.stack(theirs) - self.ours(False).permute(0, 2, 3, 1).numpy())
        return int((difference.max(-1) > 1e-3).sum())


def _pair(numbers: list[float], digits: int = 1) -> str:
    return " | ".join(f"{number:.{digits}f}" for number in numbers)


if __name__ == "__main__":
    main()
