"""The operations of nvdiffrast by their formulas, in float64 and plain torch, pixel by pixel where that is simplest."""

from __future__ import annotations

import itertools

import torch
from torch import Tensor


def centres(height: int, width: int) -> tuple[Tensor, Tensor]:
    """The pixels' centres on the screen, X [W] and Y [H], row 0 at the bottom."""
    x = (2 * torch.arange(width, dtype=torch.float64) + 1) / width - 1
    y = (2 * torch.arange(height, dtype=torch.float64) + 1) / height - 1
    return x, y


def weights(corners: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """The weights in space [..., 3] of triangles [..., 3, 4] on the rays through screen points (x, y)."""
    # The point is sum b_k p_k with x = X w and y = Y w: two linear equations, and sum b_k = 1.
    rows = torch.stack(
        (
            corners[..., 0] - x[..., None] * corners[..., 3],
            corners[..., 1] - y[..., None] * corners[..., 3],
            torch.ones_like(corners[..., 0]),
        ),
        -2,
    )
    right = torch.tensor([0.0, 0, 1], dtype=torch.float64).expand(*rows.shape[:-2], 3)
    return torch.linalg.solve(rows, right)


def layers(positions: Tensor, triangles: Tensor, height: int, width: int) -> Tensor:
    """The depth z / w of each triangle at each pixel, [B, F, H, W]; infinite where it is not seen."""
    x, y = centres(height, width)
    x, y = x.expand(height, width), y[:, None].expand(height, width)
    corners = positions.double()[:, triangles.long()][:, :, None, None]  # [B, F, 1, 1, 3, 4]
    b = weights(corners.expand(-1, -1, height, width, -1, -1), x, y)
    point = (b[..., None] * corners).sum(-2)
    depth = point[..., 2] / point[..., 3]
    seen = (b >= 0).all(-1) & (point[..., 3] > 0) & (depth.abs() <= 1)
    return torch.where(seen, depth, torch.inf)


def uv_and_changes(positions: Tensor, triangles: Tensor, shown: Tensor) -> tuple[Tensor, Tensor]:
    """(u, v) [N, 2] and their derivatives [N, 4] at the pixels that show a triangle; differentiable.

    The derivatives are central differences over 2e-4 pixels, whose error is far below that of float32.
    """
    height, width = shown.shape[1:]
    image, j, i = (shown >= 0).nonzero(as_tuple=True)
    own = positions.double()[image[:, None], triangles.long()[shown[image, j, i].long()]]
    x, y = centres(height, width)
    step = 1e-4
    at = weights(own, x[i], y[j])[:, :2]
    right = [weights(own, x[i] + way * step * 2 / width, y[j])[:, :2] for way in (1, -1)]
    up = [weights(own, x[i], y[j] + way * step * 2 / height)[:, :2] for way in (1, -1)]
    across, along = (right[0] - right[1]) / (2 * step), (up[0] - up[1]) / (2 * step)
    return at, torch.stack((across[:, 0], along[:, 0], across[:, 1], along[:, 1]), 1)


def cube_position(face: int, s: float | Tensor, t: float | Tensor) -> Tensor:
    """The point of a cube's surface at (s, t) of a face: OpenGL's table of major axes, solved for the direction."""
    s, t = torch.as_tensor(s, dtype=torch.float64) * 2 - 1, torch.as_tensor(t, dtype=torch.float64) * 2 - 1
    one = torch.ones_like(s)
    points = [(one, -t, -s), (-one, -t, s), (s, one, t), (s, -one, -t), (s, -t, one), (-s, -t, -one)]
    return torch.stack(points[face], -1)


def framed_cube(cube: Tensor) -> Tensor:
    """Faces [6, n, n, C] with the texels of the adjacent faces around them, [6, n + 2, n + 2, C].

    A texel beyond an edge is the one at the same place of the fold; one beyond a corner is the mean of the three there.
    """
    n = cube.shape[1]
    middle = (torch.arange(n, dtype=torch.float64) + 0.5) / n
    s, t = middle.expand(n, n), middle[:, None].expand(n, n)
    every = torch.stack([cube_position(face, s, t) for face in range(6)]).flatten(0, 2)
    texels = cube.flatten(0, 2)
    framed = cube.new_zeros(6, n + 2, n + 2, cube.shape[3])
    framed[:, 1:-1, 1:-1] = cube
    for face, (j, i) in itertools.product(range(6), itertools.product(range(n + 2), range(n + 2))):
        outside = [(at < 1) + (at > n) for at in (i, j)]
        if sum(outside) != 1:
            continue
        place = [min(max((at - 0.5) / n, 0.0), 1.0) for at in (i, j)]
        point = cube_position(face, *place)
        point[face // 2] *= 1 - 1 / n
        distance, nearest = (every - point).norm(dim=1).min(0)
        assert distance < 1e-9
        framed[face, j, i] = texels[nearest]
    last = n + 1
    for face, j, i in itertools.product(range(6), (0, last), (0, last)):
        jn, im = min(max(j, 1), n), min(max(i, 1), n)
        framed[face, j, i] = (framed[face, jn, im] + framed[face, j, im] + framed[face, jn, i]) / 3
    return framed


def _bilinear(image: Tensor, x: Tensor, y: Tensor, boundary: str) -> Tensor:
    """Sample [h, w, C] at x, y in texels, texel centres at whole numbers."""
    height, width = image.shape[:2]
    total = 0.0
    for down, right in itertools.product((0, 1), (0, 1)):
        i, j = x.detach().floor().long() + right, y.detach().floor().long() + down
        part = (1 - (x - i).abs()) * (1 - (y - j).abs())
        inside = (i >= 0) & (i < width) & (j >= 0) & (j < height)
        if boundary == "wrap":
            texel = image[j % height, i % width]
        else:
            texel = image[j.clamp(0, height - 1), i.clamp(0, width - 1)]
            if boundary == "zero":
                texel = texel * inside[..., None]
        total = total + part[..., None] * texel
    return total


def sample(level: Tensor, uv: Tensor, boundary: str, nearest: bool = False) -> Tensor:
    """Sample one level, [h, w, C] or [6, n, n, C], at coordinates or directions [..., 2 or 3]."""
    if boundary == "cube":
        n = level.shape[1]
        face, s, t = face_of(uv)
        flat = torch.cat(tuple(framed_cube(level)), 1)  # [n + 2, 6 (n + 2), C]
        x, y = s * n + 0.5, t * n + 0.5
        if nearest:
            x, y = x.round(), y.round()
        return _bilinear(flat, x + face * (n + 2), y, "zero")
    height, width = level.shape[:2]
    s, t = uv.unbind(-1)
    if boundary == "wrap":
        s, t = s - s.detach().floor(), t - t.detach().floor()
    x, y = s * width - 0.5, t * height - 0.5
    if boundary == "clamp":
        x, y = x.clamp(0, width - 1), y.clamp(0, height - 1)
    if nearest:
        x, y = x.round(), y.round()
    return _bilinear(level, x, y, boundary)


def face_of(directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The face of a cube that directions [..., 3] meet, and s and t there."""
    axis = directions.abs().argmax(-1)
    own = directions.gather(-1, axis[..., None])[..., 0]
    face = 2 * axis + (own < 0)
    x, y, z = directions.unbind(-1)
    s = torch.stack((-z, z, x, x, x, -x), -1).gather(-1, face[..., None])[..., 0]
    t = torch.stack((-y, -y, z, -z, -y, -y), -1).gather(-1, face[..., None])[..., 0]
    return face, (s / own.abs() + 1) / 2, (t / own.abs() + 1) / 2


def level_of(uv: Tensor, uv_da: Tensor, height: int, width: int) -> Tensor:
    """log2 of the larger singular value of the change of (s, t) by a pixel, in texels; before any limit."""
    change = uv_da.unflatten(-1, (uv.shape[-1], 2))
    if uv.shape[-1] == 3:
        flat, changes = uv.reshape(-1, 3), change.reshape(-1, 3, 2)
        columns = []
        for k in range(2):
            of = torch.func.jvp(lambda d: torch.stack(face_of(d)[1:], -1), (flat,), (changes[..., k].contiguous(),))[1]
            columns.append(of)
        change = torch.stack(columns, -1).reshape(*uv.shape[:-1], 2, 2)
    size = torch.tensor([width, height], dtype=torch.float64)[:, None]
    return torch.linalg.svdvals(change * size)[..., 0].log2()


def trilinear(levels: list[Tensor], uv: Tensor, level: Tensor, boundary: str) -> Tensor:
    """Blend the two levels around ``level`` [...]."""
    level = level.clamp(0, len(levels) - 1)
    result = 0.0
    for n, image in enumerate(levels):
        share = (1 - (level - n).abs()).clamp(min=0)
        result = result + share[..., None] * sample(image, uv, boundary)
    return result


def halved(image: Tensor) -> Tensor:
    """The mean of 2 x 2 texels of [..., h, w, C]; a side of 1 stays."""
    for axis in (-3, -2):
        if image.shape[axis] > 1:
            image = image.unflatten(axis, (-1, 2)).mean(axis)
    return image


def antialias(color: Tensor, shown: Tensor, depth: Tensor, positions: Tensor, triangles: Tensor) -> Tensor:
    """Blend adjacent pixels at silhouettes, pair by pair, on the screen; positions have w > 0."""
    batch, height, width = shown.shape
    screen = positions.double()[..., :2] / positions.double()[..., 3:]
    half = torch.tensor([width / 2, height / 2], dtype=torch.float64)
    points = (screen + 1) * half - 0.5  # pixels' centres are whole numbers
    edges: dict[tuple[int, int], list[int]] = {}
    faces = triangles.tolist()
    for a, b, c in faces:
        for p, q, opposite in ((a, b, c), (b, c, a), (c, a, b)):
            edges.setdefault((min(p, q), max(p, q)), []).append(opposite)
    result = color.clone()
    for image in range(batch):
        for j, i, upright in itertools.product(range(height), range(width), (False, True)):
            other = (j + 1, i) if upright else (j, i + 1)
            if other[0] >= height or other[1] >= width:
                continue
            first, second = int(shown[image, j, i]), int(shown[image][other])
            if first == second:
                continue
            near, far, way = (j, i), other, 1
            if first < 0 or (second >= 0 and depth[image][other] < depth[image, j, i]):
                near, far, way = other, near, -1
            face = faces[int(shown[image][near])]
            for k in range(3):
                p, q, own = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
                start, end = points[image, p], points[image, q]
                sides = [_side(start, end, points[image, one]) for one in edges[min(p, q), max(p, q)]]
                mine = _side(start, end, points[image, own])
                if any(mine * side < 0 for side in sides):
                    continue
                along, across = (1, 0) if upright else (0, 1)
                run, rise = (end - start)[along], (end - start)[across]
                if abs(rise) < abs(run) or (upright and abs(rise) == abs(run)):
                    continue
                part = (near[0 if across else 1] - start[across]) / rise
                if not 0 <= part <= 1:
                    continue
                d = way * (start[along] + part * run - near[0 if along else 1])
                if not 0 <= d <= 1:
                    continue
                alpha = d - 0.5
                changed = far if alpha > 0 else near
                change = alpha * (color[image][near] - color[image][far])
                at = torch.zeros(batch, height, width, 1, dtype=torch.float64)
                at[image, changed[0], changed[1]] = 1
                result = result + at * change
                break
    return result


def _side(p: Tensor, q: Tensor, r: Tensor) -> float:
    p, q, r = p.detach(), q.detach(), r.detach()
    return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))
