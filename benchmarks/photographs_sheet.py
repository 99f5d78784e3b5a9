"""A sheet of fits to photographs: ``python -m benchmarks.photographs_sheet OUT1 OUT2 … -o docs/photographs.jpg``.

A row for each folder that ``neural-renderer fit PHOTOGRAPHS -o OUT`` has written: a photograph, the mask that was found
(none for an open surface), and the mesh from the same camera, with and without its texture.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.pictures.sheet import sheet
from neural_renderer.apps.common.views.views import Views, downscale
from neural_renderer.apps.fit.photos.masks.mask_sheet import mask_tile
from neural_renderer.camera.files import read_camera_file
from neural_renderer.io.images import load_reduced


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.photographs_sheet", description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+", help="folders of results")
    parser.add_argument("-o", "--output", type=Path, default=Path("photographs.jpg"))
    parser.add_argument("--view", type=int, default=3, help="number of the photograph")
    parser.add_argument("--size", type=int, default=220, help="longer side of a picture")
    options = parser.parse_args()
    rows = [pictures(folder, options.view, options.size) for folder in options.folders]
    Image.fromarray(sheet(rows).numpy()).save(options.output, quality=85)


@torch.no_grad()
def pictures(folder: Path, view: int, side: int) -> list[Tensor]:
    """Draw the row of a folder of results: four pictures [3, H, W], padded to squares."""
    refined = folder / "cameras.json"
    cameras = read_camera_file(refined if refined.is_file() else folder / "sparse/0/images.bin")
    file = folder / "images" / Path(cameras.images[view].name).name
    photo = downscale(load_reduced(file, least=side)[0][..., :3].permute(2, 0, 1), side)
    size = photo.shape[1], photo.shape[2]
    camera, mesh = cameras.cameras(size)[view : view + 1], nr.UVMesh.load(folder / "mesh.glb")
    shape = nr.Mesh(mesh.vertices, mesh.faces)
    lamp = nr.Light(0.25, 0.75, direction=tuple((-Views(camera, torch.ones(1, 2, 2)).eyes()[1][0]).tolist()))
    white = torch.ones(3)
    images = [
        photo,
        mask_tile(file, folder / "masks", side),
        *(draw(one, camera, size, light, white) for one, light in ((mesh, None), (shape, lamp))),
    ]
    return [torch.nn.functional.pad(image, (0, side - size[1], 0, side - size[0]), value=1.0) for image in images]


def draw(
    mesh: nr.Mesh | nr.UVMesh, camera: nr.Camera, size: tuple[int, int], light: nr.Light | None, white: Tensor
) -> Tensor:
    """Draw a mesh [3, H, W] before white."""
    drawn = nr.render(mesh, camera, size, light=light, outputs=("rgb", "alpha"))
    return (drawn.rgb[0] + (1 - drawn.alpha[0]) * white[:, None, None]).clamp(0, 1)


if __name__ == "__main__":
    main()
