"""Pictures and turntables of meshes with smooth shading, a highlight, a soft shadow and a plain backdrop.

The renderer draws colours and normals; the light on them is arithmetic on these two images.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ....camera import Camera, get_points_from_angles
from ....meshes.batch import mesh_parts
from ....meshes.mesh import Mesh
from ....meshes.normals import vertex_normals
from ....meshes.uv_mesh import UVMesh
from ....rendering import deferred
from ....rendering.forward import flat_colors, render
from ....shading.lights import CameraLight

FIRST_AZIMUTH = 145.0
"""Azimuth of the first picture of a turntable in degrees: nearly a front view."""
LAMP = (-0.4305284, 0.7653838, 0.4783649)
"""Direction of the lamp of pictures, as of `CameraLight`: over the viewer's left shoulder."""
_BACKDROP_TOP, _BACKDROP_BOTTOM = (0.94, 0.945, 0.955), (0.80, 0.82, 0.85)
_AMBIENT, _SKY, _DIFFUSE = 0.34, 0.20, 0.62  # light from everywhere, from above, and from the lamp
_WRAP = 0.25  # cosine by which the lamp's light reaches beyond the terminator
_GLOSS, _SHININESS = 0.22, 40  # strength and exponent of the highlight (Blinn-Phong)
_SHADOW = 0.45  # share of light that a full shadow takes away
_SHADOW_STEEPNESS = 2.0  # height of the shadow's lamp, relative to the lamp: shadows stay short
_SHADOW_BLUR = 1 / 40  # radius of the box blur, relative to the height of the picture
_TOGETHER, _MOST_PIXELS = 6, 6 * 512**2  # largest batch of a turntable: pictures, and their pixels
_SHADOW_FADE = 0.12  # width of the border, relative to the sides, in which the shadow fades out


@torch.no_grad()
def photograph(
    mesh: Mesh | UVMesh,
    azimuth: float | Sequence[float],
    elevation: float = 12.0,
    size: int | tuple[int, int] = 320,
    *,
    distance: float = 4.2,
    viewing_angle: float = 19.0,
    floor: float | None = None,
) -> Tensor:
    """Draw a mesh in about [-1, 1]³ with studio light and a shadow on the ground: [3, H, W] float32 in [0, 1].

    Several azimuths give [N, 3, H, W], in less time than one after the other. Angles are in degrees, as in
    `get_points_from_angles`; the viewing angle is half the vertical field of view. The floor is the height of the
    ground, by default that of the lowest vertex.
    """
    size = (size, size) if isinstance(size, int) else size
    azimuths = torch.as_tensor(azimuth, dtype=torch.float32, device=mesh.vertices.device)
    eye = get_points_from_angles(distance, elevation, azimuths.reshape(-1))
    camera = Camera.look_at(eye, viewing_angle=viewing_angle)
    lamp, forward = torch.as_tensor(CameraLight(direction=LAMP).at(camera).direction), camera.forward

    fragments = deferred.fragments(mesh, camera, size)
    images = fragments.images(("rgb", "alpha"), *flat_colors(fragments, mesh, mesh_parts(mesh)[2], None, 0.0))
    normal = fragments.composite(fragments.interpolate(vertex_normals(mesh.vertices, mesh.faces)))
    normal = normal * _dot(normal, normal).clamp(min=1e-24).rsqrt()  # anti-aliasing shortens them at the outline
    alpha = images.alpha[:, None]

    ground = lowest_point(mesh) if floor is None else floor
    backdrop = _backdrop(size).to(alpha) * (1 - _SHADOW * _shadow(mesh, camera, lamp, ground, size))
    pictures = (_shade(images.rgb, alpha, normal, lamp, forward) + backdrop * (1 - alpha)).clamp(0, 1)
    return pictures.reshape(*azimuths.shape, *pictures.shape[1:])


