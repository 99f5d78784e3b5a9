"""Pictures of meshes as a photographer would take them: smooth normals, a highlight, a soft shadow, a plain backdrop.

The renderer draws two images, the texture and the normals, and everything else is arithmetic on them: shading needs no
support from the rasteriser.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from ..camera import Camera, get_points_from_angles
from ..meshes.mesh import Mesh
from ..meshes.normals import vertex_normals
from ..meshes.uv_mesh import UVMesh
from ..rendering import render

_BACKDROP = (0.94, 0.945, 0.955), (0.80, 0.82, 0.85)  # at the top and at the bottom
_FADE = 0.12  # of a picture's sides, in which shadows end
_LAMP = (-0.45, 0.75, 0.55)  # towards the light, in the viewer's right, up and back


def corner_cubes(values: Tensor, faces: Tensor) -> Tensor:
    """Cubes [F, 2, 2, 2, C] that blend values [V, C] linearly across each face: its eight texels are multilinear."""
    grid = torch.stack(torch.meshgrid(*[torch.arange(2.0, device=values.device)] * 3, indexing="ij"), dim=-1)
    return torch.einsum("ijkc,fcd->fijkd", grid, values[faces.long()])


@torch.no_grad()
def photograph(
    mesh: Mesh | UVMesh,
    azimuth: float,
    elevation: float = 12.0,
    size: int | tuple[int, int] = 320,
    *,
    distance: float = 4.2,
    viewing_angle: float = 19.0,
    floor: float | None = None,
) -> Tensor:
    """One picture [3, H, W] in [0, 1] of a mesh within [-1, 1], seen from an angle (azimuth 180 is +z; degrees).

    ``floor`` is the height of the ground on which its shadow falls; without it the lowest vertex lies on the ground.
    """
    size = (size, size) if isinstance(size, int) else size
    vertices, faces = mesh.vertices, mesh.faces
    eye = torch.tensor(get_points_from_angles(distance, elevation, azimuth), device=vertices.device)
    camera = Camera.look_at(eye, viewing_angle=viewing_angle)
    right, up, forward = camera.rotation[0]
    lamp = F.normalize(_LAMP[0] * right + _LAMP[1] * up - _LAMP[2] * forward, dim=0)

    colour = render(mesh, camera, size, light=None, outputs=("rgb", "alpha"))
    cubes = corner_cubes(vertex_normals(vertices, faces)[0], faces)
    # Anti-aliased normals shrink towards the outline; normalising undoes that.
    normal = render((vertices, faces, cubes), camera, size, light=None, outputs="rgb").rgb
    normal = F.normalize(normal[0], dim=0)  # type: ignore[index]
    rgb, alpha = colour.rgb[0], colour.alpha[0]  # type: ignore[index]

    halfway = F.normalize(lamp - forward, dim=0)
    wrap = ((_dot(normal, lamp) + 0.25) / 1.25).clamp(min=0)  # light that reaches a little past the terminator
    sky = 0.5 + 0.5 * normal[1]
    gloss = 0.22 * _dot(normal, halfway).clamp(min=0) ** 40
    shaded = rgb * (0.34 + 0.20 * sky + 0.62 * wrap) + gloss * alpha

    ground = lowest(mesh) if floor is None else floor
    backdrop = _backdrop(size).to(rgb) * (1 - 0.45 * _shadow(mesh, camera, lamp, ground, size))
    return (shaded + backdrop * (1 - alpha)).clamp(0, 1)


def lowest(mesh: Mesh | UVMesh) -> float:
    """The height of the lowest vertex."""
    return mesh.vertices.detach()[:, 1].min().item()


def _dot(image: Tensor, vector: Tensor) -> Tensor:
    return torch.einsum("chw,c->hw", image, vector)


def _backdrop(size: tuple[int, int]) -> Tensor:
    top, bottom = (torch.tensor(colour)[:, None, None] for colour in _BACKDROP)
    return (top + (bottom - top) * torch.linspace(0, 1, size[0])[:, None]).expand(3, *size)


def _shadow(mesh: Mesh | UVMesh, camera: Camera, lamp: Tensor, ground: float, size: tuple[int, int]) -> Tensor:
    """How much of the ground is in shadow at each pixel [H, W]: the mesh pressed flat along the light, then blurred.

    Towards the picture's border it fades, or it would end there in a line beside the next picture of a sheet.
    """
    steep = F.normalize(lamp * lamp.new_tensor([1.0, 2.0, 1.0]), dim=0)
    flat = mesh.vertices - (mesh.vertices[:, 1:2] - ground) / steep[1] * steep
    shadow = render((flat, mesh.faces), camera, size, outputs="alpha").alpha[None]  # type: ignore[index]
    radius = max(size[0] // 40, 1)
    for _ in range(3):
        shadow = F.avg_pool2d(F.pad(shadow, [radius] * 4, mode="replicate"), 2 * radius + 1, stride=1)
    across, down = (((0.5 - (torch.linspace(0, 1, side) - 0.5).abs()) / _FADE).clamp(max=1) for side in size[::-1])
    border = (down[:, None] * across).to(shadow)
    return shadow[0, 0] * border * border * (3 - 2 * border)


def sheet(rows: Sequence[Sequence[Tensor]], labels: Sequence[str] = ()) -> Tensor:
    """Rows of pictures [3, H, W] of one size as one picture, each row with its label in the corner."""
    whole = torch.cat([torch.cat(list(row), dim=2) for row in rows], dim=1).cpu()
    pixels = (whole.permute(1, 2, 0) * 255 + 0.5).to(torch.uint8).numpy()
    image = Image.fromarray(pixels)
    height = rows[0][0].shape[1]
    font = ImageFont.load_default(max(height // 14, 10))
    for index, label in enumerate(labels):
        ImageDraw.Draw(image).text((height // 16, index * height + height // 20), label, (70, 76, 88), font)
    return torch.from_numpy(np.array(image))
