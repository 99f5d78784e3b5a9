"""The operations `boundaries` and `neighbors` once more, as `reference` has the others: slow, in float64, and plain."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .operators import SHORTEST, degenerate, in_camera_space, pixel_centres

LEAST_RUN = 0.02  # no crossing counts more than the inverse of this
SMALL = 1.5  # pixels: faces of less area are often missed by all centres


def neighbors_reference(faces: Tensor, two_sided: bool, perspective: bool) -> Tensor:
    """The face beyond each edge, [B, F, 3] int32; see `neighbors`. However many faces meet at one edge."""
    result = torch.full(faces.shape[:3], -1, dtype=torch.int32)
    drawn = _drawn(faces, two_sided, perspective).tolist()
    for b, image in enumerate(faces.double().tolist()):
        edges = [(f, k) for f in range(len(image)) for k in range(3 if drawn[b][f] else 0)]
        # The same way along an edge for all its faces. (-0.0 equals 0.0 as a float, and so in a tuple and its hash.)
        ends = [sorted(tuple(image[f][(k + n) % 3]) for n in range(2)) for f, k in edges]
        third = [[p, q, image[f][(k + 2) % 3]] for (p, q), (f, k) in zip(ends, edges, strict=True)]
        side = _sides(torch.tensor(third, dtype=torch.float64).view(-1, 3, 3), perspective).tolist()
        meeting: dict[tuple[Any, ...], list[int]] = {}
        for n, (p, q) in enumerate(ends):
            meeting.setdefault((p, q), []).append(n)
        for numbers in meeting.values():
            for n in numbers:
                f, k = edges[n]
                result[b, f, k] = min((edges[m][0] for m in numbers if side[n] * side[m] < 0), default=-1)
    return result.to(faces.device)


def boundaries_reference(
    grad: Tensor,
    image: Tensor,
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    marks: Tensor | None = None,
) -> Tensor:
    """The gradient [B, F, 3, 3] through visibility, from the image's gradient ``grad``; see `boundaries`."""
    result = torch.zeros(faces.shape, dtype=torch.float64)
    beyond = neighbors_reference(faces, two_sided, perspective).cpu()
    drawn, side = _drawn(faces, two_sided, perspective).cpu(), _sides(faces, perspective).cpu()
    corners = faces.detach().double().cpu()
    for b in range(len(faces)):
        pull, color, shown = (m[b].detach().cpu() for m in (grad.double(), image.double(), face_index))
        for axis in range(2):
            scan = _Scan.of(pull, color, shown, corners[b], beyond[b], axis, perspective)
            for f in drawn[b].nonzero().flatten().tolist():
                for k in range(3):
                    if beyond[b, f, k] < 0 or (seams and not _sewn(marks, corners[b], beyond[b], b, f, k)):
                        to_start, to_end = _move(scan, f, k, bool(side[b, f] > 0))
                        result[b, f, k, axis] += to_start
                        result[b, f, (k + 1) % 3, axis] += to_end
            result[b] += _cut(pull, color, shown, corners[b], axis, perspective)
    return result.to(faces.device)


def _sewn(marks: Tensor | None, corners: Tensor, beyond: Tensor, b: int, f: int, k: int) -> bool:
    if marks is None:
        return False
    own, g = marks[min(b, len(marks) - 1)].tolist(), int(beyond[f, k])
    for m in range(3):
        if torch.equal(corners[g, [(m + 1) % 3, m]], corners[f, [k, (k + 1) % 3]]):
            return own[f][k][0] != 0 and own[g][m][1] == own[f][k][0]
    return False


