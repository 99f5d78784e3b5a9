"""Pictures of a mesh from all sides, with their cameras, in the format of `neural-renderer fit`."""

import argparse
import json
from pathlib import Path

import torch
from common import DATA

import neural_renderer as nr


def main() -> None:
    """Write pictures with transparency, and cameras.json beside them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("mesh", type=Path, nargs="?", default=DATA / "spot.obj", help="mesh file")
    parser.add_argument("-o", "--output", type=Path, default=Path("photos"), help="folder to write into")
    parser.add_argument("-n", "--number", type=int, default=24, help="number of photographs")
    parser.add_argument("-s", "--size", type=int, default=256, help="side of a photograph in pixels")
    arguments = parser.parse_args()
    mesh = nr.UVMesh.load(arguments.mesh)
    distance = 2.5 * mesh.vertices.norm(dim=1).max().item()
    views = []
    for number in range(arguments.number):
        azimuth, elevation = 360 * number / arguments.number, (-25.0, 10.0, 40.0)[number % 3]
        eye = nr.get_points_from_angles(distance, elevation, azimuth)
        images = nr.render(mesh, nr.Camera.look_at(eye, viewing_angle=30), arguments.size, light=None)
        # On black, colours at the outline are multiplied by alpha; PNG stores them without.
        picture = torch.cat((images.rgb[0] / images.alpha.clamp(min=1e-6), images.alpha))
        views.append({"file": f"{number:03d}.png", "azimuth": azimuth, "elevation": elevation, "distance": distance})
        nr.save_image(arguments.output / views[-1]["file"], picture)
    cameras = json.dumps({"viewing_angle": 30, "views": views}, indent=1)
    (arguments.output / "cameras.json").write_text(cameras + "\n", encoding="utf-8")
    print(f"{len(views)} photographs in {arguments.output}")


if __name__ == "__main__":
    main()
