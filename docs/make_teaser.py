"""Make docs/teaser.png, the picture of the README, from the demo's models: `python docs/make_teaser.py`."""

from pathlib import Path

import torch
from PIL import Image

from neural_renderer import Mesh
from neural_renderer.apps.common.pictures.clay import clay_mesh
from neural_renderer.apps.common.pictures.photograph import lowest_point, photograph
from neural_renderer.apps.common.pictures.sheet import sheet
from neural_renderer.apps.demo.command import make_cameras, sphere_fit
from neural_renderer.apps.demo.models import duck, knot
from neural_renderer.apps.fit import TextureFit, Views

SIDE = 256


def main() -> None:
    """Sculpt the duck as the demo does, photograph its stages, and a turn of the knot below them."""
    target, ring = duck(), knot(texture_size=8)
    cameras = make_cameras(24, torch.device("cpu"))
    fit = sphere_fit(Views.of(target, cameras, 96), 300)
    stages = [clay_mesh(*fit.shape[:2])]
    while not fit.done:
        fit.advance()
        if fit.step in (30, 90):
            stages.append(clay_mesh(*fit.shape[:2]))
    paint = TextureFit(Views.of(target, cameras, 192), *fit.shape, size=8, batch=8)
    while not paint.done:
        paint.advance()
    stages += [Mesh(*paint.shape), target]
    floor = lowest_point(target)
    top = [photograph(mesh, 145, size=2 * SIDE, floor=floor) for mesh in stages]
    bottom = [photograph(ring, 180 + angle, size=2 * SIDE) for angle in (0, 36, 72, 108, 144)]
    whole = Image.fromarray(sheet([top, bottom]).numpy()).resize((5 * SIDE, 2 * SIDE), Image.Resampling.LANCZOS)
    whole.save(Path(__file__).with_name("teaser.png"), optimize=True)


if __name__ == "__main__":
    main()
