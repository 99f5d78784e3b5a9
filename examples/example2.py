"""Example 2: move a mesh's vertices until its silhouette matches a picture."""

import torch
from common import load, options, picture, report

import neural_renderer as nr


def main() -> None:
    """Optimise the vertices; write an animation of the steps, then of the result from all sides."""
    arguments = options("Fit vertices to a silhouette.", "example2.gif", 300, "example2_ref.png")
    vertices, faces = load(arguments.input, arguments.device)
    vertices = torch.nn.Parameter(vertices)
    target = picture(arguments.reference, arguments.device).mean(-1)[None]
    textures = torch.ones(1, faces.shape[1], 2, 2, 2, 3, device=vertices.device)
    renderer = nr.Renderer(camera_mode="look_at")
    renderer.eye = nr.get_points_from_angles(2.732, 0, 90)
    optimizer = torch.optim.Adam([vertices], lr=1e-3)
    frames = []
    for step in range(arguments.iterations):
        silhouettes = renderer(vertices, faces, mode="silhouettes")
        loss = (silhouettes - target).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        report(step, loss)
        if step % 5 == 0:
            frames.append(silhouettes[0].detach().cpu().expand(3, -1, -1))

    with torch.no_grad():
        silhouettes = renderer(vertices, faces, mode="silhouettes")
        iou = 1 - nr.losses.silhouette_iou_loss(silhouettes, target)
        print(f"final loss {(silhouettes - target).square().sum():.1f}, IoU {iou:.4f}")
        for azimuth in range(0, 360, 4):
            renderer.eye = nr.get_points_from_angles(2.732, 0, azimuth)
            images, _, _ = renderer(vertices, faces, textures)
            frames.append(images[0].cpu())
    nr.save_animation(arguments.output, frames)
    print(f"{len(frames)} pictures in {arguments.output}")


if __name__ == "__main__":
    main()
