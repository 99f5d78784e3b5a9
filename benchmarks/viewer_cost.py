"""Cost of the viewer for the work that it shows: `python -m benchmarks.viewer_cost`.

Steps of an optimisation with and without the viewer alternate in one process, so that other programs slow down both
alike. A browser without a window looks, if Chromium is installed; otherwise a record is made. It draws on the same
processors, which slows down the steps; the processor time of the program itself, with all threads of the viewer, is
what a browser elsewhere would leave. ``--receiver`` connects such a browser elsewhere: a program that receives
everything and draws nothing. Steps must be shorter than 0.1 s for ten updates a second: ``--views 1 --size 64``.

Processor times hold on a machine with other work, too. The times of steps need idle cores.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import torch

import neural_renderer as nr
from neural_renderer.apps.view.viewer import Viewer
from tests.apps.view.browser import Browser, find_browser, wait_until

_BLOCK = 2.0  # seconds of steps with, and then without the viewer
_RECEIVER = """
import sys
from websockets.sync.client import connect
with connect(sys.argv[1], subprotocols=[sys.argv[2]], max_size=None) as server:
    server.recv()
    print("connected", flush=True)
    for _ in server:
        pass
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blocks", type=int, default=10, help="pairs of blocks")
    parser.add_argument("--size", type=int, default=256, help="side of the images")
    parser.add_argument("--views", type=int, default=4, help="images a step")
    parser.add_argument("--record", action="store_true", help="a record in place of a browser")
    parser.add_argument("--receiver", action="store_true", help="a program that draws nothing in place of a browser")
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}")
    if options.receiver:
        for colored in (False, True):
            viewer = Viewer(port=0)
            with _receiver(viewer):
                _measure(viewer, 5, colored, options)
            viewer.close()
        return
    program = None if options.record else find_browser()
    with tempfile.TemporaryDirectory() as folder:
        for level, colored in ((5, False), (5, True)):
            viewer = Viewer(port=0, browser=program is not None, record=None if program else Path(folder) / "run.html")
            if program is None:
                _measure(viewer, level, colored, options)
            else:
                with Browser(program) as browser:
                    browser.open(viewer.url or "")
                    wait_until(lambda viewer=viewer: viewer.clients == 1, "the browser")
                    _measure(viewer, level, colored, options)
            print(viewer.close() or "", flush=True)


@contextlib.contextmanager
def _receiver(viewer: Viewer) -> Iterator[None]:
    """Connect a program that receives what a browser would."""
    import viser

    address = (viewer.url or "").replace("http", "ws")
    command = [sys.executable, "-c", _RECEIVER, address, f"viser-v{viser.__version__}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        if process.stdout is not None:
            process.stdout.readline()
        viewer._newest._is_watched = lambda: True  # viser counts browsers that have told their cameras
        yield
        process.kill()


def _measure(viewer: Viewer, level: int, colored: bool, options: argparse.Namespace) -> None:
    """Measure the steps for an icosphere; print the ratio."""
    vertices, faces = nr.icosphere(level)
    textures = torch.rand(len(faces), 4, 4, 4, 3) if colored else torch.ones(len(faces), 1, 1, 1, 3)
    vertices, textures = vertices.clone().requires_grad_(), textures.requires_grad_(colored)
    camera = nr.Camera.look_at(
        nr.get_points_from_angles(2.7, 20.0, torch.arange(options.views) * 90.0), viewing_angle=30
    )
    optimizer = torch.optim.Adam([vertices, textures] if colored else [vertices], 1e-4)

    def step() -> None:
        images = nr.render((vertices, faces, textures), camera, options.size, outputs=("rgb", "alpha"))
        optimizer.zero_grad()
        (images.rgb.mean() + images.alpha.mean()).backward()
        optimizer.step()

    step()
    number = 0
    times: dict[bool, list[float]] = {True: [], False: []}
    inside = 0.0  # processor time of the thread of the steps in the viewer's code
    costs: list[float] = []  # processor time of an update in all threads of the viewer, by block
    updates, seconds = 0, 0.0
    count = viewer._newest._put

    def counted(name: str, snapshot: object) -> None:
        nonlocal updates
        updates += 1
        count(name, snapshot)  # type: ignore[arg-type]

    viewer._newest._put = counted
    for _ in range(options.blocks):
        for watched in (True, False):
            start = last = time.perf_counter()
            others, inside, before = _time_of_viewer(), 0.0, updates
            while last - start < _BLOCK:
                step()
                number += 1
                if watched:
                    begun = time.thread_time()
                    viewer.observe("step", number, 0, {"loss": 1.0}, lambda: (vertices, faces, textures))
                    inside += time.thread_time() - begun
                now = time.perf_counter()
                times[watched].append(now - last)
                last = now
            if watched:
                seconds += last - start
                viewer._worker.wait(60.0)
                costs.append((inside + _time_of_viewer() - others) / max(updates - before, 1))
    with_it, without = (statistics.median(times[key]) for key in (True, False))
    rate, cost = updates / seconds, statistics.median(costs)
    print(
        f"{len(faces):9,} faces{', colours change' if colored else '':16}: {1e3 * without:7.1f} ms a step without, "
        f"{1e3 * with_it:7.1f} with the viewer ({100 * (with_it / without - 1):+.1f} %), {rate:.1f} updates a second\n"
        f"    an update takes {1e3 * cost:.1f} ms of processor time in all threads ({1e3 * min(costs):.1f} to "
        f"{1e3 * max(costs):.1f}): {100 * rate * cost:.1f} % of one core",
        flush=True,
    )


def _time_of_viewer() -> float:
    """Return the processor time of the threads of the viewer and of viser: all but this one and those of kernels."""
    own = threading.get_ident()
    idents = [
        thread.ident
        for thread in threading.enumerate()
        if thread.ident not in (None, own) and not thread.name.startswith("neural_renderer_")
    ]
    return sum(time.clock_gettime(time.pthread_getcpuclockid(ident)) for ident in idents if ident is not None)


if __name__ == "__main__":
    main()
