"""Holes of fits: ``python -m benchmarks.fit_holes``.

Fits 24 views of 256² of three objects with narrow holes, or of meshes given with ``--meshes``, from visual hulls of 64
cells and of the default. Prints a table: faces, the share of the enclosed background of 12 held-out masks that the hull
and the result leave open, the mean IoU of these masks, and processor seconds.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.masks.operations import fill_holes
from neural_renderer.apps.fit import MeshFit, Views

from .fit_quality import around


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fit_holes", description=__doc__)
    parser.add_argument("--meshes", type=Path, nargs="*", default=[], help="further meshes")
    parser.add_argument("--cells", nargs="*", default=["64", "default"], help="numbers, or default")
    parser.add_argument("--only", nargs="*", help="names of objects")
    parser.add_argument("--steps", type=int, default=150)
    parser.add_argument("--save", type=Path, help="folder for pictures of the results")
    options = parser.parse_args()
    objects = {name: make() for name, make in OBJECTS.items() if not options.only or name in options.only}
    objects |= {path.stem: nr.Mesh.load(path, normalize=True) for path in options.meshes}
    rows = []
    for name, mesh in objects.items():
        for cells in options.cells:
            rows.append(row(name, mesh, None if cells == "default" else int(cells), options))
            print(rows[-1], flush=True)
    table = Table()
    for column in rows[0]:
        table.add_column(column, justify="right")
    for each in rows:
        table.add_row(*map(str, each.values()))
    Console(width=140).print(table)


def row(name: str, mesh: nr.Mesh, cells: int | None, options: argparse.Namespace) -> dict[str, object]:
    """Fit one object and measure."""
    light = nr.Light(ambient=0.6, directional=0.4, direction=(0.4, 0.8, -0.45))
    fitted, held_out = (Views.of(mesh, camera, 256, light=light) for camera in (around(24), around(12, 61.0)))
    begun = time.process_time()
    fit = MeshFit(fitted, cells=cells, steps=options.steps)
    views = fit.normalize(held_out)
    hull = left_open(views, fit.shape)
    while not fit.done:
        fit.advance()
    seconds = time.process_time() - begun
    if options.save:
        picture = nr.render(fit.mesh(), around(24)[[2, 8]], 384).rgb
        nr.save_image(options.save / f"{name}_{cells or 'default'}.png", torch.cat(list(picture), 2))
        fit.mesh().save(options.save / f"{name}_{cells or 'default'}.glb")
    return {
        "object": name,
        "cells": cells or "default",
        "faces": len(fit.shape[1]),
        "open, hull": f"{hull:.0%}",
        "open": f"{left_open(views, fit.shape):.0%}",
        "held-out IoU": f"{views.quality(fit.shape)['iou'].mean():.4f}",
        "seconds": round(seconds),
    }


def left_open(views: Views, shape: tuple[Tensor, ...]) -> float:
    """Measure which share of the background that masks enclose a mesh leaves open."""
    with torch.no_grad():
        drawn = views.draw(shape[:2]).alpha > 0.5
    enclosed = torch.stack([fill_holes(mask > 0.5, 1.0) & (mask <= 0.5) for mask in views.masks])
    return float((enclosed & ~drawn).sum() / enclosed.sum().clamp(min=1))


def boxes(places: Tensor, sizes: Tensor) -> nr.Mesh:
    """Join boxes with centres [N, 3] and half sides [N, 3]."""
    vertices, faces = nr.cube()
    parts = [nr.Mesh(vertices * size + place, faces) for place, size in zip(places, sizes, strict=True)]
    return nr.Mesh(*nr.join(parts)).normalize()


def columns() -> nr.Mesh:
    """Make fifteen square columns between two plates, with gaps of 0.035 in an object of length 2."""
    x = torch.linspace(-0.84, 0.84, 15)
    plate, column = torch.tensor([1.0, 0.08, 0.2]), torch.tensor([0.0425, 0.45, 0.04])
    places = torch.zeros(17, 3)
    places[:15, 0] = x
    places[15:, 1] = torch.tensor([0.5, -0.5])
    return boxes(places, torch.stack([column] * 15 + [plate] * 2))


def ring() -> nr.Mesh:
    """Make a flat ring with a hole of diameter 0.08, whose axis is level."""
    vertices, faces = nr.torus(0.5, 0.46, 96, 64)
    flat = vertices[:, [0, 2, 1]] * torch.tensor([1.0, 1.0, 0.3])
    return nr.Mesh(flat, faces[:, [0, 2, 1]]).normalize()


def mug() -> nr.Mesh:
    """Make a solid mug with a handle close to it."""
    angle = torch.linspace(0, 2 * torch.pi, 65)[:-1]
    circle = torch.stack((0.6 * angle.cos(), 0.6 * angle.sin()), 1)
    top = torch.stack((circle[:, 0], torch.full((64,), 0.7), circle[:, 1]), 1)
    vertices = torch.cat((top, top * torch.tensor([1.0, -1.0, 1.0]), torch.tensor([[0, 0.7, 0], [0, -0.7, 0]])))
    i = torch.arange(64)
    j = (i + 1) % 64
    sides = torch.cat((torch.stack((i, j, i + 64), 1), torch.stack((j, j + 64, i + 64), 1)))
    caps = torch.cat((torch.stack((j, i, 0 * i + 128), 1), torch.stack((i + 64, j + 64, 0 * i + 129), 1)))
    handle, rim = nr.torus(0.35, 0.06, 64, 16)
    handle = handle[:, [0, 2, 1]] * torch.tensor([0.6, -1.0, 1.0])  # tall, narrow, and upright
    body = nr.Mesh(vertices, torch.cat((sides, caps)))
    return nr.Mesh(*nr.join([body, nr.Mesh(handle + torch.tensor([0.48, 0.0, 0.0]), rim)])).normalize()


OBJECTS = {"columns": columns, "ring": ring, "mug": mug}

if __name__ == "__main__":
    main()