class _Scan(NamedTuple):
    """One image as scan lines: rows from the bottom for axis 0, for the motion along x; columns for axis 1."""

    pulls: list[list[list[float]]]  # [line][pixel][channel]
    colors: list[list[list[float]]]
    shown: list[list[int]]
    places: list[list[tuple[float, float]]]  # [face][corner] in pixels: u across the lines, v along them
    depths: list[list[float]]
    beyond: list[list[int]]
    axis: int
    perspective: bool

    @classmethod
    def of(
        cls,
        grad: Tensor,
        image: Tensor,
        face_index: Tensor,
        corners: Tensor,
        beyond: Tensor,
        axis: int,
        perspective: bool,
    ) -> _Scan:
        maps = [m.flip(0) for m in (grad.permute(1, 2, 0), image.permute(1, 2, 0), face_index)]
        pulls, colors, shown = (m.transpose(0, 1).tolist() if axis else m.tolist() for m in maps)
        size = torch.tensor([face_index.shape[1], face_index.shape[0]], dtype=torch.float64)
        pixels = (size * corners[..., :2] + size - 1) / 2
        places = [[(c[1 - axis], c[axis]) for c in face] for face in pixels.tolist()]
        depths, next_faces = corners[..., 2].tolist(), beyond.tolist()
        return cls(pulls, colors, shown, places, depths, next_faces, axis, perspective)

    def leaves(self, f: int, u: int) -> dict[int, float]:
        """The edges of face f that line u crosses, and where: two, or none."""
        result = {}
        for k, (p, q) in enumerate(zip(self.places[f], self.places[f][1:] + self.places[f][:1], strict=True)):
            if (p[0] <= u) != (q[0] <= u):
                result[k] = p[1] + (q[1] - p[1]) * (u - p[0]) / (q[0] - p[0])
        return result

    def through(self, g: int, u: int, v: float) -> float:
        """Where line u leaves face g, which it entered at v."""
        return max([v, *self.leaves(g, u).values()], key=lambda end: abs(end - v))

    def area(self, f: int) -> float:
        """In pixels."""
        (au, av), (bu, bv), (cu, cv) = self.places[f]
        return abs((bu - au) * (cv - av) - (bv - av) * (cu - au)) / 2

    def middle(self, f: int) -> list[float] | None:
        """The colour of a pixel that shows a face near its middle, if there is one."""
        u, v = (math.floor(sum(place[n] for place in self.places[f]) / 3 + 0.5) for n in (0, 1))
        for x, y in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            i, j = (u + x, v + y) if self.axis else (u + y, v + x)
            if 0 <= i < len(self.shown) and 0 <= j < len(self.shown[0]) and self.shown[i][j] == f:
                return self.colors[i][j]
        return None

    def nearness(self, f: int, k: int) -> float:
        """Of a corner: larger is in front, and linear over the face on the screen."""
        return 1 / self.depths[f][k] if self.perspective else -self.depths[f][k]

    def nearness_at(self, f: int, u: float, v: float) -> float:
        """Of the plane of face f, but not beyond that of its corners: seen edge on, the plane goes anywhere."""
        arms = [(p[0] - u, p[1] - v) for p in self.places[f]]
        parts = [arms[i][0] * arms[j][1] - arms[i][1] * arms[j][0] for i, j in ((1, 2), (2, 0), (0, 1))]
        corners = [self.nearness(f, k) for k in range(3)]
        value = sum(part * corner for part, corner in zip(parts, corners, strict=True)) / sum(parts)
        if self.perspective and min(self.depths[f]) <= 0:
            return value
        return min(max(value, min(corners)), max(corners))


def _move(scan: _Scan, f: int, k: int, counter_clockwise: bool) -> tuple[float, float]:
    """What the lines across edge k of face f send to the coordinates along them of its start and its end."""
    (pu, pv), (qu, qv) = scan.places[f][k], scan.places[f][(k + 1) % 3]
    if abs(pu - qu) < SHORTEST or (scan.perspective and min(scan.depths[f][k], scan.depths[f][(k + 1) % 3]) <= 0):
        return 0.0, 0.0
    # Counter-clockwise around the face, its outside is on the right: that of an edge upward is at larger x, that of an
    # edge to the right at smaller y.
    d = 1 if (pu < qu) == (counter_clockwise == (scan.axis == 0)) else -1
    to_start = to_end = 0.0
    for u in range(max(0, math.ceil(min(pu, qu))), min(len(scan.shown), math.ceil(max(pu, qu)))):
        share = (u - pu) / (qu - pu)
        c = pv + share * (qv - pv)
        gain = _gain(scan, f, k, u, c, d, share)
        if not 0.5 <= c <= len(scan.shown[0]) - 1.5:
            gain *= 2  # of the pixel at the border centres show one half: it stands for the other
        to_start += (1 - share) * gain
        to_end += share * gain
    pixels = len(scan.shown[0]) / 2  # in a screen unit
    return d * pixels * to_start, d * pixels * to_end


