"""Pieces of a reconstruction, joined by the points that they share."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

_LEAST_SHARED = 10  # points that two pieces must share
_TOLERANCE = 0.1  # distance of shared points, relative to their spread
_ROUNDS = 3  # times that pieces are joined and further photographs placed


def join_pieces(colmap: Any, pieces: Sequence[Any], database: Path, images: Path, options: Any) -> Any:
    """Join the models of pieces to the largest one, as far as they share points, and place further photographs.

    A feature in one piece's points that matches one in another's, or is the same, gives a pair of points; the
    similarity between the pieces is found from all pairs robustly.

    Returns:
        The model; None without pieces.
    """
    if not pieces:
        return None
    best, *others = sorted(pieces, key=lambda piece: -piece.num_reg_images())
    with colmap.Database.open(database) as opened:
        for _ in range(_ROUNDS):
            left = []
            for other in others:
                pairs = _shared(opened, other, best)
                motion = _similarity(colmap, pairs, best) if len(pairs[0]) >= _LEAST_SHARED else None
                if motion is None:
                    left.append(other)
                else:
                    best = _joined(colmap, best, other, motion, database, images, options)
            if len(left) == len(others):
                break
            others = left
    return best


def _placed(model: Any) -> dict[int, Any]:
    """List the images of a model that have a pose, by number."""
    return {number: image for number, image in model.images.items() if image.has_pose}


def _points(model: Any, image: Any) -> dict[int, int]:
    """List the points that an image sees, by the feature that sees them."""
    return {row: point.point3D_id for row, point in enumerate(image.points2D) if point.has_point3D()}


def _shared(database: Any, source: Any, target: Any) -> tuple[np.ndarray, np.ndarray]:
    """Collect the places [P, 3] of points that two models share, in the worlds of both."""
    pairs: set[tuple[int, int]] = set()
    ours = {number: _points(target, image) for number, image in _placed(target).items()}
    for first, image in _placed(source).items():
        seen = _points(source, image)
        for second, points in ours.items():
            if first == second:
                rows = [(row, row) for row in seen]
            else:
                geometry = database.read_two_view_geometry(first, second)
                rows = [(a, b) for a, b in np.asarray(geometry.inlier_matches).tolist()]
            pairs |= {(seen[a], points[b]) for a, b in rows if a in seen and b in points}
    sources = np.array([source.points3D[a].xyz for a, _ in sorted(pairs)]).reshape(-1, 3)
    return sources, np.array([target.points3D[b].xyz for _, b in sorted(pairs)]).reshape(-1, 3)


def _similarity(colmap: Any, pairs: tuple[np.ndarray, np.ndarray], target: Any) -> Any:
    """Find the similarity between pairs of points robustly; None if too few agree."""
    spread = np.median(np.linalg.norm(pairs[1] - np.median(pairs[1], 0), axis=1))
    options = colmap.RANSACOptions()
    options.max_error = _TOLERANCE * float(spread)
    options.random_seed = 0
    found = colmap.estimate_sim3d_robust(*pairs, options)
    print("JOIN", len(pairs[0]), found and (found["num_inliers"], found["tgt_from_src"].scale))
    return found["tgt_from_src"] if found is not None and int(found["num_inliers"]) >= _LEAST_SHARED else None


def _joined(
    colmap: Any, best: Any, other: Any, motion: Any, database: Path, images: Path, options: Any
) -> Any:
    """Make one model of two: all poses, points from all features, and an adjustment."""
    poses = {number: (image, image.cam_from_world()) for number, image in _placed(best).items()}
    for number, image in _placed(other).items():
        if number not in poses:
            poses[number] = image, motion.transform_camera_world(image.cam_from_world())
    model = colmap.Reconstruction()
    for number, (image, pose) in poses.items():
        camera = (best if number in _placed(best) else other).cameras[image.camera_id]
        if not model.exists_camera(camera.camera_id):
            model.add_camera_with_trivial_rig(camera)
        fresh = colmap.Image(image.name, [point.xy for point in image.points2D], image.camera_id, number)
        model.add_image_with_trivial_frame(fresh, pose)
    with tempfile.TemporaryDirectory() as folder:
        model = colmap.triangulate_points(model, database, images, folder, options=options)
    colmap.bundle_adjustment(model)
    return model
