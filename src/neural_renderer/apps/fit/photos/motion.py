"""Structure from motion by pycolmap: features, matches, poses, and one model of all pieces."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ....io.atomic_write import write_file
from ....io.files import import_library
from ...common.views.views import Views
from ..doubts import ONE_SIDE, cameras_apart
from .copies import IMAGES, MASKS, MODEL, Photographs, Progress, smooth
from .masks.surroundings import inside_mask, stands_still
from .missing import only_turned, reasons
from .pairs import MOST_APART, Agreement, agreement, apart, choose, drop_flat, initial_pairs
from .pieces import LEAST_MATCHES, adjust, camera_of, join_pieces, outlines_agree, poses_of

_DATABASE = "database.db"
_WAYS = "ways.json"  # distance between a model's cameras and others that explain the matches as well
_FEATURE_SIDE = 1200  # pixels of the longer side in which features are searched
_TRIED = 3  # photographs whose features are counted
_MOST_FEATURES = 3000  # of a photograph; fewer than half are searched and matched with more care, which takes longer
_PEAK = 0.002  # contrast of a feature; a third of SIFT's, because objects have less texture than houses
_SMOOTH = 1.6  # pixels by which photographs are smoothed if they do not match; noise hides their features
_LEAST_POSE = 15  # points that a photograph must see to be placed
_START = 50, 8.0  # matches of the first pair, and degrees between its rays
_LEAST_INLIERS = 0.15  # share of a photograph's matches that agree with its place
_ALL_PAIRS = 100  # up to this number of photographs all pairs are matched, of more the neighbours
_NEIGHBOURS = 10
_BLOCK = 32  # pairs that are matched between two looks whether to stop
_ERRORS = (3.0, 1.5)  # reprojection errors in pixels, beyond which points are left out of the last adjustments
_LEAST_ANGLE = 1.5  # degrees between rays of a point
_MANY = 300  # with as many points in a photograph, they also determine the distortion of the lens
_SHARING = 5  # with as many photographs of one lens, its centre is determined
_PASSES = 8  # passes in which pairs are matched, each through all photographs; the first detects a pure rotation
_POLL = 1.0  # seconds between two looks at the progress
_OUTSIDE = 0.1  # share of the features outside of masks, above which they were not restricted to these
_MOST_STARTS = 6  # pairs from which mapping begins anew, where the cameras contradict the matches
_REPEATS = 2  # ways to begin in a row that lead to the same cameras, after which others would, too
_NO_DEPTH = (
    "expected photographs from different places, got some that show no depth: the camera turned on the spot, or the "
    "object before a background that stood still. Walk around the object, or along the wall; behind a turntable, put "
    "something plain"
)


@dataclass(frozen=True)
class Motion:
    """Cameras that structure from motion has found."""

    model: Path  # folder of the model in COLMAP's format
    placed: tuple[str, ...]  # names of the photographs that have a camera
    missing: dict[str, str]  # reason for each photograph, by its name, that has none, and what would help
    points: int  # number of points
    agreement: Agreement  # of the matched pairs of photographs with the cameras
    apart: float  # distance of other cameras that agree as well with the matches, relative to the spread of the cameras
    is_smoothed: bool  # features were found in smoothed photographs, because too few matched as they are
    is_exact: bool  # photographs see so many points that outlines would not make the cameras better
    is_whole: bool  # features are those of the whole photographs, also where masks are known


def find_cameras(photographs: Photographs, progress: Progress) -> Motion:
    """Find the cameras of photographs, or read those that an earlier call has found.

    Features and matches are kept in ``database.db``, so that an interrupted call goes on where it was. Photographs that
    have a mask use only the features inside, unless the object stands still in its surroundings. Pieces are joined by
    the points that they share. ValueError: The camera only turned, or fewer than half of the photographs could be
    placed; the message says why, one by one.
    """
    colmap = import_library("pycolmap", "to find the cameras of photographs")
    folder, names = photographs.folder, photographs.names
    if len(names) < 3:
        raise ValueError(
            f"expected at least 3 photographs, and better 20 to 60 from all around the object, got {len(names)}"
            + "".join(f"\n  {name}: {why}" for name, why in photographs.refused.items())
        )
    database, model = folder / _DATABASE, folder / MODEL
    with _quiet(colmap):
        if not (model / "images.bin").is_file():
            best, away, is_smoothed = _reconstruct(colmap, photographs, progress)
            model.mkdir(parents=True, exist_ok=True)
            best.write_binary(str(model))
            write_file(model / _WAYS, json.dumps({"apart": round(away, 4), "smoothed": is_smoothed}) + "\n")
        best = colmap.Reconstruction(str(model))
        placed = tuple(sorted(image.name for image in best.images.values() if image.has_pose))
        missing = reasons(colmap, database, photographs, placed)
        is_whole = _has_outside(colmap, folder, placed)
        agreeing = agreement(colmap, database, best)
    if 2 * len(placed) < len(names):
        for file in model.iterdir():
            file.unlink()
        raise _too_few(missing, len(names))
    file = model / _WAYS
    ways = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    return Motion(
        *(model, placed, missing, best.num_points3D(), agreeing),
        apart=float(ways.get("apart", 0.0)),
        is_smoothed=bool(ways.get("smoothed", False)),
        is_exact=_sees_many(best),
        is_whole=is_whole,
    )


def _reconstruct(colmap: Any, photographs: Photographs, progress: Progress) -> tuple[Any, float, bool]:
    """Find features, matches, cameras and points.

    Returns how far other cameras that agree as well with matches are, too, and whether photographs were smoothed.
    ValueError: Nothing could be placed, or there is no depth.
    """
    (best, away), is_smoothed = _place(colmap, photographs, progress), False
    if best is None or 2 * best.num_reg_images() < len(photographs.names):
        best, away, is_smoothed = _place_smoothed(colmap, photographs, (best, away), progress)
    if best is None:
        found: dict[str, str] = reasons(colmap, photographs.folder / _DATABASE, photographs, ())
        raise _too_few(found, len(photographs.names))
    _refine(colmap, best)
    if best.num_points3D() < _LEAST_POSE:
        raise ValueError(_NO_DEPTH)
    return best, away, is_smoothed


def _place(colmap: Any, photographs: Photographs, progress: Progress) -> tuple[Any, float]:
    """Find features, match them and place photographs, as `_map` does. ValueError: The camera only rotated."""
    folder, names = photographs.folder, photographs.names
    masked = [name for name in names if (folder / MASKS / f"{name}.png").is_file()]
    options, is_whole = _feature_options(colmap), True
    if masked:
        progress("background", 0, 1)
        is_whole = stands_still(colmap, folder, masked, options, _matching_options(colmap))
        progress("background", 1, 1)
    _find_features(colmap, folder, names, is_whole, progress)
    best, away = _map(colmap, folder, names, progress)
    if _has_outside(colmap, folder, names) and (best is None or not outlines_agree(best, folder)):
        # A background that repeats itself, such as a wall with a pattern, may have misled.
        for file in folder.glob(f"{_DATABASE}*"):
            file.unlink()
        _find_features(colmap, folder, names, False, progress)
        best, away = _map(colmap, folder, names, progress)
    return best, away


def _place_smoothed(
    colmap: Any, photographs: Photographs, found: tuple[Any, float], progress: Progress
) -> tuple[Any, float, bool]:
    """Place smoothed photographs; if that explains more pairs than what was found, keep it, features and matches."""
    database = photographs.folder / _DATABASE
    with tempfile.TemporaryDirectory() as place:
        smoothed = smooth(photographs, Path(place), _SMOOTH, _FEATURE_SIDE)
        try:
            tried = _place(colmap, smoothed, progress)
        except ValueError:  # the reasons of the photographs as they are say more
            return *found, False
        models = [(found[0], database), (tried[0], smoothed.folder / _DATABASE)]
        best, _ = choose([(model, agreement(colmap, file, model)) for model, file in models if model is not None])
        if best is None or best is found[0]:
            return *found, False
        for file in database.parent.glob(f"{_DATABASE}*"):
            file.unlink()
        write_file(database, (smoothed.folder / _DATABASE).read_bytes())
    return *tried, True


def _too_few(missing: dict[str, str], count: int) -> ValueError:
    """Make the error for a set if fewer than half of the photographs are placed."""
    groups: dict[str, list[str]] = {}
    for name, why in missing.items():
        groups.setdefault(why, []).append(name)
    lines = "".join(f"\n  {', '.join(names)}: {why}" for why, names in groups.items())
    return ValueError(f"expected sharp photographs that overlap, placed {count - len(missing)} of {count}:{lines}")


@contextmanager
def _quiet(colmap: Any) -> Iterator[None]:
    """Keep the log of COLMAP off the screen."""
    log = colmap.logging
    before = log.stderrthreshold, log.alsologtostderr, log.minloglevel
    log.stderrthreshold, log.alsologtostderr, log.minloglevel = log.FATAL.value, False, log.FATAL.value
    try:
        yield
    finally:
        log.stderrthreshold, log.alsologtostderr, log.minloglevel = before


def _feature_options(colmap: Any) -> Any:
    options = colmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu, options.max_image_size = torch.get_num_threads(), False, _FEATURE_SIDE
    options.sift.max_num_features = _MOST_FEATURES
    return options


def _find_features(colmap: Any, folder: Path, names: Sequence[str], is_whole: bool, progress: Progress) -> None:
    """Find the features of photographs that have none yet, of the whole ones or inside masks; equal lenses are one."""
    options, cameras = _feature_options(colmap), dict[tuple[Any, ...], int]()

    def find(name: str, database: Path) -> None:
        reader = colmap.ImageReaderOptions()
        lens = colmap.infer_camera_from_image(folder / IMAGES / name)
        key = lens.width, lens.height, round(float(lens.focal_length)), lens.has_prior_focal_length
        reader.existing_camera_id = cameras.get(key, -1)
        if not is_whole and (folder / MASKS / f"{name}.png").is_file():
            reader.mask_path = folder / MASKS
        colmap.extract_features(
            database,
            folder / IMAGES,
            image_names=[name],
            camera_mode=colmap.CameraMode.SINGLE,
            reader_options=reader,
            extraction_options=options,
        )
        with colmap.Database.open(database) as opened:
            cameras[key] = opened.read_image_with_name(name).camera_id

    tried = names[:: max(1, len(names) // _TRIED)][:_TRIED]
    with tempfile.TemporaryDirectory() as place:
        for name in tried:
            find(name, Path(place) / _DATABASE)
        with colmap.Database.open(Path(place) / _DATABASE) as database:
            if 2 * database.num_keypoints() < _MOST_FEATURES * len(tried):
                options.sift.peak_threshold, options.sift.estimate_affine_shape = _PEAK, True
    cameras.clear()
    for done, name in enumerate(names):
        progress("features", done, len(names))
        find(name, folder / _DATABASE)
    progress("features", len(names), len(names))


def _has_outside(colmap: Any, folder: Path, names: Sequence[str]) -> bool:
    """Test whether there are features outside of the masks."""
    with colmap.Database.open(folder / _DATABASE) as database:
        places = {name: database.read_keypoints(database.read_image_with_name(name).image_id) for name in names}
    inside = np.concatenate([inside_mask(folder, name, features[:, :2]) for name, features in places.items()])
    return bool(np.mean(~inside) > _OUTSIDE)


def _matching_options(colmap: Any) -> Any:
    options = colmap.FeatureMatchingOptions()
    options.num_threads, options.use_gpu = torch.get_num_threads(), False
    return options


def _match(colmap: Any, database: Path, names: Sequence[str], progress: Progress) -> None:
    """Match the features of pairs of photographs. Features that stay where they are belong to a still background.

    ValueError: The camera only rotated; this is raised before many pieces without depth are mapped and joined.
    """
    options, geometry = _matching_options(colmap), colmap.TwoViewGeometryOptions()
    geometry.min_num_inliers, geometry.filter_stationary_matches = LEAST_MATCHES, True
    geometry.ransac.random_seed = 0
    near = {*range(1, _NEIGHBOURS + 1), *(2**power for power in range(4, len(names).bit_length()))}
    rows = [(a, b) for b in range(len(names)) for a in range(b) if len(names) <= _ALL_PAIRS or b - a in near]
    rows = [row for first in range(_PASSES) for row in rows[first::_PASSES]]
    token = colmap.CancellationToken()
    with (
        tempfile.TemporaryDirectory() as folder,
        ThreadPoolExecutor(1) as pool,
        # Opened before matches are written, because opening writes, too, and COLMAP aborts on concurrent writes.
        colmap.Database.open(database) as opened,
    ):
        options.guided_matching = 2 * opened.num_keypoints() < _MOST_FEATURES * len(names)
        # One call for all pairs, because each call indexes all features again.
        pairs = colmap.ImportedPairingOptions()
        pairs.block_size = _BLOCK
        pairs.match_list_path = Path(folder) / "pairs.txt"
        pairs.match_list_path.write_text("".join(f"{names[a]} {names[b]}\n" for a, b in rows))
        matching = pool.submit(colmap.match_image_pairs, database, options, pairs, geometry, cancellation_token=token)
        try:
            known = 0
            while not wait([matching], _POLL).done:
                before, known = known, min(opened.num_matched_image_pairs(), len(rows))
                progress("matches", known, len(rows))
                if before < len(rows) // _PASSES <= known and only_turned(colmap, opened):
                    raise ValueError(_NO_DEPTH)
            matching.result()
        finally:
            token.cancel()
        if only_turned(colmap, opened):
            raise ValueError(_NO_DEPTH)
    progress("matches", len(rows), len(rows))


def mapping_options(colmap: Any) -> Any:
    """Make the options of incremental mapping, for objects: few points, and lenses without distortion at first."""
    options = colmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = torch.get_num_threads(), 0
    options.min_num_matches, options.min_model_size = LEAST_MATCHES, 3
    # With few points, the distortion of a lens would overfit.
    options.ba_refine_extra_params = options.mapper.abs_pose_refine_extra_params = False
    options.mapper.init_min_num_inliers, options.mapper.init_min_tri_angle = _START
    options.mapper.abs_pose_min_num_inliers, options.mapper.abs_pose_min_inlier_ratio = _LEAST_POSE, _LEAST_INLIERS
    return options


def _map(colmap: Any, folder: Path, names: Sequence[str], progress: Progress) -> tuple[Any, float]:
    """Match and place photographs: the largest model, and its largest distance, see `apart`, from others as good."""
    database = folder / _DATABASE
    _match(colmap, database, names, progress)
    best, away = _map_matched(colmap, folder, database, len(names), progress)
    if best is None or not _is_one_sided(best):
        return best, away
    with tempfile.TemporaryDirectory() as place:
        # If an object turns before a fixed background, pairs that match the background look like a turn of the camera.
        copy = Path(place) / _DATABASE
        write_file(copy, database.read_bytes())
        if not drop_flat(colmap, copy):
            return best, away
        turned, apart_of_others = _map_matched(colmap, folder, copy, len(names), progress)
        count = 0 if turned is None or _is_one_sided(turned) else turned.compute_num_observations()
        if count <= best.compute_num_observations():
            return best, away
        for file in folder.glob(f"{_DATABASE}*"):
            file.unlink()
        write_file(database, copy.read_bytes())
    return turned, apart_of_others


def _is_one_sided(model: Any) -> bool:
    """Test whether all cameras of a model look from one side."""
    poses = poses_of(model)
    return len(poses) > 2 and cameras_apart(Views(camera_of(poses), torch.ones(len(poses), 2, 2))) < ONE_SIDE


def _map_matched(colmap: Any, folder: Path, database: Path, count: int, progress: Progress) -> tuple[Any, float]:
    """Place photographs by their matches: the largest model with all pieces that join it, and its distance from others.

    Few points may bend a free focal length to a third of the true one, and the one from EXIF, or the usual one, may be
    wrong. So both are tried: kept until the last adjustment, and free. The first pair may mislead all that follow,
    above all where most features lie in a plane: if matched pairs contradict the cameras, mapping begins anew with
    others, until two more ways lead to the same cameras: the matches of an object with equal sides contradict any.
    """
    placed = 0

    def note() -> None:
        nonlocal placed
        placed = min(placed + 1, count)
        progress("cameras", placed, count)

    def place(is_kept: bool, start: tuple[int, int] | None = None) -> None:
        nonlocal placed
        placed = 0
        progress("cameras", placed, count)  # each attempt counts anew, or the last ones would look like a hang
        options = mapping_options(colmap)
        options.ba_refine_focal_length = not is_kept
        if start is not None:
            options.init_image_id1, options.init_image_id2 = start
        with tempfile.TemporaryDirectory() as folder_of_pieces:
            pieces = colmap.incremental_mapping(
                *(database, folder / IMAGES, folder_of_pieces, options),
                initial_image_pair_callback=note,
                next_image_callback=note,
            )
            model = join_pieces(colmap, list(pieces.values()), folder, database, options)
        if model is not None:
            found.append((model, agreement(colmap, database, model)))

    def away(model: Any, other: Any) -> float:
        # Cameras that differ only until their focal length is free, too, are the same.
        for one in (model, other):
            if id(one) not in refined:
                refined[id(one)] = _refined(colmap, one)
        return apart(refined[id(model)], refined[id(other)])

    def is_settled() -> bool:
        if len(found) < 2 + _REPEATS:
            return False
        earlier = choose(found[:-_REPEATS])[0]
        return all(
            poses_of(model).keys() <= poses_of(earlier).keys() and away(model, earlier) < MOST_APART
            for model, _ in found[-_REPEATS:]
        )

    found: list[tuple[Any, Agreement]] = []
    refined: dict[int, Any] = {}  # by the identity of a model
    for is_kept in (True, False):
        place(is_kept)
    for start in initial_pairs(colmap, database)[:_MOST_STARTS] if found else ():
        if any(pairs.is_good for _, pairs in found) or is_settled():
            break
        place(True, start)
    progress("cameras", count, count)
    best, others = choose(found)
    return best, max((away(model, best) for model in others), default=0.0)


def _refined(colmap: Any, model: Any) -> Any:
    """Copy a model, and adjust it with its focal length free."""
    copy, options = colmap.Reconstruction(model), colmap.BundleAdjustmentOptions()
    options.refine_extra_params = False
    adjust(colmap, copy, options)
    return copy


def _sees_many(model: Any) -> bool:
    """Test whether photographs see many points on average."""
    return bool(model.compute_num_observations() >= _MANY * model.num_reg_images())


def _refine(colmap: Any, model: Any) -> None:
    """Adjust all cameras and points once more, robustly, without the points that fit worst."""
    options = colmap.BundleAdjustmentOptions()
    options.refine_extra_params = _sees_many(model)
    shared = model.num_reg_images() >= _SHARING * model.num_cameras()
    options.refine_principal_point = options.refine_extra_params and shared  # else cameras turn for it, by 0.2°
    options.ceres.loss_function_type = colmap.LossFunctionType.CAUCHY
    for error in _ERRORS:
        colmap.ObservationManager(model).filter_all_points3D(error, _LEAST_ANGLE)
        adjust(colmap, model, options)
