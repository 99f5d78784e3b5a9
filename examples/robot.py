"""A robot from silhouettes: `load_robot` makes a rig of a URDF file, and the program finds its joints in two views.

    pip install yourdfpy
    python examples/robot.py robot.urdf

The robot takes random angles within its limits, and is drawn; the fit begins in the middle of the limits.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.pose.rig_fit import Priors, RigFit


def load_robot(path: Path) -> tuple[nr.Rig, Tensor]:
    """Read the links with what is visible of them, and the limits of their joints in radians, [J, 2, 3].

    Angles are rotation vectors: the angle of a joint times its axis. Axes should be those of coordinates, as most are;
    joints that slide or turn about other axes stay as they are.
    """
    import yourdfpy

    robot = yourdfpy.URDF.load(str(path))
    above = {joint.child: joint for joint in robot.joint_map.values()}
    links = list(robot.link_map)
    frames = np.stack([above[link].origin if link in above else np.eye(4) for link in links])
    limits = np.zeros((len(links), 2, 3))
    for own, link in zip(limits, links, strict=True):
        joint = above.get(link)
        if joint is not None and joint.type in ("revolute", "continuous") and np.count_nonzero(joint.axis) == 1:
            free = joint.type == "continuous" or joint.limit is None
            low, high = (-math.pi, math.pi) if free else (joint.limit.lower, joint.limit.upper)
            own[:] = np.sort(np.outer((low, high), joint.axis), 0)
    vertices, faces, owners, count = [], [], [], 0
    graph = robot.scene.graph
    for node in graph.nodes_geometry:
        place, name = graph[node]
        mesh = robot.scene.geometry[name]
        vertices.append(mesh.vertices @ place[:3, :3].T + place[:3, 3])
        faces.append(mesh.faces + count)
        owners += [links.index(graph.transforms.parents[node])] * len(mesh.vertices)
        count += len(mesh.vertices)
    mesh = nr.Mesh(torch.tensor(np.concatenate(vertices)).float(), torch.tensor(np.concatenate(faces)).int())
    rig = nr.Rig(
        mesh,
        tuple(links.index(above[link].parent) if link in above else -1 for link in links),
        torch.tensor(frames[:, :3, 3]).float(),
        torch.ones(count, 1),
        torch.tensor(owners)[:, None],
        rotations=torch.tensor(frames[:, :3, :3]).float(),
        names=tuple(links),
    )
    return rig, torch.tensor(limits).float()


def main() -> None:
    """Draw a robot, and find its joints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", type=Path, help="URDF file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("robot.png"))
    options = parser.parse_args()
    rig, limits = load_robot(options.robot)
    generator = torch.Generator().manual_seed(options.seed)
    low, high = limits.unbind(1)
    angles = low + torch.rand(low.shape, generator=generator) * (high - low)
    rest = rig.vertices()
    center, radius = (rest.amin(0) + rest.amax(0)) / 2, float((rest.amax(0) - rest.amin(0)).norm()) / 2
    azimuths = torch.tensor([0.5, 2.0])
    eyes = center + 6 * radius * torch.stack((azimuths.cos(), azimuths.sin(), torch.full((2,), 0.4)), 1)
    near, far = radius, 12 * radius
    camera = nr.Camera.look_at(eyes, at=center, up=(0.0, 0.0, 1.0), viewing_angle=15)
    truth = rig.posed(rig.pose(angles))
    masks = nr.render(truth, camera, 128, near=near, far=far, outputs=("alpha",)).alpha
    moving = [name for name, own in zip(rig.names, limits, strict=True) if own.any()]
    start = RigFit(rig.rest, (low + high) / 2, torch.zeros(0), torch.zeros(3), 0.0)
    priors = Priors(angles=0.01, smoothness=0.0)
    found = nr.fit_rig(rig, camera, masks, joints=moving, limits=limits, start=start, priors=priors)
    off = torch.rad2deg((found.angles - angles).abs().amax(1))
    for name in moving:
        print(f"{name}: {off[rig.names.index(name)]:.2f}° off")
    pictures = [nr.render(mesh, camera, 128, near=near, far=far).rgb for mesh in (truth, rig.posed(found.pose))]
    nr.save_image(options.output, torch.cat([torch.cat(list(views), 2) for views in pictures], 1))


if __name__ == "__main__":
    main()
