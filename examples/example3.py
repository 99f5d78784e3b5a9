"""Example 3: paint a mesh until it looks like a picture from every side."""

import torch
from common import load, options, picture, report

import neural_renderer as nr


def main() -> None:
    """Optimise the texture from a random side in each step; write an animation of the result."""
    arguments = options("Fit a texture to a picture.", "example3.gif", 300, "example3_ref.png")
    torch.manual_seed(0)
    vertices, faces = load(arguments.input, arguments.device)
    target = picture(arguments.reference, arguments.device).permute(2, 0, 1)[None]
    textures = torch.nn.Parameter(torch.zeros(1, faces.shape[1], 4, 4, 4, 3, device=vertices.device))
    renderer = nr.Renderer(camera_mode="look_at", perspective=False)
    renderer.light_intensity_ambient = 1.0
    renderer.light_intensity_directional = 0.0
    optimizer = torch.optim.Adam([textures], lr=0.1, betas=(0.5, 0.999))
    for step in range(arguments.iterations):
        renderer.eye = nr.get_points_from_angles(2.732, 0, 360 * torch.rand(()).item())
        images, _, _ = renderer(vertices, faces, torch.tanh(textures))
        loss = (images - target).square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        report(step, loss)
    print(f"final loss {loss.item():.1f}")

    frames = []
    with torch.no_grad():
        for azimuth in range(0, 360, 4):
            renderer.eye = nr.get_points_from_angles(2.732, 0, azimuth)
            images, _, _ = renderer(vertices, faces, torch.tanh(textures))
            frames.append(images[0].cpu())
    nr.save_animation(arguments.output, frames)
    print(f"{len(frames)} pictures in {arguments.output}")


if __name__ == "__main__":
    main()