def turntable(
    mesh: Mesh | UVMesh,
    frames: int,
    first_azimuth: float = FIRST_AZIMUTH,
    *,
    size: int | tuple[int, int] = 320,
    **view: Any,
) -> Iterator[Tensor]:
    """Photograph a mesh in about [-1, 1]³ during one turn around the y axis; the rest goes to `photograph`.

    Returns pictures [3, H, W] float32 in [0, 1], on the CPU, one at a time.
    """
    height, width = (size, size) if isinstance(size, int) else size
    together = max(1, min(_TOGETHER, _MOST_PIXELS // (height * width)))
    angles = [first_azimuth + 360 * index / frames for index in range(frames)]
    for first in range(0, frames, together):
        yield from photograph(mesh, angles[first : first + together], size=size, **view).cpu()


def lowest_point(mesh: Mesh | UVMesh) -> float:
    """Return the height of the lowest vertex."""
    return mesh.vertices.detach()[:, 1].min().item()


def _shade(rgb: Tensor, alpha: Tensor, normal: Tensor, lamp: Tensor, forward: Tensor) -> Tensor:
    """Light the colours [N, 3, H, W] of surfaces with normals [N, 3, H, W]; vectors are [N, 3]."""
    halfway = F.normalize(lamp - forward, dim=1)
    diffuse = ((_dot(normal, lamp) + _WRAP) / (1 + _WRAP)).clamp(min=0)
    sky = 0.5 + 0.5 * normal[:, 1:2]
    gloss = _GLOSS * _dot(normal, halfway).clamp(min=0) ** _SHININESS
    return rgb * (_AMBIENT + _SKY * sky + _DIFFUSE * diffuse) + gloss * alpha


def _dot(images: Tensor, vectors: Tensor) -> Tensor:
    """Multiply images [N, 3, H, W] by others or by vectors [N, 3], [N, 1, H, W]."""
    return (images * vectors.reshape(*vectors.shape, *[1] * (images.dim() - vectors.dim()))).sum(1, keepdim=True)


def _backdrop(size: tuple[int, int]) -> Tensor:
    """Make a vertical gradient [3, H, W]."""
    top, bottom = (torch.tensor(color)[:, None, None] for color in (_BACKDROP_TOP, _BACKDROP_BOTTOM))
    return (top + (bottom - top) * torch.linspace(0, 1, size[0])[:, None]).expand(3, *size)


def _shadow(mesh: Mesh | UVMesh, camera: Camera, lamp: Tensor, ground: float, size: tuple[int, int]) -> Tensor:
    """Draw the shadows on the ground, [N, 1, H, W] in [0, 1]: the mesh projected along the light, then blurred.

    It fades out towards the border, because a sheet of pictures would show its end as a line.
    """
    steep = (lamp * lamp.new_tensor([1.0, _SHADOW_STEEPNESS, 1.0]))[:, None]
    flat = mesh.vertices - (mesh.vertices[:, 1:2] - ground) / steep[..., 1:2] * steep
    half = max(size[0] // 2, 1), max(size[1] // 2, 1)  # the blur leaves nothing finer
    shadow = render((flat, mesh.faces), camera, half, outputs="alpha").alpha[:, None]
    radius = max(int(half[0] * _SHADOW_BLUR), 1)
    rows, columns = (_blur(*lengths, radius).to(shadow) for lengths in zip(half, size, strict=True))
    shadow = rows @ shadow @ columns.t()
    across, down = (((0.5 - (torch.linspace(0, 1, n) - 0.5).abs()) / _SHADOW_FADE).clamp(max=1) for n in size[::-1])
    border = (down[:, None] * across).to(shadow)
    return shadow * border * border * (3 - 2 * border)


def _blur(count: int, wanted: int, radius: int) -> Tensor:
    """Make the matrix [wanted, count] that blurs numbers along an axis, and then resizes it, linearly."""
    lines = torch.eye(count)[:, None]
    for _ in range(3):  # three box blurs are close to a Gaussian
        lines = F.avg_pool1d(F.pad(lines, [radius] * 2, mode="replicate"), 2 * radius + 1, stride=1)
    return F.interpolate(lines, wanted, mode="linear", align_corners=False)[:, 0].t()
