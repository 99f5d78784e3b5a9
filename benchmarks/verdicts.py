"""Verdicts on right and wrong meshes: ``python -m benchmarks.verdicts SET [SET …] -o verdicts.json``.

A set is a folder of `benchmarks.path_traced` with the result of its fit ``alone``: photographs with the cameras and the
depth that were found in them, and the true mesh. The true mesh is drawn with those cameras, whole or wrong: cut, turned
to a part, shifted, dilated, eroded, with a piece of the table, exchanged with that of the next set, or taken from
other views. A short fit to these masks follows, of 24 steps at 128 pixels, and 60 for details if they are right: a hull
alone fills hollows. Printed are what photographs say of its mesh (see `Witness`), the verdict, and the number of
verdicts that are wrong.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

import neural_renderer as nr
from neural_renderer.apps.fit import DetailSettings, MeshFit, Views, verdict
from neural_renderer.apps.fit.cameras import Similarity
from neural_renderer.apps.fit.doubts import doubts
from neural_renderer.apps.fit.photos.masks.shape_masks import read_depth
from neural_renderer.apps.fit.photos.witness import Witness, ask
from neural_renderer.apps.fit.result import LEAST_IOU
from neural_renderer.camera import Camera
from neural_renderer.camera.files import CameraFile, read_camera_file
from neural_renderer.io.images import load_reduced

_DETAIL_STEPS = 60  # of fits to right masks
_LIMITS = (
    *("MOST_LACKING", "LEAST_CONFIRMED", "MOST_THROUGH", "LEAST_POINTS", "MOST_BESIDE", "MOST_LYING", "LEAST_EDGES"),
)
_WHOLE = ("LEAST_POINTS",)  # lower limits on fractions that are ideally 1
_FIGURES = [field.name for field in fields(Witness)]
_SIDE, _PHOTO = 128, 240  # longer side of the masks that are fitted, and of the photographs that are asked


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.verdicts", description=__doc__)
    parser.add_argument("sets", type=Path, nargs="+", help="folders of photographs with a fit")
    parser.add_argument("-o", "--output", type=Path, default=Path("verdicts.json"))
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for number, folder in enumerate(options.sets):
        for row in Photographed(folder).cases(options.sets[(number + 1) % len(options.sets)]):
            rows.append({"set": folder.name, **row})
            print(rows[-1], flush=True)
            options.output.write_text(json.dumps(rows, indent=1) + "\n")
    print_limits(rows)


def print_limits(rows: list[dict[str, Any]]) -> None:
    """Print how many wrong meshes are called good, and right ones doubtful: as it is, and for other limits.

    Half and double limits; of shares that should be 1, half and double distances of the limit from 1.
    """
    print("limits", *errors(rows))
    for name in _LIMITS:
        before = getattr(verdict, name)
        for factor in (0.5, 2.0):
            value = 1 - factor * (1 - before) if name in _WHOLE else factor * before
            setattr(verdict, name, value)
            print(name, round(value, 4), *errors(rows))
        setattr(verdict, name, before)


def errors(rows: list[dict[str, Any]]) -> tuple[str, str]:
    """Count the wrong meshes that are called good, and the right ones that are called doubtful."""
    is_good = [
        not row["doubts"] and not verdict.doubt_shape(Witness(*(row[name] for name in _FIGURES))) for row in rows
    ]
    is_right = [row["case"].startswith("right") for row in rows]
    false_good = sum(good and not right for good, right in zip(is_good, is_right, strict=True))
    false_doubt = sum(right and not good for good, right in zip(is_good, is_right, strict=True))
    return f"{false_good} of {is_right.count(False)} wrong are good", f"{false_doubt} of {sum(is_right)} right are not"


class Photographed:
    """Photographs of a set with found cameras, and the true mesh in their world."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        alone = folder / "alone"
        found, true = read_camera_file(alone / "sparse/0/images.bin"), read_camera_file(folder / "cameras.json")
        names = [entry.name for entry in found.images]
        pictures = [load_reduced(alone / "images" / name, least=_PHOTO)[0] for name in names]
        full = max(pictures[0].shape[:2])
        self.size, photo = (
            (round(pictures[0].shape[0] * side / full), round(pictures[0].shape[1] * side / full))
            for side in (_SIDE, _PHOTO)
        )
        stack = torch.stack([picture[..., :3].permute(2, 0, 1) for picture in pictures])
        self.photos = functional.interpolate(stack, photo, mode="area")
        self.small = functional.interpolate(stack, self.size, mode="area")
        known = read_depth(alone, names)
        if known is None or found.points is None:
            raise ValueError(f"{alone}: expected a fit of photographs alone, got none")
        self.maps, self.ground, _ = known
        self.points = found.points
        self.camera = found.cameras(self.size)
        self.motion = Similarity.between(in_order(true, names, self.size), self.camera)
        mesh = nr.Mesh.load(folder / "truth.ply", texture_size=2).merge_vertices()
        self.vertices, self.faces = mesh.vertices.detach(), mesh.faces.long()

    def cases(self, other: Path) -> Iterator[dict[str, Any]]:
        """Judge the fits to right and wrong masks."""
        mesh = nr.Mesh.load(self.folder / "alone/mesh.glb", texture_size=2).merge_vertices()
        yield self._judged("right, its own fit", mesh.vertices.detach(), mesh.faces.long(), [])
        count, masks = len(self.camera), dict(self._masks(other))
        every = list(range(count))
        rows = {"right, half of the views": every[::2], "right, two thirds": [row for row in every if row % 3]}
        for case, chosen in {**rows, **dict.fromkeys(masks, every)}.items():
            mask = masks.get(case, masks["right"])
            views = Views(self.camera, mask, self.small * mask[:, None])[chosen]
            wrong = list(doubts(views))
            try:
                light: Any = "fitted" if case.startswith("right") else None
                detail = DetailSettings(_DETAIL_STEPS if light else None, light)
                result = MeshFit(views, steps=24, cells=48, detail=detail, texture_steps=1, texture_size=3).run()
            except ValueError:  # the masks have no point in common
                continue
            wrong += ["outlines"] if result.agreement < LEAST_IOU else []
            yield self._judged(case, result.mesh.vertices.detach(), result.mesh.faces.long(), wrong)

    def _judged(self, case: str, vertices: Tensor, faces: Tensor, wrong: list[str]) -> dict[str, Any]:
        witness = ask(vertices, faces, self.camera, self.maps, self.ground, self.photos, self.points)
        reasons = wrong + [reason.text for reason in verdict.doubt_shape(witness)]
        figures = {name: round(value, 4) for name, value in asdict(witness).items()}
        return {
            "case": case,
            **figures,
            "verdict": "doubtful" if reasons else "good",
            "doubts": wrong,
            "reasons": reasons,
        }

    def _masks(self, other: Path) -> Iterator[tuple[str, Tensor]]:
        """Draw the masks [N, H, W] of all cases."""
        low, high = self.vertices.amin(0), self.vertices.amax(0)
        center, side = (low + high) / 2, float((high - low).max())
        whole = self._draw(self.vertices, self.faces)
        yield "right", whole
        yield "right, dilated by a pixel", _grown(whole, 1)
        yield "right, eroded by a pixel", _grown(whole, -1)
        span = (high - low).tolist()
        for case, axis, least, most in (
            ("without 30% of its height", 1, 0.0, 0.7),
            ("without 15% of its height", 1, 0.0, 0.85),
            ("without its lowest quarter", 1, 0.25, 1.0),
            ("half along x", 0, 0.0, 0.5),
            ("half along z", 2, 0.5, 1.0),
            ("without 20% along z", 2, 0.0, 0.8),
        ):
            place = self.vertices[:, axis] - low[axis]
            kept = (place >= least * span[axis]) & (place <= most * span[axis])
            yield case, self._draw(self.vertices, self.faces[kept[self.faces].all(1)])
        for case, share in (("shifted by 10% of the width", 0.1), ("shifted by 5%", 0.05)):
            yield case, whole.roll(round(share * whole.shape[2]), 2)
        yield "dilated by 5%", _grown(whole, round(0.05 * _SIDE))
        yield "eroded by 2%", _grown(whole, -round(0.02 * _SIDE))
        for case, radius in (("with a piece of the table", 0.75), ("with a small piece of the table", 0.55)):
            around = torch.arange(48) * (2 * torch.pi / 48)
            ring = torch.stack((around.cos(), torch.zeros(48), around.sin()), 1) * radius * side
            ring += torch.stack((center[0], low[1] + 0.004 * side, center[2]))
            fan = torch.tensor([[0, k, k + 1] for k in range(1, 47)])
            yield case, torch.maximum(whole, self._draw(ring, torch.cat((fan, fan.flip(1)))))
        brightness = self.small.mean(1)
        for case, sign in (("its dark part", -1), ("its bright part", 1)):
            inside = whole > 0.5
            middle = torch.stack([one[where].median() for one, where in zip(brightness, inside, strict=True)])
            part = inside & ((brightness - middle[:, None, None]) * sign > 0)
            yield case, torch.from_numpy(ndimage.binary_opening(part.numpy(), np.ones((1, 3, 3)))).float()
        yield "those of other views", whole.roll(3, 0)
        mesh = nr.Mesh.load(other / "truth.ply", texture_size=2).merge_vertices().normalize()
        moved = mesh.vertices.detach() * side / 2 + center
        moved[:, 1] += low[1] - moved[:, 1].min()
        yield "those of another object", self._draw(moved, mesh.faces.long())

    @torch.no_grad()
    def _draw(self, vertices: Tensor, faces: Tensor) -> Tensor:
        """Draw the silhouettes [N, H, W] of a mesh in the world of the truth; a pixel where one would be empty."""
        moved = self.motion.points(vertices)
        center = moved.mean(0)
        half = float((moved - center).abs().max())
        views = Views(self.camera, torch.ones(len(self.camera), *self.size)).normalized(center, half)
        shape = (moved - center) / half, faces
        drawn = torch.cat([views[[row]].draw(shape).alpha for row in range(len(views))])
        drawn[drawn.amax((1, 2)) <= 0.5, self.size[0] // 2, self.size[1] // 2] = 1.0
        return drawn


def in_order(file: CameraFile, names: list[str], size: tuple[int, int]) -> Camera:
    """Make the cameras of images with some names."""
    rows = {Path(entry.name).stem: row for row, entry in enumerate(file.images)}
    return file.cameras(size)[[rows[Path(name).stem] for name in names]]


def _grown(masks: Tensor, pixels: int) -> Tensor:
    """Dilate masks [N, H, W] by some pixels, or erode them."""
    grow = ndimage.binary_dilation if pixels > 0 else ndimage.binary_erosion
    return torch.from_numpy(np.stack([grow(one, iterations=abs(pixels)) for one in masks.numpy() > 0.5])).float()


if __name__ == "__main__":
    main()
