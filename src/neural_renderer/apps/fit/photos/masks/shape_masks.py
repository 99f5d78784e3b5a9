"""Masks that depth shows: drawings of the solid that photographs agree on, sharpened by their colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor

from .....camera import Camera
from ....common.adjustable import generator
from ....common.views.views import Views, downscale, photos_of, view_center
from ..copies import Progress
from ..geometry.comparison import moved
from ..geometry.depth import DepthMaps, find_depth, places_of, supported
from ..geometry.solid import Solid, Target, cloud_of, find_solid
from .sharpen import sharpen

_SIDE = 240  # longer side of the pictures whose depth is found, in pixels
_LEAST_SEEN = 0.25  # least share of a solid's drawings with known depth; below it only colours decide
_LEAST_SCENE = 0.4  # the same for all pictures: above it, depth also says that nothing closed is there
_POINTS = 3000  # points by which an object is located
_SOLID_CELL = 0.03  # distance from a solid, relative to its longest side, of points that show it
_INSIDE = 0.99  # share of a pixel that a mask covers, to be all object; one minus it: all background
_FATTENED = 3  # pixels by which depth at an edge may be that of the other side
_FILE = "depth.npz"
SOLID = "solid.ply"
"""File of the object by depth, with which a fit starts."""


@dataclass(frozen=True)
class ShapeMasks:
    """Evidence of depth for the object in N photographs."""

    masks: np.ndarray | None  # [N, H, W] bool; None if depth shows no closed object
    maps: DepthMaps | None  # depth of the photographs, if there is any
    ground: np.ndarray | None  # [4], the plane that the object stands on, if there is one
    reason: str | None  # why it does not
    is_certain: bool  # enough of the pictures has depth for that
    rivals: float  # weight of a second object relative to the first
    cloud: Tensor  # [P, 3], points that photographs agree on
    solid: Solid | None = None  # the object
    moved: np.ndarray | None = None  # [N] bool, photographs that show it elsewhere, or hidden; None if there are none


def masks_of_shape(
    images: np.ndarray,
    camera: Camera,
    points: Tensor | None,
    progress: Progress,
    target: Target | None = None,
) -> ShapeMasks:
    """Find the masks of N photographs [N, H, W, 3] by their depth.

    The target shows the object.
    """
    photos = torch.from_numpy(images).permute(0, 3, 1, 2).float()
    small = torch.stack([downscale(photo, _SIDE) for photo in photos])
    views = Views(camera, torch.ones(len(small), *small.shape[2:]), small)
    maps = _depth(views, points, progress)
    if maps is None:
        return ShapeMasks(None, None, None, "photographs show too few points", False, 0.0, torch.zeros(0, 3))
    cloud = _some(cloud_of(views, maps))
    solid, elsewhere = _find_at_rest(views, maps, target, points, progress)
    if isinstance(solid, str):
        return ShapeMasks(None, maps, None, solid, float(supported(maps).float().mean()) > _LEAST_SCENE, 0.0, cloud)
    drawn = draw(solid, camera, (images.shape[1], images.shape[2]))
    here = draw(solid, camera, (small.shape[2], small.shape[3])) > 0.5
    seen = float(supported(maps)[torch.from_numpy(here)].float().mean()) if here.any() else 0.0
    masks = np.stack([sharpen(image, one > 0.5) for image, one in zip(images, drawn, strict=True)])
    return ShapeMasks(masks, solid.maps, solid.ground, None, seen > _LEAST_SEEN, solid.rivals, cloud, solid, elsewhere)


def _find_at_rest(
    views: Views, maps: DepthMaps, target: Target | None, points: Tensor | None, progress: Progress
) -> tuple[Solid | str, np.ndarray | None]:
    """Find the solid where most photographs show it, and the photographs [N] bool that contradict it.

    Depth is found again without these. Where the target is in one of them, all count.
    """
    solid = find_solid(views, maps, target, points)
    if isinstance(solid, str):
        return solid, None
    elsewhere = moved(views.camera, solid.maps, solid.vertices, solid.faces, solid.ground)
    if not elsewhere.any() or (target is not None and elsewhere[target[0]]):
        return solid, None
    rest = torch.from_numpy(~elsewhere)
    maps = replace(maps, support=maps.support * rest[:, None, None])
    again = _depth(views[np.flatnonzero(~elsewhere).tolist()], points, progress)
    if again is not None:  # windows of the others' pictures misled it
        parts = ("depth", "support", "error")
        maps = replace(maps, **{part: getattr(maps, part).index_put((rest,), getattr(again, part)) for part in parts})
    return find_solid(views, maps, target, points), elsewhere


def shown_by_depth(shape: ShapeMasks, camera: Camera) -> np.ndarray:
    """Find what depth shows in the pixels of N photographs: [N, h, w], 1 the solid, -1 something else, 0 unknown."""
    if shape.maps is None or shape.solid is None:
        return np.zeros((len(camera), 1, 1), np.int8)
    size, known = shape.maps.depth.shape[1:], supported(shape.maps).numpy()
    views = Views(camera, torch.ones(len(camera), *size))
    vertices, ground = shape.solid.vertices, shape.solid.ground
    tree = cKDTree(vertices.double().numpy())
    cell = _SOLID_CELL * float((vertices.amax(0) - vertices.amin(0)).max())
    shown = np.zeros(known.shape, np.int8)
    for row in range(len(views)):
        places = places_of(views, shape.maps, row).double().numpy()[known[row]]
        away = tree.query(places, distance_upper_bound=2 * cell)[0]
        ours = away < cell
        if ground is not None:  # depth does not separate it from the ground where they meet
            ours &= places @ ground[:3] - ground[3] > 2 * cell
        shown[row][known[row]] = ours.astype(np.int8) - np.isinf(away)
    if shape.maps.others is not None:
        shown[known & shape.maps.others.numpy()] = -1
    return shown


def contradiction(masks: np.ndarray, shown: np.ndarray) -> float:
    """Measure the area of masks [N, H, W] that depth contradicts, relative to the object; 0 where depth is unknown.

    Pixels count whose depth is known, see `shown_by_depth`: those of the solid that are not inside of the mask, or the
    reverse.
    """
    size = shown.shape[1], shown.shape[2]
    share = F.interpolate(torch.from_numpy(masks)[:, None].float(), size, mode="area")[:, 0].numpy()
    wrong = ((shown > 0) & (share < 1 - _INSIDE)) | ((shown < 0) & (share > _INSIDE))
    return int(wrong.sum()) / max(int((shown > 0).sum()), 1)


def evidence_of_depth(shown: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Make the evidence [N, H, W] of depth for the object, in [-1, 1].

    It is 0 near edges, where the windows that depth is found by show both sides.
    """
    found = []
    for one in shown:
        ours, others = (
            ndimage.binary_erosion(ndimage.binary_closing(part), iterations=_FATTENED) for part in (one > 0, one < 0)
        )
        found.append(ours.astype(np.float32) - others)
    return F.interpolate(torch.from_numpy(np.stack(found))[:, None], size, mode="nearest")[:, 0].numpy()


