"""Pieces of a reconstruction, joined by the photographs, the points and the outlines that they share."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ....camera import Camera
from ....io import load_image
from ...common.views.views import Views, downscale, view_center
from ..agreement import hull_coverage
from .copies import IMAGES, MASKS

LEAST_MATCHES = 12
"""Matches of two photographs, and points that two pieces share, that determine how they are placed."""
_TOLERANCE = 0.1  # distance of shared points, relative to their spread
_AGREEMENT = 0.9  # least agreement of outlines with right cameras; wrong ones reach 0.8
_SIDE = 96  # pixels of the outlines that are compared
_SCALES = np.exp(np.linspace(-0.5, 0.5, 21))  # sizes of a piece that are tried, relative to the likely one

Poses = dict[int, tuple[Any, np.ndarray, np.ndarray]]
"""Image, rotation [3, 3] from the world to the camera and eye [3], by number of the image."""
Motion = tuple[float, np.ndarray, np.ndarray]
"""Similarity of a world: X becomes scale · rotation · X + shift."""


def join_pieces(colmap: Any, pieces: Sequence[Any], folder: Path, database: Path, options: Any) -> Any:
    """Join the models of pieces to the largest one where photographs, points or outlines allow it; None if none do.

    The folder has ``images``, and perhaps ``masks``; the options are those of incremental mapping.
    """
    if not pieces:
        return None
    best, *others = sorted(pieces, key=lambda piece: -piece.num_reg_images())
    for other in others:
        if all(number in poses_of(best) for number in poses_of(other)):
            continue
        motion = _motion(colmap, other, best, folder, database)
        if motion is not None:
            best = _joined(colmap, best, other, motion, folder, database, options)
    return best


def poses_of(model: Any) -> Poses:
    """List the images of a model that have a pose."""
    placed = {number: image for number, image in model.images.items() if image.has_pose}
    return {n: (i, i.cam_from_world().rotation.matrix(), i.projection_center()) for n, i in placed.items()}


def _motion(colmap: Any, source: Any, target: Any, folder: Path, database: Path) -> Motion | None:
    """Find the similarity that maps the world of a piece to another's; None if it is not determined."""
    ours, theirs = poses_of(source), poses_of(target)
    shared = sorted(ours.keys() & theirs.keys())
    if not shared:
        return _by_points(colmap, source, target, database)
    rotation = _nearest_rotation(np.sum([theirs[n][1].T @ ours[n][1] for n in shared], axis=0))

    def motion(scale: float) -> Motion:
        shifts = [theirs[n][2] - scale * rotation @ ours[n][2] for n in shared]
        return scale, rotation, np.mean(shifts, axis=0)

    if len(shared) > 1:
        spread = [np.std([poses[n][2] for n in shared], axis=0).max() for poses in (ours, theirs)]
        likely = float(spread[1] / spread[0])
    else:
        likely = _distance(theirs) / _distance(ours)
    outlines = _outlines({**ours, **theirs}, folder)
    if outlines is None:
        return motion(likely)
    tried = [motion(likely * scale) for scale in _SCALES]
    return max(tried, key=lambda one: _agreement({**_moved(ours, one), **theirs}, outlines))


def outlines_agree(model: Any, folder: Path) -> bool:
    """Test whether the cameras of a model agree with the masks that its images have, if any."""
    poses = {n: pose for n, pose in poses_of(model).items() if (folder / MASKS / f"{pose[0].name}.png").is_file()}
    outlines = _outlines(poses, folder) if poses else None
    return outlines is None or _agreement(poses, outlines) >= _AGREEMENT


def _nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """Find the rotation [3, 3] nearest to a matrix."""
    left, _, right = np.linalg.svd(matrix)
    return left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right


