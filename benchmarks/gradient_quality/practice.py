"""Use of gradients in practice: poses from images, and shapes from silhouettes.

Every renderer gets the same problems, the same optimiser (Adam) with a rate that suits it, and one image at a time.
Seconds are of the processor, on one thread.
"""

from __future__ import annotations

import math
import time
from pathlib import Path

import torch
from torch import Tensor

import neural_renderer as nr

from .adapters import Adapter
from .adapters.ours import draw
from .picture import Picture
from .scenes import corner_colors

SIZE, EYE = 64, torch.tensor([0.0, 0.0, -2.7]).double()
_DATA = Path(__file__).parents[2] / "examples" / "data"


def meshes() -> dict[str, tuple[Tensor, Tensor]]:
    """Make four meshes: vertices within a sphere of radius 0.6, and faces."""
    ball, ball_faces = nr.icosphere(2)
    bumps = 1 + 0.35 * (3 * ball).sin().sum(1, keepdim=True) / 2
    spot, teapot = (nr.Mesh.load(str(_DATA / f"{name}.obj")) for name in ("spot", "teapot"))
    found = {
        "spot": (spot.vertices, spot.faces),
        "teapot": (teapot.vertices, teapot.faces),
        "potato": (ball * bumps, ball_faces),
        "box": nr.cube(),
    }
    scaled = {}
    for name, (vertices, faces) in found.items():
        vertices = vertices.detach().double()
        vertices = vertices - (vertices.amax(0) + vertices.amin(0)) / 2
        if name == "box":
            vertices = vertices * torch.tensor([1.0, 0.7, 0.5]).double()
        scaled[name] = 0.6 * vertices / vertices.norm(dim=1).max(), faces
    return scaled


def rotation(angles: Tensor) -> Tensor:
    """Make a rotation matrix [3, 3] from a rotation vector."""
    x, y, z = angles
    zero = torch.zeros_like(x)
    skew = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero)).view(3, 3)
    return torch.linalg.matrix_exp(skew)


def picture_of(vertices: Tensor, faces: Tensor, colors: Tensor, eye: Tensor = EYE, black: bool = False) -> Picture:
    """Project vertices; see `scenes.project`."""
    x, y, z = nr.Camera.look_at(eye, viewing_angle=18)(vertices)[0].double().unbind(-1)
    places = torch.stack(((x + 1) * SIZE / 2, (y + 1) * SIZE / 2, 2 - 1 / z), -1)
    return Picture(places, faces, colors, SIZE, (0.0, 0.0, 0.0) if black else (0.1, 0.3, 0.2))


def step(adapter: Adapter, picture: Picture, target: Tensor) -> float:
    """Add the gradient of the squared error to the leaves of a picture; return the loss."""
    still = picture.detached()
    with torch.no_grad():
        # The renderer's own image, if it is not the exact one.
        own = getattr(adapter, "image", None)
        image = (own(still) if own else draw(still, "edge")).double()
    difference = image - target
    _, to_vertices, _ = adapter.draw(still, 2 * difference)
    torch.autograd.backward(picture.vertices, to_vertices.double())
    return float(difference.square().sum())


def pose(adapter: Adapter, name: str, starts: int, seconds: float, steps: int = 60) -> dict:
    """Find poses from images; a start is off by 10° to 40° about a random axis. Success is an error below 5°.

    There are at most so many starts, and after two of them, none begins after so many seconds of the processor.
    """
    vertices, faces = meshes()[name]
    generator = torch.Generator().manual_seed(0)
    colors = corner_colors(faces, 7, 0.0)
    if len(faces) > 100:  # smooth colours by place
        colors = (0.5 + 0.5 * (4 * vertices).sin())[faces]
    successes, needed, count = 0, [], 0
    began = time.process_time()
    while count < min(starts, 2) or (count < starts and time.process_time() - began < seconds):
        count += 1
        true = rotation(torch.randn(3, generator=generator).double())
        axis = torch.nn.functional.normalize(torch.randn(3, generator=generator).double(), dim=0)
        off = math.radians(10 + 30 * float(torch.rand((), generator=generator)))
        with torch.no_grad():
            target = draw(picture_of(vertices @ true.T, faces, colors), "edge").double()
        start = rotation(axis * off) @ true
        angles = torch.zeros(3, dtype=torch.float64, requires_grad=True)
        optimizer = torch.optim.Adam([angles], lr=0.03)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps, 0.002)
        first = None
        for n in range(steps):
            turn = rotation(angles) @ start
            error = math.degrees(math.acos(min(1.0, max(-1.0, float(((turn.detach() @ true.T).trace() - 1) / 2)))))
            if error < 5 and first is None:
                first = n
            optimizer.zero_grad()
            step(adapter, picture_of(vertices @ turn.T, faces, colors), target)
            optimizer.step()
            schedule.step()
        turn = (rotation(angles) @ start).detach()
        error = math.degrees(math.acos(min(1.0, max(-1.0, float(((turn @ true.T).trace() - 1) / 2)))))
        successes += error < 5
        if error < 5:
            needed.append(steps if first is None else first)
    taken = (time.process_time() - began) / count
    middle = float(torch.tensor(needed).float().median()) if needed else math.nan
    return {"mesh": name, "success": successes / count, "starts": count, "steps": middle, "seconds": taken}


def silhouettes(adapter: Adapter, seconds: float, views: int = 8) -> dict:
    """Fit a sphere to silhouettes of the cow for some seconds of the processor; IoU of silhouettes of other views."""
    vertices, faces = meshes()["spot"]
    ball, ball_faces = nr.icosphere(3)
    leaf = (0.45 * ball.double()).requires_grad_()
    white = [torch.ones(len(part), 3, 3, dtype=torch.float64) for part in (faces, ball_faces)]
    angles = torch.arange(2 * views) * 360 / (2 * views)
    eyes = nr.get_points_from_angles(2.7, torch.tensor([20.0, -20.0]).repeat(views), angles).double()
    with torch.no_grad():
        targets = [draw(picture_of(vertices, faces, white[0], eye, True), "edge").double() for eye in eyes]
    optimizer = torch.optim.Adam([leaf], lr=0.004)
    began, n = time.process_time(), 0
    while time.process_time() - began < seconds:
        optimizer.zero_grad()
        (200 * nr.losses.laplacian(leaf.float(), ball_faces)).backward()
        for own in range(4):
            view = 2 * ((4 * n + own) % views)
            picture = picture_of(leaf, ball_faces, white[1], eyes[view], True)
            step(adapter, picture, targets[view])
        optimizer.step()
        n += 1
    overlaps = []
    with torch.no_grad():
        for view in range(1, 2 * views, 2):
            image = draw(picture_of(leaf, ball_faces, white[1], eyes[view], True), "edge").double()
            both, either = (image * targets[view]).sum(), torch.maximum(image, targets[view]).sum()
            overlaps.append(float(both / either))
    return {"iou": sum(overlaps) / len(overlaps), "seconds": seconds, "steps": n}
