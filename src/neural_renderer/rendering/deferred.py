"""Deferred shading: `fragments` for shaders in torch, from which images with all gradients are composed."""

from __future__ import annotations

from typing import overload

from torch import Tensor

from ..base import validate
from ..camera import Camera
from ..camera.screen import causes, scene_camera, screen_corners
from ..meshes.batch import mesh_parts
from ..meshes.mesh import Mesh
from ..meshes.uv_mesh import UVMesh
from ..raster.ahead import ATTRIBUTES, PROJECTION, load_kernels
from ..raster.depth_limits import tell_what_is_cut
from ..raster.fragments import Fragments, Layers, visible_fragments, visible_layers
from ..raster.settings import Settings
from ..raster.visibility.estimators import Estimator


@overload
def fragments(
    mesh: Mesh | UVMesh | list[Mesh] | list[UVMesh] | tuple[Tensor, ...],
    camera: Camera | None,
    size: int | tuple[int, int] = 256,
    *,
    near: float | None = None,
    far: float | None = None,
    anti_aliasing: bool = True,
    two_sided: bool = True,
    gradient: str | Estimator = "edge",
    eps: float = 1e-3,
    layers: None = None,
) -> Fragments: ...


@overload
def fragments(
    mesh: Mesh | UVMesh | list[Mesh] | list[UVMesh] | tuple[Tensor, ...],
    camera: Camera | None,
    size: int | tuple[int, int] = 256,
    *,
    near: float | None = None,
    far: float | None = None,
    anti_aliasing: bool = True,
    two_sided: bool = True,
    gradient: str | Estimator = "edge",
    eps: float = 1e-3,
    layers: int,
) -> Layers: ...


@validate.checked_together
def fragments(
    mesh: Mesh | UVMesh | list[Mesh] | list[UVMesh] | tuple[Tensor, ...],
    camera: Camera | None,
    size: int | tuple[int, int] = 256,
    *,
    near: float | None = None,
    far: float | None = None,
    anti_aliasing: bool = True,
    two_sided: bool = True,
    gradient: str | Estimator = "edge",
    eps: float = 1e-3,
    layers: int | None = None,
) -> Fragments | Layers:
    """Rasterise a mesh from every camera of a batch, for deferred shading.

    Under anti-aliasing, the default, fragments have twice the size of the images, so that `Fragments.composite` can
    average 2 x 2 of them. Without it, they have the size of the images.

    Args:
        mesh: `Mesh` or `UVMesh`; a list of either, of any sizes, one per image (see `batch`); or (vertices, faces) with
            vertices [V, 3] or [B, V, 3] floating and faces [F, 3] or [B, F, 3] integer.
        camera: One camera or B of them; None for vertices in clip space, [V, 4] or [B, V, 4], whose depth is w.
        size, near, far, anti_aliasing, two_sided, gradient, eps: As in `render`.
        layers: Number of the nearest faces of each pixel, for transparency and cut-outs; None for `Fragments` of
            the visible faces. Faces nearer to each other than 1e-5 of their depth count as one.

    Returns:
        Fragments, or with ``layers`` a sequence of them, `Layers`. Their H and W are twice ``size`` under
        anti-aliasing.

    Raises:
        TypeError, ValueError: An argument does not fit.

    Example:
        >>> fragments = nr.fragments(mesh, camera, 64)
        >>> normals = torch.nn.functional.normalize(fragments.interpolate(mesh.vertices), dim=-1)
        >>> fragments.composite(normals.clamp(min=0), background=1.0).shape
        torch.Size([1, 3, 64, 64])
    """
    vertices, faces, _ = mesh_parts(mesh)
    vertices, camera = scene_camera(vertices, camera)
    settings = Settings.checked(size, near, far, eps, anti_aliasing, two_sided, camera.perspective, gradient)
    load_kernels(settings, ("rgb",), ATTRIBUTES, *causes(vertices, camera), scene=PROJECTION)
    corners, faces = screen_corners(camera, vertices, faces, settings.width / settings.height)
    tell_what_is_cut(corners, near, far)
    if layers is None:
        return visible_fragments(corners, faces, vertices.shape[-2], settings, 8)
    return visible_layers(corners, faces, vertices.shape[-2], settings, validate.whole("layers", layers, 1))
