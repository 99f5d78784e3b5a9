"""Points inside a mesh, by Warp's winding numbers."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ....raster.warp.launch import launch, load_kernel

wp.set_module_options({"enable_backward": False})

# Number of points that justifies another CPU thread.
_MANY_POINTS = 2048


def inside(vertices: Tensor, faces: Tensor, points: Tensor, least: float = 0.5) -> Tensor:
    """Test which points [P, 3] float32 are inside a mesh, [P] bool, by winding numbers.

    A point is inside if its winding number is above ``least`` (Jacobson, Kavan and Sorkine-Hornung, "Robust
    inside-outside segmentation using generalized winding numbers", 2013). A hole affects only the points near it.
    Vertices [V, 3] float32 are on the CPU; faces [F, 3] int32 run counter-clockwise seen from outside.
    """
    result = torch.zeros(len(points), dtype=torch.uint8)
    load_kernel(_wind, "cpu")  # before Warp's first array, which would print a banner
    corners = wp.array(faces.reshape(-1).numpy(), dtype=int, device="cpu")
    mesh = wp.Mesh(wp.array(vertices.numpy(), dtype=wp.vec3, device="cpu"), corners, support_winding_number=True)
    arguments = [mesh.id, wp.from_torch(points.contiguous(), wp.vec3), least, wp.from_torch(result)]
    launch(_wind, len(points), arguments, points.device, _MANY_POINTS)
    return result == 1


@wp.kernel
def _wind(first: int, mesh: wp.uint64, points: wp.array(dtype=wp.vec3), least: float, result: wp.array(dtype=wp.uint8)):
    task = first + wp.tid()
    found = wp.mesh_query_point_sign_winding_number(mesh, points[task], 1.0e6, 2.0, least)
    result[task] = wp.where(found.result and found.sign < 0.0, wp.uint8(1), wp.uint8(0))
