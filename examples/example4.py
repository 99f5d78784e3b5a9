"""Example 4: recover the camera position of a picture of a mesh."""

import torch
from common import load, options, picture, report

import neural_renderer as nr


def main() -> None:
    """Optimise the camera's position until the silhouettes agree; write an animation of the steps."""
    arguments = options("Fit a camera to a silhouette.", "example4.gif", 1000, "example4_ref.png")
    vertices, faces = load(arguments.input, arguments.device)
    target = (picture(arguments.reference, arguments.device).max(-1).values != 0).float()[None]
    textures = torch.ones(1, faces.shape[1], 2, 2, 2, 3, device=vertices.device)
    eye = torch.nn.Parameter(torch.tensor([6.0, 10.0, -14.0], device=vertices.device))
    renderer = nr.Renderer(camera_mode="look_at")
    renderer.eye = eye
    optimizer = torch.optim.Adam([eye], lr=0.1)
    frames = []
    for step in range(arguments.iterations):
        silhouettes = renderer(vertices, faces, mode="silhouettes")
        loss = (silhouettes - target).square().sum()
        report(step, loss)
        with torch.no_grad():
            images, _, _ = renderer(vertices, faces, textures)
            frames.append(images[0].cpu())
        if loss.item() < 70:
            break
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    x, y, z = eye.tolist()
    print(f"after {step} steps: loss {loss.item():.1f}, camera at ({x:.3f}, {y:.3f}, {z:.3f})")
    nr.save_animation(arguments.output, frames)
    print(f"{len(frames)} pictures in {arguments.output}")


if __name__ == "__main__":
    main()
