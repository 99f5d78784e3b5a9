"""Make docs/teaser.png, the picture of the README, from the demo's models: `python docs/make_teaser.py`."""

from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from neural_renderer.commands import sculpt
from neural_renderer.commands.demo import clay
from neural_renderer.commands.shapes import duck, knot
from neural_renderer.commands.studio import lowest, photograph, sheet

SIDE = 256


def main() -> None:
    """Sculpt the duck as the demo does, photograph its stages, and a turn of the knot below them."""
    torch.manual_seed(0)
    target, ring = duck(), knot(texture_size=8)
    views = sculpt.Views.of(target, 24, 96)
    history: list[Tensor] = []
    vertices, faces = sculpt.sphere(torch.device("cpu"))
    stages = [clay(vertices, faces)]
    vertices = sculpt.sculpt(views, vertices, faces, 300, lambda step, loss, vertices: history.append(vertices))
    fitted = sculpt.paint(views, vertices, faces, 75, lambda step, loss, textures: None)
    stages += [clay(history[step], faces) for step in (30, 90)] + [fitted, target]
    floor = lowest(target)
    top = [photograph(mesh, 145, size=2 * SIDE, floor=floor) for mesh in stages]
    bottom = [photograph(ring, 180 + angle, size=2 * SIDE) for angle in (0, 36, 72, 108, 144)]
    whole = Image.fromarray(sheet([top, bottom]).numpy()).resize((5 * SIDE, 2 * SIDE), Image.Resampling.LANCZOS)
    whole.save(Path(__file__).with_name("teaser.png"), optimize=True)


if __name__ == "__main__":
    main()
