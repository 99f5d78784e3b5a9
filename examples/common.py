"""Options and input files of the four examples."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch

import neural_renderer as nr

DATA = Path(__file__).resolve().parent / "data"


def options(
    description: str, output: str, iterations: int | None = None, reference: str | None = None
) -> argparse.Namespace:
    """Parse the command line; ``iterations`` and ``reference`` are for the examples that optimise."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("-i", "--input", type=Path, default=DATA / "teapot.obj", help="mesh in an OBJ file")
    if reference is not None:
        parser.add_argument("-r", "--reference", type=Path, default=DATA / reference, help="picture to reproduce")
    parser.add_argument("-o", "--output", type=Path, default=output, help="animation to write, .gif or .mp4")
    if iterations is not None:
        parser.add_argument("-n", "--iterations", type=int, default=iterations, help="steps of Adam, at most")
    parser.add_argument("-d", "--device", default="cuda" if torch.cuda.is_available() else "cpu", help="cpu or cuda")
    arguments = parser.parse_args()
    for name in ("input", "reference"):
        path = getattr(arguments, name, None)
        if path is not None and not path.is_file():
            sys.exit(f"--{name}: expected a file, got {path}, which does not exist")
    return arguments


def load(path: Path, device: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Load a mesh as a batch of one: vertices [1, V, 3] and faces [1, F, 3]."""
    vertices, faces = nr.load_obj(path)
    return vertices[None].to(device), faces[None].to(device)


def picture(path: Path, device: str) -> torch.Tensor:
    """Load a picture [H, W, 3] in [0, 1]."""
    return nr.load_image(path)[..., :3].to(device)


def report(step: int, loss: torch.Tensor, every: int = 20) -> None:
    """Print the loss at some of the steps."""
    if step % every == 0:
        print(f"step {step:4d}  loss {loss.item():.1f}", flush=True)
