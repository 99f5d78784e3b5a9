"""Rigs in `neural-renderer render`: meshes at times of their animations."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from ...meshes.bounds import bounding_box
from ...meshes.rigs import Pose, Rig
from ...meshes.uv_mesh import UVMesh
from .options import RenderOptions

_MOST_FRAMES = 100_000


class Animated:
    """A rig at one time or at all frames, normalised by the bounding box of all of them."""

    def __init__(self, options: RenderOptions, grey: float, device: torch.device) -> None:
        self._rig = Rig.load(options.meshes[0], grey, options.allow_outside).to(device)
        animation: str | int = 0 if options.animation is None else options.animation
        if isinstance(animation, str) and animation.isdigit() and animation not in (self._rig.animations or {}):
            animation = int(animation)
        if options.time is not None:
            times = torch.tensor([options.time], dtype=torch.float64)
        else:
            count = max(1.0, self._rig.duration(animation) * options.fps)
            if count > _MOST_FRAMES:
                raise ValueError(f"fps: expected at most {_MOST_FRAMES} pictures, got {count:.0f}")
            times = torch.arange(round(count), dtype=torch.float64) / options.fps
        self._poses = self._rig.animated(times, animation)
        self._vertices = [self._rig.vertices(self._pose(number)) for number in range(len(times))]
        self._box = None
        if options.normalize and options.camera is None:
            center, half = bounding_box(
                torch.stack([part for all_ in self._vertices for part in (all_.amin(0), all_.amax(0))])
            )
            if half == 0:
                raise ValueError(f"{options.meshes[0]}: expected a mesh to normalise, got vertices that all coincide")
            self._box = center, half

    def __len__(self) -> int:
        return len(self._vertices)

    def __iter__(self) -> Iterator[UVMesh]:
        return (self._mesh(number) for number in range(len(self)))

    def whole(self) -> UVMesh:
        """Return the frame that extends farthest from the origin, so that a camera which shows it shows all."""
        sizes = [float(self._placed(vertices).norm(dim=1).max()) for vertices in self._vertices]
        return self._mesh(max(range(len(self)), key=sizes.__getitem__))

    def _pose(self, number: int) -> Pose:
        return Pose(*(part[number] for part in self._poses))

    def _placed(self, vertices: torch.Tensor) -> torch.Tensor:
        return vertices if self._box is None else (vertices - self._box[0]) / self._box[1]

    def _mesh(self, number: int) -> UVMesh:
        mesh: UVMesh = self._rig.posed(self._pose(number))
        return mesh.replace(vertices=self._placed(mesh.vertices))
