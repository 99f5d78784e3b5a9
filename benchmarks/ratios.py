"""Speed ratios of colour, texture images and both estimators: a part of ``python -m benchmarks``.

A ratio compares processor times on one thread, forward and backward. Both sides take turns, and the least time of each
side is used, so that other programs on the machine matter little. Every row names its estimator. First use and peak
memory are measured in separate processes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial

import torch

import neural_renderer as nr
import neural_renderer.nvdiffrast as dr

from .deodr import SCENES as DEODR_SCENES
from .deodr import Scene, is_installed, least

Row = tuple[str, str, str]  # subject, measured, goal


def all_ratios(rounds: int, large: bool) -> Iterator[Row]:
    """Measure all rows; ``large`` adds meshes of 1.3 million faces with both estimators."""
    for what, one_mesh, images, side, level in (
        ("64 cameras, 128²", True, 64, 128, 3),
        ("64 meshes, 128²", False, 64, 128, 3),
        ("1 camera, 512², 82k faces", True, 1, 512, 6),
    ):
        for gradient, asked in (("nmr", "1.6"), ("edge", "2")):
            scene = _Scene(images, side, level, one_mesh, gradient)
            ratio = _ratio(scene.step("rgb"), scene.step("alpha"), rounds)
            yield f'colour ÷ silhouettes, "{gradient}", {what}', f"{ratio:.2f}", f"≤ {asked}"
    for gradient in ("nmr", "edge"):
        scene = _Scene(8, 128, 4, True, gradient)
        ratio = _ratio(scene.step("rgb", images=True), scene.step("rgb"), rounds)
        yield f'UVMesh ÷ cubes, "{gradient}", 8 cameras, 128², 5k faces', f"{ratio:.2f}", "≤ 1.3"
    if large:
        scenes = [_Scene(1, 1024, 8, True, gradient) for gradient in ("edge", "nmr")]
        for output in ("alpha", "rgb"):
            ratio = _ratio(*(scene.step(output) for scene in scenes), 3)
            yield f'"edge" ÷ "nmr", {output}, 1024², 1.3 M faces', f"{ratio:.2f}", "≤ 1.5"
    yield from _as_nvdiffrast(rounds)
    for level, side in ((4, 256), (6, 512)):
        for output in ("alpha", "rgb"):
            faces = f"{20 * 4**level:,}"
            ratio = _columns(level, side, output, rounds)
            yield (
                f'six columns of a camera ÷ backward, "edge", {output}, {side}², {faces} faces',
                f"{ratio:.2f}",
                "≤ 2.5",
            )
    yield from _against_deodr(rounds)
    yield from _small(20 * rounds)
    yield from _beside_others()
    yield from _in_own_process()


class _Scene:
    """Scene of one noisy sphere and several cameras, or one sphere per camera, with cubes of 2³ texels and a light."""

    def __init__(self, images: int, side: int, level: int, one_mesh: bool, gradient: str) -> None:
        generator = torch.Generator().manual_seed(0)
        vertices, self.faces = nr.icosphere(level)
        meshes = () if one_mesh else (images,)
        push = 1 + 0.1 * torch.rand(*meshes, len(vertices), 1, generator=generator)
        self.vertices = (0.7 * vertices * push).requires_grad_()
        self.cubes = torch.rand(*meshes, len(self.faces), 2, 2, 2, 3, generator=generator).requires_grad_()
        self.image = torch.rand(256, 256, 3, generator=generator).requires_grad_()
        self.grad = torch.randn(images, 3, side, side, generator=generator)
        eye = nr.get_points_from_angles(2.732, 20.0, torch.arange(images) * (360.0 / images))
        self.camera = nr.Camera.look_at(eye, viewing_angle=20.0)
        self.options = {"size": side, "anti_aliasing": False, "gradient": gradient}

    def step(self, output: str, images: bool = False, backward: bool = True) -> Callable[[], None]:
        """Run forward and backward for one output; ``images`` takes colours from a texture image instead of cubes."""
        mesh: object = (self.vertices, self.faces, self.cubes) if output == "rgb" else (self.vertices, self.faces)
        if images:
            count = len(self.faces)
            uv = 0.5 + 0.5 * self.vertices.detach()[self.faces.long()][..., :2]
            none = torch.zeros(count, dtype=torch.long)
            mesh = nr.UVMesh(self.vertices, self.faces, uv, none, (self.image,), torch.ones(count, 3, 3), ("repeat",))
        grad = self.grad if output == "rgb" else self.grad[:, 0].contiguous()

        def run() -> None:
            for leaf in (self.vertices, self.cubes, self.image):
                leaf.grad = None
            with torch.set_grad_enabled(backward):
                drawn = getattr(nr.render(mesh, self.camera, outputs=(output,), **self.options), output)
            if backward:
                drawn.backward(grad)

        return run


def _columns(level: int, side: int, output: str, rounds: int) -> float:
    """Compare what forward mode adds to a forward pass, for six directions at once, with what backward adds."""
    scene = _Scene(1, side, level, True, "edge")
    mesh = (scene.vertices.detach(), scene.faces, scene.cubes.detach())
    places = torch.tensor([0.0, 0.0, -2.7, 0.0, 0.0, 0.0])

    def draw(places: torch.Tensor) -> torch.Tensor:
        camera = nr.Camera.look_at(places[:3], places[3:], viewing_angle=20.0)
        image: torch.Tensor = getattr(nr.render(mesh, camera, side, outputs=(output,)), output)
        return image

    leaf = places.clone().requires_grad_()
    grad = torch.randn(draw(places).shape, generator=torch.Generator().manual_seed(0))
    jobs = (
        lambda: draw(places),
        lambda: torch.func.jacfwd(draw)(places),
        lambda: torch.autograd.grad(draw(leaf), leaf, grad),
    )
    forward, columns, step = (used for used, _ in least([(1, job) for job in jobs], rounds))
    return (columns - forward) / (step - forward)


def _ratio(one: Callable[[], None], other: Callable[[], None], rounds: int) -> float:
    (first, _), (second, _) = least([(1, one), (1, other)], rounds)
    return first / second


def _as_nvdiffrast(rounds: int) -> Iterator[Row]:
    """Measure the four primitives under nvdiffrast's names against the same image in the modern way."""
    side, (vertices, faces) = 512, nr.icosphere(6)
    vertices, texture = (0.9 * vertices).requires_grad_(), torch.rand(512, 512, 3, requires_grad=True)
    uv, triangles = (0.5 + 0.5 * vertices.detach()[:, :2]).contiguous(), faces.int()
    camera = torch.tensor([[1.5, 0, 0, 0], [0, 1.5, 0, 0], [0, 0, -1.02, 2.042], [0, 0, -1, 2.2]])
    context, grad = dr.RasterizeCudaContext(), torch.randn(3, side, side)

    def theirs() -> None:
        pos = torch.nn.functional.pad(vertices, (0, 1), value=1.0)[None] @ camera.T
        rast, rast_db = dr.rasterize(context, pos, triangles, (side, side))
        texc, change = dr.interpolate(uv[None], rast, triangles, rast_db, "all")
        color = torch.where(rast[..., 3:] > 0, dr.texture(texture[None], texc, change), 0.0)
        torch.autograd.grad(dr.antialias(color, rast, pos, triangles)[0], (vertices, texture), grad.permute(1, 2, 0))

    def modern(anti_aliasing: bool) -> None:
        fragments = nr.fragments((vertices, faces), nr.Camera.from_clip(camera), side, anti_aliasing=anti_aliasing)
        color = nr.sample_texture(texture, fragments.interpolate(uv), fragments.face_index)
        torch.autograd.grad(fragments.composite(color)[0], (vertices, texture), grad)

    for sampled, what in ((False, "1 sample"), (True, "2 × 2 samples, the default")):
        ratio = _ratio(theirs, partial(modern, sampled), rounds)
        yield f'as nvdiffrast ÷ modern, "edge", {what}, 512², 82k faces', f"{ratio:.2f}", "≤ 1.3"


