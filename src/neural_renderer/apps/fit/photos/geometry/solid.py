"""Solid of the object in posed photographs, from depth only.

Depth says what is there: points that views agree on. Without the plane that they stand on they fall into pieces, of
which the object is the one that the cameras look at. Around it, each view votes in a grid: a cell in front of what the
view sees is empty, one just behind is filled. The solid has the least surface for these votes, so that it closes where
no view tells (Zach et al., "A globally optimal algorithm for robust TV-L1 range image integration", 2007).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor

from ....common.geometry.isosurface import isosurface
from ....common.views.views import Views, photos_of, view_center
from ..place import FLAT, SHARE, find_ground
from .cut import cut_out
from .depth import DepthMaps, pixels_of, places_of, supported

_VIEW_POINTS = 6000  # most points of a view that pieces are made of
_SEARCH = 1.5  # radius of what may belong to the object, relative to the radius in which its plane is searched
_BINS = 32  # cells along that radius, in which points are connected
_LEAST_IN_BIN = 3
_NEAR = 0.35  # distance from the focus, relative to the radius of the search, at which points count a third
_FLOATS, _LOWEST, _GAP = 0.1, 0.02, 0.12  # height of a floating piece over the plane, its lowest quantile, its gap
_MOST_PIECES = 12
_LEAST_PIECE = 300  # points of an object
_SAMPLE = 3000  # most points from which the plane and the object are estimated
_MOST_OUTSIDE = 0.03  # the object goes on where more than this share of its points lies at the end of the search
_MARGIN = 1.12  # cube around an object relative to its points
_SMOOTH = 0.7  # cells by which the solid is smoothed
_CELLS = 72  # voxels along each axis
_BAND, _BEHIND = 1.5, 4.0  # cells around a depth that views leave open, and behind it that they fill
_SURE = 1.0  # votes for a confidence of one half
_TENSION = 0.35  # of the surface, relative to the votes
_LEAST_SHARE = 0.04  # of the points of a piece that are on connected cells
_STEPS = 100  # of descent
_IN_BOX = 0.9  # a piece with at least this share of its points in the box touches nothing else
Box = tuple[float, float, float, float]
"""Left, upper, right and lower end of a part of a picture, as shares of its width and height."""
Target = tuple[int, Box]
"""Number of a photograph, and the part of it that shows the object: a point if both ends are the same."""


@dataclass(frozen=True)
class Solid:
    """The object as a closed surface in the world of the cameras."""

    vertices: Tensor  # [V, 3]
    faces: Tensor  # [F, 3]
    ground: np.ndarray | None  # [4], the plane (n, d) that it stands on, n upwards; None without one
    rivals: float  # weight of the second piece relative to the first, from 0 to 1
    maps: DepthMaps  # depth; with a box, points that are not the object are marked as ``others``


def find_solid(
    views: Views, maps: DepthMaps, target: Target | None = None, sparse: Tensor | None = None
) -> Solid | str:
    """Find the object in N views with photos and depth: the piece at a target, or the one that cameras look at.

    Sparse points [P, 3] of the scene help to find the plane under it. A box as target holds all of the object: what
    touches it is cut off by its colours. Returns the reason where no object stands out.
    """
    focus, reach = view_center(views)
    seeds = None if target is None else points_at(views, maps, *target)
    cloud = cloud_of(views, maps)
    if int(((cloud - focus).norm(dim=1) < reach).sum()) < _LEAST_PIECE:
        return "photographs show too few points of what they look at"
    dense, eyes, known = (part.double().numpy() for part in (cloud, views.eyes()[0], focus))
    ground = find_ground(dense, eyes, known, reach, None if sparse is None else sparse.double().numpy())
    if ground is not None and not (is_above := eyes @ ground[:3] > ground[3]).all():
        # Views from under the table show the object in hands, which are no part of it: their depth does not count.
        maps = replace(maps, support=maps.support * torch.from_numpy(is_above)[:, None, None])
        cloud = cloud_of(views, maps)
    if target is not None and target[1][:2] != target[1][2:]:
        maps = _cut_out(views, maps, target, ground)
        cloud = cloud_of(views, maps)
    distance = (cloud - focus).norm(dim=1)
    points = cloud[distance < _SEARCH * reach].double().numpy()
    piece, rivals = _piece(views, points, ground, focus.double().numpy(), reach, seeds)
    if len(piece) < _LEAST_PIECE:
        return "nothing stands out from the plane that photographs show"
    ends = np.linalg.norm(piece - focus.double().numpy(), axis=1) > reach * (_SEARCH - 2 / _BINS)
    if ends.mean() > _MOST_OUTSIDE:
        return "what photographs show has no end that they show, too"
    feet = piece if ground is None else piece - np.outer(piece @ ground[:3] - ground[3], ground[:3])
    low, high = np.concatenate((piece, feet)).min(0), np.concatenate((piece, feet)).max(0)
    center, half = (low + high) / 2, _MARGIN * float((high - low).max()) / 2
    line = np.linspace(-half, half, _CELLS)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1) + center
    filled = _least_surface(_votes(views, maps, grid.reshape(-1, 3), half), ground, grid)
    inside = _connected(filled, piece, center, half)
    if not inside.any():
        return "photographs do not agree on a closed object"
    if ground is not None:
        inside = _to_ground(inside, grid, ground, 2 * FLAT * reach)
    values = ndimage.gaussian_filter(np.pad(inside, 1).astype(np.float64), _SMOOTH)
    size = half * (_CELLS + 1) / (_CELLS - 1)
    vertices, faces = isosurface(lambda _: 0.5 - values, _CELLS + 1, size)
    return Solid(vertices + torch.from_numpy(center).float(), faces, ground, rivals, maps)


def points_at(views: Views, maps: DepthMaps, row: int, box: Box) -> Tensor | None:
    """Find the points [S, 3] that a view shows in a box of its picture: at the nearest known pixel if it has none.

    Returns None if the view has no depth.
    """
    height, width = maps.depth.shape[1:]
    known = supported(maps)[row].nonzero()
    if not len(known):
        return None
    low, high = (known.new_tensor([box[k + 1] * height, box[k] * width]) for k in (0, 2))
    chosen = known[((known >= low) & (known < high)).all(1)]
    if not len(chosen):
        chosen = known[(known - (low + high) / 2).norm(dim=1).argmin()][None]
    y, x = chosen[:: max(1, len(chosen) // _SAMPLE)].unbind(1)
    pixels = torch.stack((x, y), 1) + 0.5
    return views.camera[row : row + 1].unproject(pixels, maps.depth[row, y, x], (height, width))[0]


def _cut_out(views: Views, maps: DepthMaps, target: Target, ground: np.ndarray | None) -> DepthMaps:
    """Mark the depth over the plane that is not the object's, which a box in one photograph shows."""
    focus, reach = view_center(views)
    row, (left, upper, right, lower) = target
    known, places, colors = supported(maps), [], []
    for number, photo in enumerate(photos_of(views)):
        places.append(places_of(views, maps, number)[known[number]])
        colors.append(photo.movedim(0, 2)[known[number]])
    points = torch.cat(places)
    pixels, depth = (part[0] for part in views.camera[row : row + 1].project(points, (1, 1)))
    low, high = pixels.new_tensor([left, upper]), pixels.new_tensor([right, lower])
    inside = (depth > 0) & (pixels >= low).all(1) & (pixels < high).all(1)
    chosen = (points - focus).norm(dim=1) < _SEARCH * reach
    if ground is not None:
        chosen &= points @ points.new_tensor(ground[:3]) - ground[3] > 2 * FLAT * reach
    of_object = ~chosen if ground is not None else torch.zeros_like(chosen)
    near, shades, shown = (part[chosen].numpy() for part in (points.double(), torch.cat(colors).double(), inside))
    piece = label_pieces(near, focus.double().numpy(), _SEARCH * reach, reach / _BINS)
    is_apart = np.bincount(piece, shown) > _IN_BOX * np.bincount(piece)
    is_apart[0] = False
    of_object[chosen] = torch.from_numpy(cut_out(near, shades, shown, reach / (2 * _BINS)) | is_apart[piece])
    others = torch.zeros_like(known)
    others[known] = ~of_object
    return replace(maps, others=others)


