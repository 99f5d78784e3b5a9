"""Agreement of masks and cameras: the visual hull of all masks fills each mask; else a probable cause is found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ...camera.camera import with_extrinsics, world_origin
from ..common.views.views import Views, downscale, mask_values, view_center

REFINED_MARGIN = 4
"""Argument ``margin`` of `check_agreement` for cameras to refine, which may be a little wrong."""

_SIZE = 96  # longer side of the masks that are compared, in pixels
_RAYS = 48  # pixels of each mask, and as many points along the ray of each
_PARTNERS = 12  # most views that are compared with all others
_COMMON = 0.7  # share of the views in whose masks a point must lie to belong to the region of the object
_WIDER = 1.2  # size of the search cube, relative to the extent of the points found
_LEAST = 0.85  # coverage of each mask by the hull where masks and cameras agree; wrong ones reached 0.83 on average
_BETTER = 0.02  # coverage gain required to prefer a rarer remedy over a commoner one
_NAMED = 5  # most views named in a message
_SCALES = (0.125, 0.25, 0.5, 2.0, 4.0, 8.0)  # usual errors of the intrinsics


def check_agreement(views: Views, names: Sequence[str] | None = None, margin: int = 1) -> None:
    """Check that masks and cameras fit together: the visual hull of all masks fills each mask.

    Args:
        views: N views, in the world of the cameras. Two views always agree.
        names: Names of the N images, for the message; None numbers them.
        margin: Pixels by which the hull's masks of 96 pixels grow first, which tolerates small errors of cameras.

    Raises:
        ValueError: Some views do not agree. The message also says what would mend them, if that is a usual mistake.

    Example:
        >>> from neural_renderer.apps.fit import Views, check_agreement
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> check_agreement(Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32))
    """
    if len(views) < 3:  # with two silhouettes, either may be wrong
        return
    small = _small(views, 1)
    partners = sorted({round(i * (len(views) - 1) / (_PARTNERS - 1)) for i in range(_PARTNERS)})
    inside = _follow_rays(_small(views[partners], margin), small)
    covered = torch.zeros(len(views)) if inside is None else _covered(inside)
    if float(covered.min()) >= _LEAST:
        return
    advice = _remedy(small[partners], None)  # all views first: some of them may agree by chance
    kept = [] if inside is None or advice else _consistent(inside, partners)
    if kept and inside is not None:
        covered = _covered(inside[kept])
        dropped = {partner for row, partner in enumerate(partners) if row not in kept}
        wrong = [row for row in range(len(views)) if row in dropped or float(covered[row]) < _LEAST]
        if 2 * len(wrong) < len(views):
            names = names or [f"view {row}" for row in range(len(views))]
            shown = ", ".join(names[row] for row in wrong[:_NAMED]) + (", …" if len(wrong) > _NAMED else "")
            which = f"{len(wrong)} of {len(views)} views ({shown})"
            advice = _remedy(small[wrong], small[[partners[row] for row in kept]])
            raise _disagreement(which, covered[wrong], advice)
    raise _disagreement(f"{len(views)} views", covered, advice)


def hull_coverage(views: Views, margin: int = 1) -> Tensor:
    """Compute the share of each mask that the hull of all masks fills: [N] in [0, 1].

    Args:
        views: N views, in the world of the cameras.
        margin: As in `check_agreement`.

    Returns:
        The shares; 0 if the masks do not meet.

    Example:
        >>> from neural_renderer.apps.fit.agreement import hull_coverage
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> hull_coverage(views).min() > 0.9
        tensor(True)
    """
    inside = _follow_rays(_small(views, margin), _small(views, 1))
    return torch.zeros(len(views)) if inside is None else _covered(inside)


def _disagreement(which: str, covered: Tensor, advice: str | None) -> ValueError:
    """Return the error for views that disagree."""
    end = f"{advice} mends them" if advice else "their cameras or masks may be wrong, or the object moved"
    return ValueError(
        f"views: expected masks and cameras that agree, got {which} that do not: the hull of all masks fills "
        f"{float(covered.mean()):.0%} of theirs; {end}"
    )


def _remedy(wrong: Views, right: Views | None) -> str | None:
    """Find the remedy that makes views agree with the views ``right``, by default with each other; None without one."""
    best, advice = 0.0, None
    for text, changed in _remedies(wrong):
        inside = _follow_rays(changed if right is None else right, changed)
        covered = torch.zeros(1) if inside is None else _covered(inside)
        if float(covered.min()) >= _LEAST and float(covered.mean()) > best + _BETTER:
            best, advice = float(covered.mean()), text
    return advice


def _small(views: Views, margin: int) -> Views:
    """Scale masks down, and grow them by this many pixels."""
    masks = downscale(views.masks, _SIZE)
    return Views(views.camera, F.max_pool2d(masks[:, None], 2 * margin + 1, 1, margin)[:, 0], None, views.region)


def _covered(inside: Tensor) -> Tensor:
    """Compute for each of V views the share of its rays [N, V, R, S] that meet the hull of N masks, [V]."""
    return inside.all(0).any(-1).float().mean(-1).cpu()


def _consistent(inside: Tensor, partners: list[int]) -> list[int]:
    """Choose most of the N partners so that the hull of their masks fills each mask; an empty list if no choice does.

    The partner whose removal brings the rays of the others closest to a common point goes first.
    """
    covered, outside = inside[:, partners], ~inside[:, partners]
    kept = list(range(len(partners)))
    while 2 * len(kept) > len(partners) and len(kept) > 2:
        if float(_covered(covered[kept])[kept].min()) >= _LEAST:
            return kept
        count = outside[kept].sum(0)

        def misses(gone: int, kept: list[int] = kept, count: Tensor = count) -> float:
            rest = [row for row in kept if row != gone]
            return float((count[rest] - outside[gone][rest].long()).amin(-1).float().mean())

        kept = [row for row in kept if row != min(kept, key=misses)]
    return []


def _follow_rays(views: Views, sources: Views) -> Tensor | None:
    """Sample points on rays through the masks of V sources, and test them against the masks of N views.

    Returns [N, V, R, S] bool, for points near the object; None if no point lies in most of the masks.
    """
    center, half = views.region or view_center(views)
    points = _points(sources, center, half)
    inside = _inside(views, points)
    common = points[inside.float().mean(0) >= _COMMON]
    if not len(common):
        return None
    least, most = common.amin(0), common.amax(0)
    half = max(_WIDER * float((most - least).max()) / 2, 1e-3 * half)
    return _inside(views, _points(sources, (least + most) / 2, half))


def _points(views: Views, center: Tensor, half: float) -> Tensor:
    """Make points [V, R, S, 3] on rays of pixels inside the masks, in a ball around a cube."""
    pixels = []
    for mask in views.masks:
        found = torch.nonzero(mask > 0.5)
        rows = torch.linspace(0, len(found) - 1, _RAYS).round().long()
        pixels.append(found[rows.to(found.device)].flip(1) + 0.5)
    eye, forward = views.eyes()
    depth, reach = ((center - eye) * forward).sum(1), half * 3**0.5
    ends = [
        views.camera.unproject(torch.stack(pixels), z.clamp(min=1e-3 * reach)[:, None].expand(-1, _RAYS), views.size)
        for z in (depth - reach, depth + reach)
    ]
    along = torch.linspace(0, 1, _RAYS).to(depth)[:, None]
    return ends[0][:, :, None] * (1 - along) + ends[1][:, :, None] * along


def _inside(views: Views, points: Tensor) -> Tensor:
    """Return in which masks points [V, R, S, 3] lie: [N, V, R, S] bool."""
    values = mask_values(views, views.masks, points.reshape(-1, 3))
    return torch.stack([(value > 0.5).reshape(points.shape[:-1]) for value in values])


def _remedies(views: Views) -> Iterator[tuple[str, Views]]:
    """Yield (remedy, corrected views) for each common mistake; the remedy is the subject of a sentence."""
    yield from _turned_images(views)
    if views.camera.K is not None:
        yield from _exchanged_axes(views)
        yield from _changed_intrinsics(views, views.camera.K)


def _turned_images(views: Views) -> Iterator[tuple[str, Views]]:
    """Yield the views with rotated and mirrored images."""
    camera, masks = views.camera, views.masks
    yield "turning the images by 180°", Views(camera, masks.rot90(2, (1, 2)))
    yield "mirroring the images left to right", Views(camera, masks.flip(2))
    yield "mirroring the images top to bottom", Views(camera, masks.flip(1))
    for quarters, way in ((1, "counter-clockwise"), (3, "clockwise")):
        text, turned = f"turning the images by 90° {way}", masks.rot90(quarters, (1, 2))
        yield text, Views(camera, turned)
        if camera.orig_size is not None and camera.orig_size[0] != camera.orig_size[1]:
            # A camera file without sizes takes those of the images, so they are exchanged, too.
            yield text, Views(replace(camera, orig_size=camera.orig_size[::-1]), turned)


def _exchanged_axes(views: Views) -> Iterator[tuple[str, Views]]:
    """Yield the views with exchanged directions and axes of the matrices."""
    R, t = views.camera.rotation, world_origin(views.camera)
    signs = R.new_tensor([1.0, -1.0, -1.0])
    axes = "OpenCV's camera axes (y down, z forward) and OpenGL's (y up, z backward)"
    direction = "camera-to-world and world-to-camera matrices"
    back, place = R.transpose(1, 2), views.camera.position  # the inverse; its translation is the position of the camera
    yield f"exchanging {axes}", _posed(views, R * signs[:, None], t * signs)
    yield f"exchanging {direction}", _posed(views, back, place)
    text = f"exchanging {direction}, and {axes},"
    yield text, _posed(views, back * signs, place)
    yield text, _posed(views, back * signs[:, None], place * signs)
    yield text, _posed(views, back * signs[:, None] * signs, place * signs)


def _changed_intrinsics(views: Views, K: Tensor) -> Iterator[tuple[str, Views]]:
    """Yield the views with intrinsics of exchanged width and height, and scaled ones."""
    size = views.camera.orig_size or (1.0, 1.0)
    exchange = "exchanging width and height"
    aspect = size[1] / size[0]
    if aspect != 1:
        for factor in (aspect, 1 / aspect):
            yield f"{exchange} in the intrinsics", _with_K(views, _scaled(K, factor, 1 / factor))
        yield f"{exchange} of the field of view", _with_K(views, _scaled(K, aspect, aspect, 1.0))
        yield f"{exchange} of the field of view", _with_K(views, _scaled(K, 1 / aspect, 1 / aspect, 1.0))
    swapped = K.clone()
    swapped[:, 0, 2], swapped[:, 1, 2] = K[:, 1, 2], K[:, 0, 2]
    yield f"{exchange} in the principal point", _with_K(views, swapped)
    centered = size[1] / 2 / float(K[:, 0, 2].mean().clamp(min=1e-3 * size[1]))
    for scale in (*_SCALES, centered):
        yield f"scaling the intrinsics by {scale:.3g}", _with_K(views, _scaled(K, scale, scale))
        yield f"scaling the principal point by {scale:.3g}", _with_K(views, _scaled(K, 1.0, 1.0, scale))


def _scaled(K: Tensor, across: float, down: float, center: float | None = None) -> Tensor:
    """Scale the rows of K [N, 3, 3]; ``center`` is the factor of the principal point if it differs."""
    centers = (across, down) if center is None else (center, center)
    factors = [[across, across, centers[0]], [down, down, centers[1]], [1.0, 1.0, 1.0]]
    return K * K.new_tensor(factors)


def _with_K(views: Views, K: Tensor) -> Views:
    return Views(replace(views.camera, K=K), views.masks, None, views.region)


def _posed(views: Views, R: Tensor, t: Tensor) -> Views:
    return Views(with_extrinsics(views.camera, R.contiguous(), t), views.masks)
