"""Example 1: draw a mesh from all sides."""

import torch
from common import load, options

import neural_renderer as nr


def main() -> None:
    """Write an animation of 90 pictures around the mesh."""
    arguments = options("Draw a mesh from all sides.", "example1.gif")
    vertices, faces = load(arguments.input, arguments.device)
    textures = torch.ones(1, faces.shape[1], 2, 2, 2, 3, device=vertices.device)
    renderer = nr.Renderer(camera_mode="look_at")
    frames = []
    for azimuth in range(0, 360, 4):
        renderer.eye = nr.get_points_from_angles(2.732, 30, azimuth)
        images, _, _ = renderer(vertices, faces, textures)
        frames.append(images[0].cpu())
    nr.save_animation(arguments.output, frames)
    print(f"{len(frames)} pictures in {arguments.output}")


if __name__ == "__main__":
    main()
