"""Comparison of the kernels of `edge_gradient` with the reference, and surfaces to compare them on."""

from __future__ import annotations

import torch

import neural_renderer as nr
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.visibility.edge import EdgeOptions, edge_gradient
from tests.raster.reference.edge import edge_gradient_reference
from tests.raster.scenes import FAR, NEAR


def send_gradient(grad, image, faces, index, two_sided, perspective, seams, edge_hashes=None):
    faces, image = faces.clone().requires_grad_(), image.clone().requires_grad_()
    output = edge_gradient(image, faces, index, EdgeOptions(two_sided, perspective, seams), edge_hashes)
    assert torch.equal(output, image)
    output.backward(grad)
    assert torch.equal(image.grad, grad)
    return faces.grad


def jittered(faces: torch.Tensor, seed: int) -> torch.Tensor:
    """Move corners by more than the rounding of float32, equal corners alike; float64."""
    corners, order = faces.double().reshape(-1, 3).unique(dim=0, return_inverse=True)
    random = torch.rand(corners.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * 2 - 1
    return (corners + 1.5e-6 * random * (corners.abs() + 1))[order].view(faces.shape)


def compare(
    device, faces, height, width, channels, two_sided, perspective, seams, seed=0, edge_hashes=None
) -> torch.Tensor:
    """Assert that kernels and reference agree; returns the number of faces compared, and of those with a gradient.

    Rounding decides where a crossing is near the centre or border of a pixel, or two depths are nearly equal. Such
    faces are not compared: the reference gives other gradients for them if corners move by the rounding of a pixel.
    """
    index = coverage(faces.to(device), height, width, NEAR, FAR, two_sided, perspective)
    random = torch.Generator().manual_seed(seed)
    image, grad = torch.randn(2, len(faces), channels, height, width, generator=random).to(device)
    options = (two_sided, perspective, seams)
    found = send_gradient(
        grad, image, faces.to(device), index, *options, None if edge_hashes is None else edge_hashes.to(device)
    ).cpu()
    maps = [grad.cpu(), image.cpu()]
    expected = edge_gradient_reference(*maps, faces, index.cpu(), *options, edge_hashes)
    others = [edge_gradient_reference(*maps, jittered(faces, n), index.cpu(), *options, edge_hashes) for n in range(4)]
    spread = torch.stack([(other - expected).abs().flatten(2).amax(2) for other in others]).amax(0)
    size = expected.abs().flatten(2).amax(2)
    difference = (found - expected).abs().flatten(2).amax(2)
    known = spread < 1e-2 * size + 1e-6
    assert (difference <= 3 * spread + 1e-4 * size + 1e-5)[known].all(), (difference / size)[known].max()
    assert not found[size + spread == 0].any()
    return torch.tensor([(known & (size > 0)).sum(), (size > 0).sum()])


def ball(seed: int, level: int, bumps: float = 0.0) -> torch.Tensor:
    """Project an icosphere, [1, F, 3, 3], seen from a random place; off the middle, away from scan lines."""
    random = torch.Generator().manual_seed(seed)
    vertices, faces = nr.icosphere(level)
    vertices = vertices * (1 + bumps * torch.randn(len(vertices), 1, generator=random))
    eye = 2.7 * torch.nn.functional.normalize(torch.randn(3, generator=random), dim=0)
    screen = nr.Camera.look_at(eye, viewing_angle=25)(vertices) + torch.tensor([0.0123, 0.0217, 0])
    return nr.vertices_to_faces(screen, faces)
