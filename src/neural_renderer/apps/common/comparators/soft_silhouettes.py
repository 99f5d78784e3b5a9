"""Soft silhouettes, for comparison with the estimators of exact images.

Source: Liu, Li, Chen and Li, "Soft Rasterizer: A differentiable renderer for image-based 3D reasoning", ICCV 2019,
equations 1 and 2. Each face covers a pixel with the probability

    D = sigmoid(± d² / sigma),

where d is the distance from the pixel's centre to the outline of the face; + inside of it. The silhouette is the
probability that any face covers the pixel, as if they were independent: 1 - product(1 - D).

So outlines are blurred over some √sigma, and the image has all derivatives. It is another image than the exact one:
half covered along outlines, more where faces overlap or where edges meet inside a surface, and wider for small faces.

The code is plain torch. Pairs of a face and a pixel are listed where D exceeds 10⁻⁴, by the box around each face; so
memory grows with the sum of their areas.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ....base import validate
from ....raster.settings import image_size

LEAST = 1e-4  # probability below which a face outside is left out


@validate.checked_together
def soft_silhouettes(faces: Tensor, size: int | tuple[int, int], *, sigma: float = 1e-4) -> Tensor:
    """Draw silhouettes with outlines blurred as in SoftRas (Liu et al., 2019), for comparison.

    Hidden faces and back sides count as well. The image has derivatives of all orders, in float64, too.

    Args:
        faces: Screen-space corners as for `rasterize_images`, [B, F, 3, 3] floating, from a perspective camera. Faces
            with a corner behind the camera are left out.
        size: Side of the images, or (height, width), in pixels.
        sigma: Width of the blur in squared screen units, > 0; outlines fade over about its root. The screen is two
            units wide, so 1e-4 is 0.6 pixels at a width of 128.

    Returns:
        [B, H, W] in [0, 1], of the type of ``faces``.

    Raises:
        TypeError, ValueError: An argument does not fit.

    Example:
        >>> vertices, triangles = nr.icosphere(1)
        >>> camera = nr.Camera.look_at((0.0, 0.0, -2.7))
        >>> nr.soft_silhouettes(nr.vertices_to_faces(camera(vertices), triangles), 32).shape
        torch.Size([1, 32, 32])
    """
    faces = validate.floating("faces", faces, ("B", "F", 3, 3))
    height, width = image_size("size", size)
    sigma = validate.positive("sigma", sigma)
    batch, count = faces.shape[:2]
    reach = math.sqrt(sigma * math.log(1 / LEAST - 1))
    with torch.no_grad():
        face, row, column = near_pairs(faces, height, width, reach)
    x, y = (2 * column + 1 - width).to(faces.dtype) / width, (height - 1 - 2 * row).to(faces.dtype) / height
    distance, _ = signed_squares(faces[..., :2].reshape(-1, 3, 2), face, torch.stack((x, y)))
    uncovered = torch.nn.functional.softplus(distance / sigma)  # -log(1 - D)
    uncovered = torch.where(distance > -(reach**2), uncovered, 0.0)
    pixel = (face // max(count, 1) * height + row) * width + column
    total = torch.zeros(batch * height * width, dtype=faces.dtype, device=faces.device).index_add(0, pixel, uncovered)
    return -torch.expm1(-total).view(batch, height, width)


def near_pairs(faces: Tensor, height: int, width: int, reach: float) -> tuple[Tensor, Tensor, Tensor]:
    """List the pixels around each face: numbers of faces (over the batch), rows and columns, [N] each."""
    flat = faces.detach().reshape(-1, 3, 3).double()
    low, high = flat.amin(1) - reach, flat.amax(1) + reach
    left, right = ((low[:, 0] + 1) * width - 1) / 2, ((high[:, 0] + 1) * width - 1) / 2
    top, bottom = ((1 - high[:, 1]) * height - 1) / 2, ((1 - low[:, 1]) * height - 1) / 2
    left, right = left.ceil().clamp(0, width), right.floor().clamp(-1, width - 1)
    top, bottom = top.ceil().clamp(0, height), bottom.floor().clamp(-1, height - 1)
    across, down = (right - left + 1).clamp(min=0).long(), (bottom - top + 1).clamp(min=0).long()
    seen = (flat[:, :, 2] > 0).all(1) & flat.isfinite().flatten(1).all(1)
    counts = torch.where(seen, across * down, 0)
    face = torch.repeat_interleave(torch.arange(len(flat), device=flat.device), counts)
    place = torch.arange(len(face), device=flat.device) - (counts.cumsum(0) - counts)[face]
    row = top.long()[face] + torch.div(place, across[face], rounding_mode="floor")
    return face, row, left.long()[face] + place % across[face]


def signed_squares(corners: Tensor, face: Tensor, point: Tensor) -> tuple[Tensor, Tensor]:
    """Compute squared distances of points [2, N] to the outlines of their faces, rows of ``corners`` [F, 3, 2].

    Returns:
        The squares, above zero inside and below outside, [N], and the cross products of each edge and the arm from its
        start to the point, [3, N].
    """
    start = corners.permute(2, 1, 0)
    along = start.roll(-1, 1) - start
    length = along.square().sum(0)
    start, along, length = (at_pairs(each, face) for each in (start, along, torch.where(length > 0, length, 1.0)))
    arm = point[:, None] - start
    share = (arm * along).sum(0) / length
    square = (arm - share.clamp(0, 1) * along).square().sum(0).amin(0)
    side = along[0] * arm[1] - along[1] * arm[0]
    inside = (side > 0).all(0) | (side < 0).all(0)
    return torch.where(inside, square, -square), side


def at_pairs(values: Tensor, face: Tensor) -> Tensor:
    """Gather values [..., F] of the faces of N pairs, [..., N]; each number of a face is one row of memory."""
    rows = values.flatten(0, -2)
    return rows.gather(1, face.expand(len(rows), -1)).view(*values.shape[:-1], len(face))