def _gain(scan: _Scan, f: int, k: int, u: int, c: float, d: int, share: float) -> float:
    """What the loss changes by if edge k, which line u crosses at c, moves outward by a pixel there."""
    shown, colors, pulls = scan.shown[u], scan.colors[u], scan.pulls[u]
    inner = math.floor(c) if d > 0 else math.ceil(c)
    outer, before, behind = inner + d, inner - d, inner + 2 * d
    if not (0 <= inner < len(shown) and 0 <= outer < len(shown)) or shown[inner] == shown[outer]:
        return 0.0
    own, other, next_face = shown[inner], shown[outer], scan.beyond[f][k]
    away = abs(c - inner)
    if next_face >= 0:
        return _seam(scan, f, next_face, u, c, d)
    if own < 0:
        return 0.0

    # The chord of the line in the face, and in the next one beyond where it leaves; both up to a pixel.
    run = together = 1.0
    second = -1
    if not scan.perspective or min(scan.depths[f]) > 0:
        ((leaving, end),) = (item for item in scan.leaves(f, u).items() if item[0] != k)
        run = together = min(abs(end - c), 1.0)
        if run < 1:
            second = scan.beyond[f][leaving]
            if second >= 0:
                together = min(abs(scan.through(second, u, end) - c), 1.0)
    if own != f and (second < 0 or own != second):
        return 0.0
    run = max(run, LEAST_RUN)

    # How often, over sub-pixel shifts, the centres show the crossing.
    if other >= 0:
        height = (1 - share) * scan.nearness(f, k) + share * scan.nearness(f, (k + 1) % 3)
        if scan.nearness_at(other, u, c) >= height:
            return 0.0
    often = max(together, LEAST_RUN)

    # A pixel contains what is within half a pixel of its centre; a narrow face's centre is anywhere in it.
    part = away if together < 1 else float(away >= 0.5)
    continues = 0 <= before < len(shown) and shown[before] == own
    stands_in = own == f and second >= 0 and 0 <= before < len(shown) and shown[before] == second and not continues
    continues_outside = 0 <= behind < len(shown) and shown[behind] == other
    total = 0.0
    for n, pull in enumerate(pulls[inner]):
        inside, outside = colors[inner][n] / often, colors[outer][n] / often
        if continues:
            inside += away * (colors[inner][n] - colors[before][n]) / often
        elif stands_in:
            # The next face's colour as often as a centre shows either, and the difference as often as it shows f.
            inside = colors[before][n] / often + (colors[inner][n] - colors[before][n]) / run
        if continues_outside:
            outside += (1 - away) * (colors[outer][n] - colors[behind][n]) / often
        total += (inside - outside) * ((1 - part) * pull + part * pulls[outer][n])
    return total


def _seam(scan: _Scan, f: int, g: int, u: int, c: float, d: int) -> float:
    """The same for the edge between two faces of a surface; the first of the two takes it."""
    if g < f:
        return 0.0
    shown, colors, pulls = scan.shown[u], scan.colors[u], scan.pulls[u]
    inner = math.floor(c) if d > 0 else math.ceil(c)
    away = abs(c - inner)
    chords = [min(abs(scan.through(face, u, c) - c), 1.0) for face in (f, g)]
    often = 1.0
    if min(scan.area(f), scan.area(g)) < SMALL:  # its colour may be nowhere: wait for a pair of pixels that shows both
        if (shown[inner], shown[inner + d]) != (f, g):
            return 0.0
        often = max(sum(chords) - 1, LEAST_RUN)
    sides = []
    for face, chord, pixel, way, gap in zip((f, g), chords, (inner, inner + d), (-d, d), (away, 1 - away), strict=True):
        if shown[pixel] == face:
            near = colors[pixel]
            further = 0 <= pixel + way < len(shown) and shown[pixel + way] == face
            far = colors[pixel + way] if further else near
            sides.append([a + gap * (a - b) for a, b in zip(near, far, strict=True)])
        else:
            color = None if gap < chord else scan.middle(face)
            if color is None:
                return 0.0
            sides.append(color)
    part = away if often < 1 else float(away >= 0.5)
    pull = [(1 - part) * i + part * o for i, o in zip(pulls[inner], pulls[inner + d], strict=True)]
    return sum((a - b) * g / often for a, b, g in zip(*sides, pull, strict=True))