def cloud_of(views: Views, maps: DepthMaps) -> Tensor:
    """Make the points [P, 3] of the object and around it that enough views found, at most some thousands of each view.

    Those that are marked as others are left out.
    """
    parts = []
    for row in range(len(views)):
        good = supported(maps)[row] & ~maps.others[row] if maps.others is not None else supported(maps)[row]
        place = places_of(views, maps, row)[good]
        parts.append(place[:: max(1, len(place) // _VIEW_POINTS)])
    return torch.cat(parts)


def _piece(
    views: Views, points: np.ndarray, ground: np.ndarray | None, focus: np.ndarray, reach: float, seeds: Tensor | None
) -> tuple[np.ndarray, float]:
    """Choose the piece [P, 3] of points above the plane that cameras look at; return the weight of a second one."""
    pixels, depth = views.camera.project(torch.from_numpy(points).float(), views.size)
    limits = pixels.new_tensor([views.size[1], views.size[0]])
    shown = ((depth > 0) & (pixels > 0).all(-1) & (pixels < limits).all(-1)).float().mean(0).numpy() >= SHARE
    if ground is not None:
        shown &= points @ ground[:3] - ground[3] > 2 * FLAT * reach
    points = points[shown]
    labels = label_pieces(points, focus, _SEARCH * reach, reach / _BINS)
    if not labels.any():
        return points[:0], 0.0
    weight = np.exp(-((np.linalg.norm(points - focus, axis=1) / (_NEAR * reach)) ** 2))
    total = np.bincount(labels, weight)
    total[0] = 0
    best = int(total.argmax())
    if seeds is not None:
        nearest = cKDTree(points[labels > 0]).query(seeds.double().numpy())[1]
        best = int(np.bincount(labels[labels > 0][nearest]).argmax())
    chosen = with_hanging(points, labels, [best], ground, reach)
    others = np.delete(total, chosen)
    return points[np.isin(labels, chosen)], float(others.max(initial=0.0) / max(total[chosen].sum(), 1e-12))


def label_pieces(points: np.ndarray, center: np.ndarray, radius: float, cell: float) -> np.ndarray:
    """Number the pieces of points [P, 3] around a centre that are connected in a grid: [P], 0 for isolated points."""
    if not len(points):
        return np.zeros(0, np.int64)
    count = int(np.ceil(2 * radius / cell))
    cells = np.clip((points - center + radius) / cell, 0, count - 1).astype(np.int64)
    index = np.ravel_multi_index(tuple(cells.T), (count,) * 3)
    full = np.bincount(index, minlength=count**3).reshape((count,) * 3) >= _LEAST_IN_BIN
    return np.asarray(ndimage.label(full, np.ones((3, 3, 3)))[0].ravel()[index])


def with_hanging(
    points: np.ndarray, labels: np.ndarray, pieces: list[int], ground: np.ndarray | None, reach: float
) -> list[int]:
    """Add the pieces that lie over these, or under them: nothing floats above the plane, so one hangs on the other."""
    if ground is None:
        return pieces
    height, found = points @ ground[:3] - ground[3], list(pieces)
    flat = points @ np.linalg.svd(ground[None, :3])[2][1:].T  # along the plane
    for piece in np.argsort(-np.bincount(labels))[:_MOST_PIECES]:
        if piece in (0, *found):
            continue
        ours = np.isin(labels, found)
        if max(np.quantile(height[part], _LOWEST) for part in (labels == piece, ours)) < _FLOATS * reach:
            continue
        low, high = np.quantile(flat[ours], [_LOWEST, 1 - _LOWEST], axis=0)
        middle = flat[labels == piece].mean(0)
        tree = cKDTree(points[ours])
        is_within = ((low < middle) & (middle < high)).all()
        if is_within and float(tree.query(points[labels == piece])[0].min()) < _GAP * reach:
            found.append(int(piece))
    return found


def _votes(views: Views, maps: DepthMaps, points: np.ndarray, half: float) -> np.ndarray:
    """Add up the votes of all views for points [V, 3] of the grid: [V] in [-1, 1], 1 where filled."""
    cell, size = 2 * half / (_CELLS - 1), (maps.depth.shape[1], maps.depth.shape[2])
    total, count = np.zeros(len(points), np.float32), np.full(len(points), _SURE, np.float32)
    known, place = supported(maps), torch.from_numpy(points).float()
    for row in range(len(views)):
        pixel, inside, depth = (part[0] for part in pixels_of(views.camera[row : row + 1], place, size))
        seen = torch.where(known[row], maps.depth[row], torch.nan).view(-1)[pixel]
        # Both the grid and the depth limit the sharpness of a view.
        width = torch.clamp(maps.error[row] * seen, min=_BAND * cell)
        behind = (depth - seen) / width
        votes = behind.clamp(-1, 1) * (behind < _BEHIND)
        if maps.others is not None:  # something else fills what is behind
            votes = torch.where(maps.others[row].view(-1)[pixel], -votes.abs(), votes)
        vote = torch.where(inside & torch.isfinite(seen), votes, 0.0).numpy()
        total += vote
        count += np.abs(vote)
    return total / count


def _least_surface(votes: np.ndarray, ground: np.ndarray | None, grid: np.ndarray) -> np.ndarray:
    """Find the filled cells [D, D, D] of least surface for votes: a primal-dual method (Chambolle and Pock, 2011)."""
    data = torch.from_numpy(votes.reshape((_CELLS,) * 3))
    if ground is not None:
        data = torch.where(torch.from_numpy(grid @ ground[:3] < ground[3]), -1.0, data)
    filled = (data > 0).float()
    ahead, dual = filled.clone(), torch.zeros(3, *data.shape)
    step = (4 * 3) ** -0.5  # the gradient in three dimensions has at most the norm √12
    for _ in range(_STEPS):
        for axis in range(3):
            n = data.shape[axis]
            dual[axis].narrow(axis, 0, n - 1).add_(ahead.diff(dim=axis), alpha=step)
        dual.div_((dual.norm(dim=0) / _TENSION).clamp(min=1))
        change = data.clone()
        for axis in range(3):
            n = data.shape[axis]
            change.narrow(axis, 0, n - 1).add_(dual[axis].narrow(axis, 0, n - 1))
            change.narrow(axis, 1, n - 1).sub_(dual[axis].narrow(axis, 0, n - 1))
        before = filled
        filled = (filled + step * change).clamp(0, 1)
        ahead = 2 * filled - before
    return (filled > 0.5).numpy()


def _connected(filled: np.ndarray, piece: np.ndarray, center: np.ndarray, half: float) -> np.ndarray:
    """Keep the connected cells that have some of the piece's points on them, without cavities."""
    label, count = ndimage.label(filled)
    if not count:
        return filled
    cells = np.clip(np.round(((piece - center) / half + 1) / 2 * (_CELLS - 1)), 0, _CELLS - 1).astype(int)
    near = ndimage.grey_dilation(label, (3, 3, 3))[tuple(cells.T)]
    share = np.bincount(near[near > 0], minlength=count + 1) / max(int((near > 0).sum()), 1)
    return np.asarray(ndimage.binary_fill_holes(np.isin(label, np.flatnonzero(share > _LEAST_SHARE))))


def _to_ground(inside: np.ndarray, grid: np.ndarray, ground: np.ndarray, height: float) -> np.ndarray:
    """Continue the lowest cells, up to a height, straight down to the plane: its points are cut with the plane's."""
    above = grid @ ground[:3] - ground[3]
    low = inside & (above < 2 * height) & (above > height)
    spacing = float(np.abs(grid[1, 0, 0] - grid[0, 0, 0]).max())
    result = inside & (above > 0)
    for depth in np.arange(spacing / 2, 2 * height, spacing / 2):
        moved = np.round(-ground[:3] * depth / spacing).astype(int)
        result |= _shifted(low, moved) & (above > 0)
    return result


def _shifted(cells: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Move marked cells, by whole cells along each axis."""
    return np.asarray(ndimage.shift(cells.astype(np.uint8), by, order=0) > 0)
