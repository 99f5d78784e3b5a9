"""Memory of a fit to large photographs: ``python -m benchmarks.fit_memory MESH FOLDER``.

Writes photographs of a mesh as JPEG, on a blue wall, with their cameras, into a folder, unless it has them: drawn at a
tenth of their size and enlarged, because only the memory matters. Then fits in another process, with few steps, and
prints its largest resident memory and its seconds. Further options go to ``fit``, such as ``--size 1024``.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch
from PIL import Image

import neural_renderer as nr

from .fit_quality import around

_SHORT = ("--steps", "10", "--texture-steps", "3", "--turntable", "0")
_ENLARGED = 10


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fit_memory", description=__doc__)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("folder", type=Path, help="folder for the photographs")
    parser.add_argument("--photos", type=int, default=200)
    parser.add_argument("--width", type=int, default=4000)
    parser.add_argument("--height", type=int, default=3000)
    options, further = parser.parse_known_args()
    if not (options.folder / "cameras.json").is_file():
        write_photos(options)
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "neural_renderer", "fit", str(options.folder), "-o", folder]
        subprocess.run([*command, *_SHORT, *further], check=True)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    print(f"largest resident memory: {peak:.2f} GiB; {time.perf_counter() - begun:.0f} s")


def write_photos(options: argparse.Namespace) -> None:
    """Draw, enlarge and write photographs, and ``cameras.json``."""
    options.folder.mkdir(parents=True, exist_ok=True)
    mesh, camera = nr.Mesh.load(options.mesh, texture_size=4, normalize=True), around(options.photos)
    light = nr.Light(ambient=0.6, directional=0.4, direction=(0.4, 0.8, -0.45))
    size = options.height // _ENLARGED, options.width // _ENLARGED
    focal = options.height / 2 / math.tan(math.radians(25.0))
    K = [[focal, 0, options.width / 2], [0, focal, options.height / 2], [0, 0, 1]]
    rows = []
    for index in range(options.photos):
        drawn = nr.render(mesh, camera[index], size, light=light, background=(0.2, 0.35, 0.7)).rgb[0]
        pixels = (drawn.clamp(0, 1) * 255).byte().permute(1, 2, 0).numpy()
        picture = Image.fromarray(pixels).resize((options.width, options.height), Image.Resampling.BICUBIC)
        picture.save(options.folder / f"{index:03d}.jpg", quality=90)
        R = camera.rotation[index] * torch.tensor([1.0, -1.0, 1.0])[:, None]
        t = -R @ camera.origin[index]
        rows.append({"file": f"{index:03d}.jpg", "R": R.tolist(), "t": t.tolist()})
    (options.folder / "cameras.json").write_text(json.dumps({"K": K, "views": rows}), encoding="utf-8")


if __name__ == "__main__":
    main()