def _against_deodr(rounds: int) -> Iterator[Row]:
    if not is_installed():
        yield "DEODR ÷ ours", "DEODR is not installed: pip install deodr", "≥ 1.2"
        return
    for images, side, level in DEODR_SCENES:
        scene = Scene(images, side, level)
        jobs = [(scene.theirs, False), (scene.ours, False), (scene.theirs, True), (scene.ours, True)]
        best = least([(1, lambda job=job: job[0](job[1])) for job in jobs], rounds)
        forward, both = best[0][0] / best[1][0], best[2][0] / best[3][0]
        what = f'DEODR ÷ ours, "edge", {images} × {side}², {20 * 4**level:,} faces, forward | + backward'
        yield what, f"{forward:.2f} | {both:.2f}", "≥ 1.2"


def _small(rounds: int) -> Iterator[Row]:
    """Measure milliseconds of the wall clock, with all of torch's threads."""
    threads = torch.get_num_threads()
    for gradient in ("nmr", "edge"):
        scene = _Scene(1, 32, 1, True, gradient)
        steps = [scene.step(output, backward=both) for output in ("alpha", "rgb") for both in (False, True)]
        passed = [time for _, time in least([(threads, step) for step in steps], rounds)]
        for name, (forward, both), asked in (
            ("silhouette", passed[:2], "≤ – | 0.25"),
            ("colour", passed[2:], "≤ – | 0.6"),
        ):
            what = f'80 faces, 32², {name}, "{gradient}", ms, forward | + backward'
            yield what, f"{forward:.2f} | {both:.2f}", asked


