"""Draw docs/reconstructions.jpg: twelve pictures of the test split, chosen by number, and their meshes.

    python docs/make_reconstructions.py DATA

DATA is a data set of `neural-renderer reconstruct dataset`. Of n objects, number ⌊k (n − 1) / 11⌋ is shown from view
7 k + 2 modulo 24, for k = 0, …, 11: the picture, the mesh from that side, and the mesh from 90° to the right.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.reconstruct.data.arrays import open_split
from neural_renderer.apps.reconstruct.shapes.views import clip_points

SIZE, PAPER = 112, 0.93


def main() -> None:
    """Reconstruct and draw."""
    split = open_split(sys.argv[1], "test")
    objects = [images[index] for images in split.images.values() for index in range(len(images))]
    cells = []
    for k in range(12):
        image = torch.from_numpy(objects[k * (len(objects) - 1) // 11][(7 * k + 2) % 24].copy()).float() / 255
        result = nr.reconstruct(image.permute(1, 2, 0))
        given = torch.nn.functional.interpolate(result.cutout[None], (SIZE, SIZE), mode="bilinear")[0]
        row = [given[:3] * given[3:] + PAPER * (1 - given[3:])]
        for turn in (0.0, math.pi / 2):
            pose = result.pose[None].clone()
            pose[0, 0] += turn
            pose[0, 3:] = torch.tensor([0.0, 0.0, 0.62]) if turn else pose[0, 3:]
            mesh = (
                clip_points(result.mesh.vertices, pose),
                result.mesh.faces,
                result.mesh.vertex_colors[result.mesh.faces.long()],
            )
            row.append(nr.render(mesh, None, SIZE, light=None, outputs="rgb", background=PAPER).rgb[0].clamp(0, 1))
        cells.append(torch.cat(row, 2))
    sheet = torch.cat([torch.cat(cells[row : row + 3], 2) for row in range(0, 12, 3)], 1)
    picture = Image.fromarray((sheet.permute(1, 2, 0) * 255 + 0.5).byte().numpy())
    picture.save(Path(__file__).parent / "reconstructions.jpg", quality=85, optimize=True)


if __name__ == "__main__":
    main()
