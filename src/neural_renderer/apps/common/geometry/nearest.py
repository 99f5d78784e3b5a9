"""Points of a mesh near other points, by Warp's bounding volume hierarchy."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ....raster.warp.launch import launch, load_kernel

wp.set_module_options({"enable_backward": False})

# Number of points that justifies another CPU thread.
_MANY_POINTS = 1024
_FAR = wp.constant(1.0e18)  # whose square float32 can hold


class NearestFaces:
    """Search for the faces of a mesh near points, on the CPU.

    Vertices [V, 3] float32 are finite, about in [-1, 1]³; faces [F, 3] are whole numbers. Results are faces [N] int64
    and the weights [N, 3] float32 of their corners.
    """

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        load_kernel(_seek, "cpu")  # before Warp's first array, which would print a banner
        points = vertices.detach().float().cpu().contiguous()
        corners = faces.int().cpu().contiguous()
        self._kept = points, corners  # Warp reads their memory
        indices = wp.array(corners.numpy().reshape(-1), dtype=int, device="cpu")
        self._mesh = wp.Mesh(wp.array(points.numpy(), dtype=wp.vec3, device="cpu"), indices)

    def closest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Find the closest point of the mesh to each of N points."""
        return self.along(points, torch.zeros_like(points), 0.0)

    def along(self, points: Tensor, directions: Tensor, reach: float) -> tuple[Tensor, Tensor]:
        """Find the nearest point on the line through each point, at most ``reach`` away, on a face with its normal to
        the same side as the unit direction; else the closest point of the mesh.
        """
        count = len(points)
        face = torch.empty(count, dtype=torch.int32)
        weights = torch.empty(count, 3)
        given = [wp.from_torch(part.float().contiguous(), wp.vec3) for part in (points, directions)]
        arguments = [self._mesh.id, *given, reach, wp.from_torch(face), wp.from_torch(weights, wp.vec3)]
        launch(_seek, count, arguments, points.device, _MANY_POINTS)
        return face.long(), weights


@wp.kernel
def _seek(
    first: int,
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    reach: float,
    face: wp.array(dtype=int),
    weights: wp.array(dtype=wp.vec3),
):
    task = first + wp.tid()
    point = points[task]
    along = directions[task]
    best = reach
    found = -1
    u = 0.0
    v = 0.0
    if reach > 0.0:
        step = 1.0e-3 * reach  # a ray that begins on a face may miss it
        for side in range(2):
            towards = wp.where(side == 0, along, -along)
            hit = wp.mesh_query_ray(mesh, point - step * towards, towards, reach)
            if hit.result and wp.abs(hit.t - step) < best and wp.dot(hit.normal, along) > 0.0:
                best = wp.abs(hit.t - step)
                found = hit.face
                u = hit.u
                v = hit.v
    if found < 0:
        near = wp.mesh_query_point_no_sign(mesh, point, _FAR)
        found = near.face
        u = near.u
        v = near.v
    face[task] = found
    weights[task] = wp.vec3(u, v, 1.0 - u - v)