def _cut(grad: Tensor, image: Tensor, face_index: Tensor, corners: Tensor, axis: int, perspective: bool) -> Tensor:
    """What one image's lines of equal depth send to its faces [F, 3, 3], by their motion along ``axis``."""
    height, width = face_index.shape
    x, y = pixel_centres(height, width)

    def pair(values: Tensor) -> tuple[Tensor, Tensor]:
        """Of [..., H, W], those of each pixel and of the next one to the right, or above."""
        return (values[..., 1:, :], values[..., :-1, :]) if axis else (values[..., :-1], values[..., 1:])

    # Pairs of pixels that show two faces, wholly in front; those with an edge in common meet there and cut nowhere.
    f, g = (index.long() for index in pair(face_index))
    equal = (corners[f][..., :, None, :] == corners[g][..., None, :, :]).all(-1)
    one_surface = equal.sum((-2, -1)) >= 2
    front = ((corners[..., 2] > 0).all(-1) | (not perspective)) & ~degenerate(corners)
    chosen = (f >= 0) & (g >= 0) & (f != g) & ~one_surface & front[f] & front[g]
    f, g = f[chosen], g[chosen]
    (x, next_x), (y, next_y) = ((a[chosen], b[chosen]) for a, b in (pair(x), pair(y)))
    own, other = (m[:, chosen] for m in pair(image))
    pulls = [m[:, chosen] for m in pair(grad)]

    leaf = corners.clone().requires_grad_()

    def lead(at_x: Tensor, at_y: Tensor) -> Tensor:
        """By how much f is nearer than g."""
        return _nearness(leaf[f], at_x, at_y, perspective) - _nearness(leaf[g], at_x, at_y, perspective)

    here, there = lead(x, y).detach(), lead(next_x, next_y).detach()
    # Rows and columns share the motion by the squares of the components of the line's normal, in pixels.
    normal = torch.stack((lead(x + 2 / width, y), lead(x, y + 2 / height))).detach() - here
    share = normal[axis] ** 2 / (normal**2).sum(0)
    t = here / (here - there)
    cut_x, cut_y = x + t * (next_x - x), y + t * (next_y - y)
    gain = ((own - other) * torch.where(t < 0.5, pulls[0], pulls[1])).sum(0)
    # If f leads by more, the line moves towards g, by that over what the lead falls by within the pixel.
    amount = share * gain / (here - there)
    place, last = ((cut_y + 1) * height / 2 - 0.5, height - 1) if axis else ((cut_x + 1) * width / 2 - 0.5, width - 1)
    amount = torch.where((place < 0.5) | (place > last - 0.5), 2 * amount, amount)  # as in `_move`

    # Those whose line of equal depth lies between the two centres, in both faces.
    # Faces in one plane lead by rounding only, and cut nothing.
    least = 1e-12 * _nearness(corners[f], x, y, perspective).abs()
    valid = (here > least) & (there < -least)
    f, g = f[valid], g[valid]
    cut_x, cut_y, amount = cut_x[valid], cut_y[valid], amount[valid]
    both = [(_weights(corners[face], cut_x, cut_y) >= 0).all(-1) for face in (f, g)]
    loss = (torch.where(both[0] & both[1], amount, 0.0) * lead(cut_x, cut_y)).sum()
    return torch.autograd.grad(loss, leaf)[0]


def _drawn(faces: Tensor, two_sided: bool, perspective: bool) -> Tensor:
    """Which faces [B, F] can be drawn at all, near and far aside."""
    side, depth = _sides(faces, perspective), faces[..., 2]
    result = faces.isfinite().flatten(2).all(-1) & ((side > 0) | ((side < 0) & two_sided))
    if perspective:  # on the camera's plane itself a corner has no place on the screen
        result = result & (depth > 0).any(-1) & (depth != 0).all(-1)
    return result


def _sides(faces: Tensor, perspective: bool) -> Tensor:
    """As `sides`, but 0 to the last bit where two corners are equal."""
    faces = faces.double()
    space = in_camera_space(faces) if perspective else torch.cat((faces[..., :2], torch.ones_like(faces[..., 2:])), -1)
    p, q, r = space.unbind(-2)
    return (p * torch.linalg.cross(q - p, r - p)).sum(-1).sign()


def _weights(faces: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Barycentric weights [N, 3] of (x, y) in the faces [N, 3, 3] on the screen."""
    columns = torch.cat((faces[..., :2], torch.ones_like(faces[..., :1])), -1).mT
    return torch.linalg.solve(columns, torch.stack((x, y, torch.ones_like(x)), -1))


def _nearness(faces: Tensor, x: Tensor, y: Tensor, perspective: bool) -> Tensor:
    depth = faces[..., 2]
    return (_weights(faces, x, y) * (1 / depth if perspective else -depth)).sum(-1)
