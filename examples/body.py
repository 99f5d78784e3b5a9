"""A body from silhouettes: pose and shape of Anny, a free model of bodies, in four views or in one with keypoints.

    pip install anny
    python examples/body.py --views 4

The program draws a random body in random cameras, forgets it, and fits the rig at rest to the silhouettes. Limits of
joints are half as wide again as the ranges of poses.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.pose.rig_fit import RigShape

# Ranges of rotation vectors in radians, about the axes of the world at rest: x to the left, y backward, z up.
WIDE, SMALL = [(-0.4, 0.4)] * 3, [(-0.1, 0.1)] * 3
RANGES = {
    "pelvis": WIDE,
    "spine": [(-0.2, 0.2)] * 3,
    "clavicle": SMALL,
    "upperarm": [(-0.7, 0.7)] * 3,
    "lowerarm_l": [(-0.3, 0.3), (-0.3, 0.3), (-1.4, 0.1)],
    "lowerarm_r": [(-0.3, 0.3), (-0.3, 0.3), (-0.1, 1.4)],
    "hand": WIDE,
    "neck": [(-0.3, 0.3)] * 3,
    "head": [(-0.3, 0.3)] * 3,
    "thigh": [(-1.1, 0.4), (-0.4, 0.4), (-0.3, 0.3)],
    "calf": [(0.0, 1.4), (-0.1, 0.1), (-0.1, 0.1)],
    "foot": [(-0.4, 0.4), (-0.2, 0.2), (-0.2, 0.2)],
}
SHAPE = torch.tensor([0.5, 0.75, 0.5, 0.5, 0.5, 0.5])  # gender, age, muscle, weight, height, proportions


class Body:
    """Anny as a rig: its blend shapes move vertices and joints."""

    def __init__(self) -> None:
        import anny

        model = anny.Anny(rig="game_engine", topology="notoes_collapse10pc", skinning_method="lbs").float()
        parents = [int(parent) for parent in model.bone_parents]
        above = torch.tensor([max(parent, 0) for parent in parents])
        is_root = torch.tensor([parent < 0 for parent in parents])[:, None]
        heads, moved = model.template_bone_heads, model.bone_heads_blendshapes
        self.rig = nr.Rig(
            nr.Mesh(model.template_vertices, model.get_triangular_faces()),
            tuple(parents),
            torch.where(is_root, heads, heads - heads[above]),
            model.vertex_bone_weights,
            model.vertex_bone_indices,
            targets=model.blendshapes,
            joint_targets=torch.where(is_root, moved, moved - moved[:, above]),
            names=tuple(model.bone_labels),
        )
        self.model = model
        names = self.rig.names
        ranges = [RANGES.get(name, RANGES.get(name.split("_")[0])) for name in names]
        self.joints = [name for name, own in zip(names, ranges, strict=True) if own]
        self.ranges = torch.tensor([own or [(0.0, 0.0)] * 3 for own in ranges]).transpose(1, 2)  # [J, 2, 3]
        margin = 0.25 * self.ranges.diff(dim=1)
        self.limits = self.ranges + torch.cat((-margin, margin), 1)

    def weights(self, shape: Tensor) -> Tensor:
        """Return the weights of the blend shapes for a shape [6]."""
        none = (
            torch.zeros(1, len(self.model.local_change_labels)),
            torch.zeros(1, len(self.model.facial_action_labels)),
        )
        return self.model._get_phenotype_blendshape_coefficients(shape[None], *none)[0]

    def random(self, seed: int) -> tuple[Tensor, Tensor, Tensor]:
        """Draw angles [J, 3], shape [6] and place [3]."""
        generator = torch.Generator().manual_seed(seed)
        low, high = self.ranges.unbind(1)
        share = 0.5 + 0.8 * (torch.rand(low.shape, generator=generator) - 0.5)
        shape = torch.rand(6, generator=generator)
        shape[1] = 0.5 + 0.5 * shape[1]  # grown up
        return low + share * (high - low), shape, 0.1 * torch.randn(3, generator=generator)


def cameras(seed: int, views: int, center: Tensor) -> nr.Camera:
    """Draw cameras that are 45° apart, and look beside the body."""
    generator = torch.Generator().manual_seed(10_000 + seed)
    azimuth, distance, slope, _ = torch.rand(4, generator=generator)
    center = center + 0.15 * torch.randn(3, generator=generator)
    turn = 2 * math.pi * azimuth + math.pi / 4 * torch.arange(views)
    direction = torch.stack((turn.sin(), -turn.cos(), torch.full_like(turn, 0.4 * float(slope))), 1)
    return nr.Camera.look_at(center + (4.2 + distance) * direction, at=center, up=(0.0, 0.0, 1.0), viewing_angle=20)


def main() -> None:
    """Fit one body, and write a picture: white where both silhouettes agree."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--keypoints", action="store_true", help="joints in the pictures are known")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--steps", type=int, default=12, help="of Gauss-Newton at each size; one view needs 40")
    parser.add_argument("-o", "--output", type=Path, default=Path("body.png"))
    options = parser.parse_args()
    body = Body()
    angles, shape, move = body.random(options.seed)
    pose = body.rig.pose(angles, body.weights(shape), translation=move)
    rest = body.rig.vertices()
    camera = cameras(options.seed, options.views, (rest.amin(0) + rest.amax(0)) / 2)
    masks = nr.render(body.rig.posed(pose), camera, options.size).alpha
    keypoints = None
    if options.keypoints:
        pixels = camera.project(body.rig.joints(pose), options.size)[0]
        keypoints = [{name: view[body.rig.names.index(name)].tolist() for name in body.joints} for view in pixels]
    found = nr.fit_rig(
        body.rig,
        camera,
        masks,
        keypoints,
        joints=body.joints,
        limits=body.limits,
        shape=RigShape(SHAPE, body.weights, bounds=(0.0, 1.0)),
        steps=options.steps,
    )
    truth, fitted = body.rig.vertices(pose), body.rig.vertices(found.pose)
    height = float((truth.amax(0) - truth.amin(0)).max())
    off = 100 / height * (truth - fitted) @ camera.rotation[0].T
    print(f"mean distance of vertices: {off.norm(dim=1).mean():.2f} % of the height")
    print(f"after a translation {(off - off.mean(0)).norm(dim=1).mean():.2f} %")
    print(f"along the first line of sight {off[:, 2].abs().mean():.2f} %, across {off[:, :2].norm(dim=1).mean():.2f} %")
    again = nr.render(body.rig.posed(found.pose), camera, options.size).alpha
    row, own = torch.cat(list(masks), 1), torch.cat(list(again), 1)
    nr.save_image(options.output, torch.stack((row, own, row)))


if __name__ == "__main__":
    main()