def _by_points(colmap: Any, source: Any, target: Any, database: Path) -> Motion | None:
    """Find the similarity of two pieces by points that features of both show; None if too few agree."""
    pairs: set[tuple[int, int]] = set()
    others = {number: _points(image) for number, (image, _, _) in poses_of(target).items()}
    with colmap.Database.open(database) as opened:
        for first, (image, _, _) in poses_of(source).items():
            ours = _points(image)
            for second, theirs in others.items():
                matches = np.asarray(opened.read_two_view_geometry(first, second).inlier_matches).tolist()
                pairs |= {(ours[a], theirs[b]) for a, b in matches if a in ours and b in theirs}
    if len(pairs) < LEAST_MATCHES:
        return None
    sources = np.array([source.points3D[a].xyz for a, _ in sorted(pairs)])
    targets = np.array([target.points3D[b].xyz for _, b in sorted(pairs)])
    options = colmap.RANSACOptions()
    options.random_seed = 0
    options.max_error = _TOLERANCE * float(np.median(np.linalg.norm(targets - np.median(targets, 0), axis=1)))
    found = colmap.estimate_sim3d_robust(sources, targets, options)
    if found is None or int(found["num_inliers"]) < max(LEAST_MATCHES, len(pairs) / 2):
        return None
    motion = found["tgt_from_src"]
    return float(motion.scale), motion.rotation.matrix(), motion.translation


def _points(image: Any) -> dict[int, int]:
    """List the points that an image sees, by the feature that sees them."""
    return {row: point.point3D_id for row, point in enumerate(image.points2D) if point.has_point3D()}


def _distance(poses: Poses) -> float:
    """Compute the mean distance of cameras from what they look at."""
    center = view_center(Views(camera_of(poses), torch.ones(len(poses), 2, 2)))[0].double().numpy()
    return float(np.linalg.norm([eye - center for _, _, eye in poses.values()], axis=1).mean())


def _moved(poses: Poses, motion: Motion) -> Poses:
    """Move the world of cameras."""
    scale, turn, shift = motion
    return {n: (image, rotation @ turn.T, scale * turn @ eye + shift) for n, (image, rotation, eye) in poses.items()}


def camera_of(poses: Poses) -> Camera:
    """Make the cameras of poses, without distortion."""
    rotations, eyes = (torch.from_numpy(np.stack([pose[row] for pose in poses.values()])) for row in (1, 2))
    lenses = [image.camera for image, _, _ in poses.values()]
    K = torch.from_numpy(np.stack([lens.calibration_matrix() for lens in lenses])).float()
    shift = -torch.einsum("nij,nj->ni", rotations, eyes)
    return Camera.projection(K, rotations.float(), shift.float(), orig_size=(lenses[0].height, lenses[0].width))


def _outlines(poses: Poses, folder: Path) -> torch.Tensor | None:
    """Load small masks of images, [N, H, W]; None if one is missing."""
    files = [folder / MASKS / f"{image.name}.png" for image, _, _ in poses.values()]
    if not all(file.is_file() for file in files):
        return None
    return torch.stack([downscale(load_image(file)[..., :1].permute(2, 0, 1), _SIDE)[0] for file in files])


def _agreement(poses: Poses, outlines: torch.Tensor) -> float:
    """Measure how well outlines agree, in [0, 1]."""
    return float(hull_coverage(Views(camera_of(poses), outlines), 2).mean())


def _joined(colmap: Any, best: Any, other: Any, motion: Motion, folder: Path, database: Path, options: Any) -> Any:
    """Make one model of two: all poses, points from all features, and an adjustment."""
    ours, theirs = poses_of(best), _moved(poses_of(other), motion)
    model = colmap.Reconstruction()
    for source, poses in ((best, ours), (other, {n: pose for n, pose in theirs.items() if n not in ours})):
        for number, (image, rotation, eye) in poses.items():
            if not model.exists_camera(image.camera_id):
                model.add_camera_with_trivial_rig(source.cameras[image.camera_id])
            features = [point.xy for point in image.points2D]
            fresh = colmap.Image(image.name, np.array(features).reshape(-1, 2), image.camera_id, number)
            pose = colmap.Rigid3d(colmap.Rotation3d(rotation), -rotation @ eye)
            model.add_image_with_trivial_frame(fresh, pose)
    with tempfile.TemporaryDirectory() as place:
        model = colmap.triangulate_points(model, database, folder / IMAGES, place, options=options)
    adjustment = colmap.BundleAdjustmentOptions()
    adjustment.refine_extra_params = False
    adjust(colmap, model, adjustment)
    return model


def adjust(colmap: Any, model: Any, options: Any) -> None:
    """Adjust all cameras and points of a model, as ``bundle_adjustment``, which would turn on the log."""
    options.print_summary, options.ceres.solver_options.num_threads = False, torch.get_num_threads()
    config = colmap.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(colmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    colmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()
