"""Programs with wrong accesses to memory, which the sanitizers have to find: ``wrong.py NAME FOLDER``."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from torch import Tensor

from neural_renderer.raster.warp.native import struct
from tests.native.kernels import NativeKernels


def gather(kernels: NativeKernels, name: str, vertices: Tensor, corners: Tensor, groups: int) -> None:
    """Run a kernel of corners.h for 4 faces of ``vertices`` [1, V, 3], whose corners are 0, 1, 2, … modulo V.

    Args:
        kernels: Compiled ones.
        name: ``gather_corners`` or ``gather_corners_backward``.
        vertices: [1, V, 3] float32.
        corners: [1, 4, 3, 3] float32.
        groups: Tasks, to which the faces are given.
    """
    faces = torch.arange(12, dtype=torch.int32).reshape(1, 4, 3) % vertices.shape[1]
    call = struct("corners.h", "GatherCorners")(
        triangles=struct("corners.h", "Triangles")(indices=faces, images=1, count=4, vertices=vertices.shape[1]),
        tasks=struct("corners.h", "Groups")(groups=groups, each=4 // groups),
        channels=3,
        vertices=vertices,
        corners=corners,
    )
    kernels.run("corners.h", name, call, tasks=groups)


def address(folder: Path) -> None:
    """Gather the corners of 4 faces into a tensor that has room for 3."""
    kernels = NativeKernels(folder, "address")
    gather(kernels, "gather_corners", torch.rand(1, 5, 3), torch.zeros(1, 3, 3, 3), groups=1)


def thread(folder: Path) -> None:
    """Add to the same vertex in several tasks, without atomics."""
    kernels = NativeKernels(folder, "thread", threads=4)
    gather(kernels, "gather_corners_backward", torch.zeros(1, 1, 3), torch.rand(1, 4, 3, 3), groups=4)


if __name__ == "__main__":
    {"address": address, "thread": thread}[sys.argv[1]](Path(sys.argv[2]))