def points_by_depth(views: Views, progress: Progress) -> Tensor:
    """Find points [P, 3] that N views with photos agree on, where structure from motion has found none."""
    small = torch.stack([downscale(photo, _SIDE) for photo in photos_of(views)])
    small_views = Views(views.camera, torch.ones(len(small), *small.shape[2:]), small)
    maps = _depth(small_views, None, progress)
    return torch.zeros(0, 3) if maps is None else _some(cloud_of(small_views, maps))


def _depth(views: Views, points: Tensor | None, progress: Progress) -> DepthMaps | None:
    """Find the depth of views; without points, in a range around the place where cameras look."""
    return find_depth(views, _around_focus(views) if points is None else points, progress)


def _some(cloud: Tensor) -> Tensor:
    """Choose some of many points."""
    return cloud[:: max(1, len(cloud) // _POINTS)]


def _around_focus(views: Views) -> Tensor:
    """Make points [P, 3] around the place where cameras look, for a range of depth where there are no others."""
    focus, reach = view_center(views)
    return focus + reach * F.normalize(torch.randn(_POINTS, 3, generator=generator(0, 0)), dim=1)


def draw(solid: Solid, camera: Camera, size: tuple[int, int]) -> np.ndarray:
    """Draw the coverage [N, H, W] of the pixels by a solid."""
    center, half = solid.vertices.mean(0), float((solid.vertices - solid.vertices.mean(0)).abs().max())
    views = Views(camera, torch.ones(len(camera), *size)).normalized(center, half)
    shape = (solid.vertices - center) / half, solid.faces
    with torch.no_grad():
        return torch.cat([views[[row]].draw(shape).alpha for row in range(len(views))]).numpy()


def write_depth(folder: Path, shape: ShapeMasks, names: Sequence[str]) -> None:
    """Write depth of photographs, the plane, and the weight of a second object, for the verdict on a fit."""
    if shape.maps is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    depth, support, error = (part.numpy() for part in (shape.maps.depth, shape.maps.support, shape.maps.error))
    np.savez_compressed(
        folder / _FILE,
        names=np.array(names),
        depth=depth,
        support=support.astype(np.uint8),
        error=error,
        ground=np.zeros(0) if shape.ground is None else shape.ground,
        rivals=shape.rivals,
        others=np.zeros(0, bool) if shape.maps.others is None else shape.maps.others.numpy(),
    )


def read_depth(folder: Path, names: Sequence[str]) -> tuple[DepthMaps, np.ndarray | None, float] | None:
    """Read depth of photographs, the plane, and the weight of a second object; None if they are not all there."""
    if not (folder / _FILE).is_file():
        return None
    with np.load(folder / _FILE) as read:
        rows = {str(name): row for row, name in enumerate(read["names"])}
        if not all(name in rows for name in names):
            return None
        chosen = [rows[name] for name in names]
        depth, support, error = (torch.from_numpy(read[name][chosen]) for name in ("depth", "support", "error"))
        ground, rivals, others = read["ground"], float(read["rivals"]), read["others"]
    cut = torch.from_numpy(others[chosen]) if len(others) else None
    return DepthMaps(depth, support.long(), error, cut), ground if len(ground) else None, rivals