def _beside_others() -> Iterator[Row]:
    step = _Scene(8, 256, 3, True, "nmr").step("alpha")
    threads = torch.get_num_threads()
    alone = _median(step, threads)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        beside = _median(step, threads)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    yield '8 silhouettes, 256², "nmr", time passed beside two busy programs ÷ alone', f"{beside / alone:.2f}", "≤ 2.2"


def _median(step: Callable[[], None], threads: int) -> float:
    return sorted(least([(threads, step)], 1)[0][1] for _ in range(15))[7]


# Program that takes one step, and prints its seconds, those of all processors, and its peak memory.
_STEP = """
import resource, sys, time, torch
from pathlib import Path
import neural_renderer as nr
level, size, outputs, gradient, anti_aliasing, backward = eval(sys.argv[1])
vertices, faces = nr.icosphere(level)
vertices.requires_grad_(backward)
cubes = torch.rand(len(faces), 2, 2, 2, 3).requires_grad_(backward)
camera = nr.Camera.look_at((0.0, 0.0, -2.732))
started, used = time.perf_counter(), time.process_time()
mesh = (vertices, faces, cubes) if "rgb" in outputs else (vertices, faces)
images = nr.render(mesh, camera, size, outputs=outputs, gradient=gradient, anti_aliasing=anti_aliasing)
if backward:
    sum(image.sum() for image in images if image is not None).backward()
passed, used = time.perf_counter() - started, time.process_time() - used
status = Path("/proc/self/status")
kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
if status.exists():  # on Linux the number above may be that of the process that started this one
    kilobytes = int(status.read_text().split("VmHWM:")[1].split()[0])
print(passed, used, kilobytes / 1e6)
"""


def _in_own_process() -> Iterator[Row]:
    if sys.platform == "win32":
        return
    for what, gradient, backward, asked in (
        ("render", "edge", False, "≤ 3"),
        ('render and backward, "edge"', "edge", True, ""),
        ('render and backward, "nmr"', "nmr", True, ""),
    ):
        with tempfile.TemporaryDirectory() as cache:
            case = (2, 64, ("rgb", "alpha", "depth"), gradient, True, backward)
            (passed, used, _), (cached, _, _) = [_own_process(case, WARP_CACHE_PATH=cache) for _ in range(2)]
        what = f"first {what}, s: kernels compiled (of all processors) | in the cache"
        yield what, f"{passed:.1f} ({used:.1f}) | {cached:.2f}", asked
    for output, asked in (("rgb", "1.8"), ("alpha", "1.2")):
        for gradient in ("edge", "nmr"):
            *_, peak = _own_process((8, 1024, (output,), gradient, True, True))
            what = f'peak memory, {output}, "{gradient}", 1024² anti-aliased, 1.3 M faces, GB'
            yield what, f"{peak:.2f}", f"≤ {asked}"


def _own_process(case: tuple[object, ...], **environment: str) -> list[float]:
    command = [sys.executable, "-c", _STEP, repr(case)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env={**os.environ, **environment})
    return [float(number) for number in done.stdout.split()]
