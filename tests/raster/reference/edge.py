"""Float64 reference of the estimator "edge", `edge_gradient`, formula by formula.

The maths is in `raster/visibility/edge.py`. Time grows with faces times the side of the image: use small scenes.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .intersections import intersections_reference
from .neighbors import drawn_faces, exact_sides, neighbors_reference
from .nmr import SHORTEST

LEAST_CHORD = 0.02  # pixels; the weight of a crossing is at most the inverse
SMALL = 1.5  # largest area of a small face in pixels
LONGEST = 6  # most faces of a chain behind an outline
SAME_DEPTH, SAME_PLACE = 1e-5, 0.02  # two surfaces meet at an edge: relative nearness, pixels


def edge_gradient_reference(
    grad: Tensor,
    image: Tensor,
    faces: Tensor,
    face_index: Tensor,
    two_sided: bool,
    perspective: bool,
    seams: bool,
    edge_hashes: Tensor | None = None,
    layered: bool = False,
) -> Tensor:
    """Compute the gradient to the faces, [B, F, 3, 3] float64; see `edge_gradient`.

    Args:
        grad: Gradient to the image, [B, C, H, W].
        image, faces, face_index, two_sided, perspective, seams, edge_hashes: As in `edge_gradient`.
        layered: Whether this is a layer of several, in which edges behind folds are visible, and left out.
    """
    moved = torch.zeros(faces.shape, dtype=torch.float64)
    result = moved.tolist()  # lists, for single numbers of tensors are slow
    adjacent = neighbors_reference(faces, two_sided, perspective).tolist()
    drawn, side = drawn_faces(faces, two_sided, perspective).tolist(), exact_sides(faces, perspective).tolist()
    corners = faces.detach().double().cpu()
    points = corners.tolist()
    folds = neighbors_reference(faces, two_sided, perspective, folds=True).tolist() if layered else adjacent
    hashes = None if edge_hashes is None else edge_hashes.tolist()
    for b in range(len(faces)):
        pull, color, shown = (m[b].detach().cpu() for m in (grad.double(), image.double(), face_index))
        for axis in range(2):
            scan = _Scan.of(pull, color, shown, corners[b], adjacent[b], axis, perspective)
            for f, k in itertools.product([f for f, seen in enumerate(drawn[b]) if seen], range(3)):
                is_outline = adjacent[b][f][k] < 0
                if not is_outline and not (seams and _is_seam(hashes, points[b], adjacent[b], b, f, k)):
                    continue
                other = folds[b][f][k]
                if layered and is_outline and other >= 0 and _in_front(scan, other, f, (k + 2) % 3):
                    continue
                to_start, to_end = _move_edge(scan, f, k, side[b][f] > 0)
                result[b][f][k][axis] += to_start
                result[b][f][(k + 1) % 3][axis] += to_end
            moved[b] += intersections_reference(pull, color, shown, corners[b], axis, perspective)
    return (moved + torch.tensor(result, dtype=torch.float64).view_as(moved)).to(faces.device)


def _in_front(scan: _Scan, other: int, f: int, k: int) -> bool:
    """Test whether the plane of a face lies in front of corner k of face f."""
    if scan.perspective and min(*scan.depths[other], scan.depths[f][k]) <= 0:
        return False
    arms = [(p[0] - scan.places[f][k][0], p[1] - scan.places[f][k][1]) for p in scan.places[other]]
    parts = [arms[i][0] * arms[j][1] - arms[i][1] * arms[j][0] for i, j in ((1, 2), (2, 0), (0, 1))]
    value = sum(part * scan.nearness(other, n) for n, part in enumerate(parts)) / sum(parts)
    return value > scan.nearness(f, k)


def _is_seam(
    hashes: list[Any] | None, corners: list[list[list[float]]], adjacent: list[list[int]], b: int, f: int, k: int
) -> bool:
    """Test whether the hashes of edge k of face f differ from those of the same edge of the adjacent face."""
    if hashes is None:
        return True
    own, g = hashes[min(b, len(hashes) - 1)], adjacent[f][k]
    for m in range(3):
        if corners[g][(m + 1) % 3] == corners[f][k] and corners[g][m] == corners[f][(k + 1) % 3]:
            return own[f][k][0] == 0 or own[g][m][1] != own[f][k][0]
    return True


class _Scan(NamedTuple):
    """The scan lines of one image: rows from the bottom for axis 0, the motion along x; columns for axis 1."""

    pulls: list[list[list[float]]]  # [line][pixel][channel]
    colors: list[list[list[float]]]
    shown: list[list[int]]
    places: list[list[tuple[float, float]]]  # [face][corner] in pixels: u across the lines, v along them
    depths: list[list[float]]
    adjacent: list[list[int]]
    axis: int
    perspective: bool

    @classmethod
    def of(
        cls,
        grad: Tensor,
        image: Tensor,
        face_index: Tensor,
        corners: Tensor,
        adjacent: list[list[int]],
        axis: int,
        perspective: bool,
    ) -> _Scan:
        maps = [m.flip(0) for m in (grad.permute(1, 2, 0), image.permute(1, 2, 0), face_index)]
        pulls, colors, shown = (m.transpose(0, 1).tolist() if axis else m.tolist() for m in maps)
        size = torch.tensor([face_index.shape[1], face_index.shape[0]], dtype=torch.float64)
        pixels = (size * corners[..., :2] + size - 1) / 2
        places = [[(c[1 - axis], c[axis]) for c in face] for face in pixels.tolist()]
        return cls(pulls, colors, shown, places, corners[..., 2].tolist(), adjacent, axis, perspective)

    def crossings(self, f: int, u: int) -> dict[int, float]:
        """Find the edges of face f that line u crosses, two or none, and the positions on the line."""
        result = {}
        for k, (p, q) in enumerate(zip(self.places[f], self.places[f][1:] + self.places[f][:1], strict=True)):
            if (p[0] <= u) != (q[0] <= u):
                result[k] = p[1] + (q[1] - p[1]) * (u - p[0]) / (q[0] - p[0])
        return result

    def exit(self, g: int, u: int, v: float) -> float:
        """Find the position where line u leaves face g, which it entered at v."""
        return max([v, *self.crossings(g, u).values()], key=lambda end: abs(end - v))

    def area(self, f: int) -> float:
        """Compute the area of face f in pixels."""
        (au, av), (bu, bv), (cu, cv) = self.places[f]
        return abs((bu - au) * (cv - av) - (bv - av) * (cu - au)) / 2

    def middle(self, f: int) -> list[float] | None:
        """Read the colour of a pixel that shows face f, among the 3 x 3 around its centroid, or None."""
        u, v = (math.floor(sum(place[n] for place in self.places[f]) / 3 + 0.5) for n in (0, 1))
        for x, y in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            i, j = (u + x, v + y) if self.axis else (u + y, v + x)
            if 0 <= i < len(self.shown) and 0 <= j < len(self.shown[0]) and self.shown[i][j] == f:
                return self.colors[i][j]
        return None

    def nearness(self, f: int, k: int) -> float:
        """Compute the nearness of corner k of face f: larger in front, and linear over the face on the screen."""
        return 1 / self.depths[f][k] if self.perspective else -self.depths[f][k]

    def nearness_at(self, f: int, u: float, v: float) -> float:
        """Compute the nearness of the plane of face f, clamped to the range of its corners; see `plane_nearness`."""
        arms = [(p[0] - u, p[1] - v) for p in self.places[f]]
        parts = [arms[i][0] * arms[j][1] - arms[i][1] * arms[j][0] for i, j in ((1, 2), (2, 0), (0, 1))]
        corners = [self.nearness(f, k) for k in range(3)]
        value = sum(part * corner for part, corner in zip(parts, corners, strict=True)) / sum(parts)
        if self.perspective and min(self.depths[f]) <= 0:
            return value
        return min(max(value, min(corners)), max(corners))


def _move_edge(scan: _Scan, f: int, k: int, counter_clockwise: bool) -> tuple[float, float]:
    """Compute the gradient to the start and end of edge k of face f, along the scan lines that cross it."""
    (pu, pv), (qu, qv) = scan.places[f][k], scan.places[f][(k + 1) % 3]
    if abs(pu - qu) < SHORTEST or (scan.perspective and min(scan.depths[f][k], scan.depths[f][(k + 1) % 3]) <= 0):
        return 0.0, 0.0
    # The outside of a counter-clockwise face is to the right of its edges: at larger x of an edge that points up, at
    # smaller y of an edge that points right.
    d = 1 if (pu < qu) == (counter_clockwise == (scan.axis == 0)) else -1
    to_start = to_end = 0.0
    for u in range(max(0, math.ceil(min(pu, qu))), min(len(scan.shown), math.ceil(max(pu, qu)))):
        share = (u - pu) / (qu - pu)
        c = pv + share * (qv - pv)
        gain = _gain(scan, f, k, u, c, d, share)
        if not 0.5 <= c <= len(scan.shown[0]) - 1.5:
            gain *= 2  # pairs of centres sample only half of a border pixel
        to_start += (1 - share) * gain
        to_end += share * gain
    pixels = len(scan.shown[0]) / 2  # pixels per screen unit
    return d * pixels * to_start, d * pixels * to_end


def _gain(scan: _Scan, f: int, k: int, u: int, c: float, d: int, share: float) -> float:
    """Compute the change of the loss if edge k, which line u crosses at c, moves outward by a pixel there."""
    shown, colors, pulls = scan.shown[u], scan.colors[u], scan.pulls[u]
    inner = math.floor(c) if d > 0 else math.ceil(c)
    outer, before, behind = inner + d, inner - d, inner + 2 * d
    if not (0 <= inner < len(shown) and 0 <= outer < len(shown)) or shown[inner] == shown[outer]:
        return 0.0
    own, other, adjacent = shown[inner], shown[outer], scan.adjacent[f][k]
    offset = abs(c - inner)
    if adjacent >= 0:
        return _seam_gain(scan, f, adjacent, u, c, d)
    if own < 0:
        return 0.0

    # The chord in the face, and the joint chord with the next faces of the surface; at most a pixel.
    chord = joint = 1.0
    reach, stand_in, stand_in_end = 2.0, -1, 0.0
    chain: list[int] = []
    if not scan.perspective or min(scan.depths[f]) > 0:
        ((leaving, end),) = (item for item in scan.crossings(f, u).items() if item[0] != k)
        reach = abs(end - c)
        chord = joint = min(reach, 1.0)
        face = scan.adjacent[f][leaving]
        stand_in = face if joint < 1 else -1
        while len(chain) < LONGEST and face >= 0 and joint < 1:
            chain.append(face)
            ends = {k: v for k, v in scan.crossings(face, u).items() if v != end}
            if not ends:
                face = -1
                break
            leaving, end = max(ends.items(), key=lambda item: abs(item[1] - end))
            if len(chain) == 1:
                stand_in_end = abs(end - c)
            joint = min(abs(end - c), 1.0)
            face = scan.adjacent[face][leaving]
    if own != f and own not in chain:
        return 0.0
    meets, height = 1.0, (1 - share) * scan.nearness(f, k) + share * scan.nearness(f, (k + 1) % 3)
    if other >= 0:
        ahead = height - scan.nearness_at(other, u, c)
        meets = float(ahead > 0)
        ends_there = any(abs(v - c) < SAME_PLACE for v in scan.crossings(other, u).values())
        if abs(ahead) <= SAME_DEPTH * abs(height) and ends_there:
            meets = 0.5
    beyond = 0
    behind_chord = shown[before] if 0 <= before < len(shown) else -1
    if joint < 1 and face < 0 and behind_chord >= 0 and behind_chord not in chain:
        lead = height - _nearness_beyond_chord(scan, behind_chord, u, d, end)
        farther = other < 0 or lead < height - scan.nearness_at(other, u, c)
        beyond = 1 if lead <= 0 else -1 if farther else 0
    if beyond > 0:
        joint, stand_in = 1.0, -1
    # The probability, over sub-pixel shifts, that centres show the crossing.
    probability = max(joint, LEAST_CHORD)

    # A pixel extends half a pixel from its centre; the centre in a narrow face lies anywhere in it.
    part = offset if joint < 1 else float(offset >= 0.5)
    weights = _stand_in_weights(scan, u, (f, stand_in, stand_in_end), inner, d, offset, (chord, joint))
    more = 0.5 * max(2 - reach, 0) * reach / max(reach - 1, 0.1) if own == f and probability == 1 and reach < 2 else 0.0
    continues = 0 <= before < len(shown) and shown[before] == own
    stands_in = own == f and 0 <= before < len(shown) and shown[before] in chain
    continues_outside = 0 <= behind < len(shown) and shown[behind] == other
    total = 0.0
    for n, pull in enumerate(pulls[inner]):
        inside, outside = colors[inner][n] / probability, colors[outer][n] / (1 if beyond else probability)
        if weights is not None:
            inside = sum(weight * color[n] for weight, color in weights)
        elif continues:
            inside += (offset + more) * (colors[inner][n] - colors[before][n]) / probability
        elif stands_in:
            # The stand-in's colour, plus the face's difference from it, weighted by the rarer hits of the face.
            inside = colors[before][n] / probability + (colors[inner][n] - colors[before][n]) / max(chord, LEAST_CHORD)
        if continues_outside:
            outside += (1 - offset) * (colors[outer][n] - colors[behind][n]) / (1 if beyond else probability)
        if beyond < 0:
            outside += (1 / probability - 1) * colors[before][n]
        total += (inside - outside) * ((1 - part) * pull + part * pulls[outer][n])
    return meets * total


def _nearness_beyond_chord(scan: _Scan, face: int, u: int, d: int, end: float) -> float:
    """Compute the nearness of the surface of a visible face, followed outward, at the end of a chord."""
    place, last = -d * math.inf, face
    for _ in range(LONGEST):
        ends = {k: v for k, v in scan.crossings(last, u).items() if v != place}
        if last < 0 or not ends:
            break
        leaving, place = max(ends.items(), key=lambda item: d * item[1])
        if d * (place - end) >= 0:
            return scan.nearness_at(last, u, end)
        last = scan.adjacent[last][leaving]
    return scan.nearness_at(face, u, end)


def _stand_in_weights(
    scan: _Scan,
    u: int,
    faces: tuple[int, int, float],
    inner: int,
    d: int,
    offset: float,
    chords: tuple[float, float],
) -> list[tuple[float, list[float]]] | None:
    """Find weights and colours whose sum is the inner colour behind a chord below a pixel; see `blend_stand_in`.

    ``faces``: the face of the outline, its stand-in, and the distance at which the line leaves that. ``chords``: of the
    face, and of it and all stand-ins.
    """
    face, stand_in, end = faces
    chord, joint = chords
    if stand_in < 0:
        return None
    shown, colors = scan.shown[u], scan.colors[u]
    hits = shown[inner] == face
    own = (4 - 6 * min(offset / max(chord, SHORTEST), 1.0)) / max(chord, LEAST_CHORD) if hits else 0.0
    if joint == 1 and end >= 2 + chord:
        first = inner - d * hits
        if any(not 0 <= v < len(shown) or shown[v] != stand_in for v in (first, first - d)):
            return None
        far = offset + hits  # from the first centre in the stand-in to the outline
        return [
            (own, colors[inner]),
            (1 + far - own * 2 if hits else 1 + far, colors[first]),
            (own - far if hits else -far, colors[first - d]),
        ]
    middle = scan.middle(stand_in)
    return None if middle is None else [(own, colors[inner]), (1 / max(joint, LEAST_CHORD) - own, middle)]


def _seam_gain(scan: _Scan, f: int, g: int, u: int, c: float, d: int) -> float:
    """Compute the gain at a seam between faces f and g of a surface; the face of lower index takes it."""
    if g < f:
        return 0.0
    shown, colors, pulls = scan.shown[u], scan.colors[u], scan.pulls[u]
    inner = math.floor(c) if d > 0 else math.ceil(c)
    offset = abs(c - inner)
    chords = [min(abs(scan.exit(face, u, c) - c), 1.0) for face in (f, g)]
    if min(scan.area(f), scan.area(g)) < SMALL:
        return _small_seam_gain(scan, (f, g), u, inner, d, offset, chords)
    sides = []
    for face, chord, pixel, way, gap in zip(
        (f, g), chords, (inner, inner + d), (-d, d), (offset, 1 - offset), strict=True
    ):
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
    pull = pulls[inner + d] if offset >= 0.5 else pulls[inner]
    return sum((a - b) * g for a, b, g in zip(*sides, pull, strict=True))


def _small_seam_gain(
    scan: _Scan, faces: tuple[int, int], u: int, inner: int, d: int, offset: float, chords: list[float]
) -> float:
    """Compute the gain at a seam of a small face: the sum over shown sides, weighted by the inverse of the chord."""
    pixels = (inner, inner + d)
    shows = [scan.shown[u][pixel] == face for pixel, face in zip(pixels, faces, strict=True)]
    # A side whose weight is limited counts less than it should; then the other side has to count as much less.
    kept = [min(chord / LEAST_CHORD, 1.0) for chord in reversed(chords)]
    weights = [seen * part / max(chord, LEAST_CHORD) for seen, chord, part in zip(shows, chords, kept, strict=True)]
    if not any(shows):
        return 0.0
    places = [(u, inner + d * n) for n in (-1, -2, 2, 3)] + [(u + n, pixel) for n in (-1, 1) for pixel in pixels]
    inside = [(i, j) for i, j in places if 0 <= i < len(scan.shown) and 0 <= j < len(scan.shown[0])]
    others = [(i, j) for i, j in inside if scan.shown[i][j] >= 0 and scan.shown[i][j] not in faces]
    total = 0.0
    for n in range(len(scan.pulls[u][inner])):
        own, other = (scan.colors[u][pixel][n] for pixel in pixels)
        often = own if shows[0] and (not shows[1] or weights[0] <= weights[1]) else other
        nearby = _at(offset, [((j - inner) * d, scan.colors[i][j][n]) for i, j in others]) if others else often
        pull = (1 - offset) * scan.pulls[u][pixels[0]][n] + offset * scan.pulls[u][pixels[1]][n]
        total += (weights[0] * (own - nearby) - weights[1] * (other - nearby)) * pull
    return total


def _at(place: float, points: list[tuple[int, float]]) -> float:
    """Return the value at a place of the straight line through points (place, value), by least squares."""
    center, mean = (sum(values) / len(points) for values in zip(*points, strict=True))
    spread = sum((x - center) ** 2 for x, _ in points)
    slope = sum((x - center) * y for x, y in points) / spread if spread > 0 else 0.0
    return mean + slope * (place - center)
