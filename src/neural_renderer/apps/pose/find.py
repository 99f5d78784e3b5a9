"""`find_pose`: the pose of a known object, from one or several pictures and without a first guess."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from ...base import validate
from ...camera import Camera
from ...camera.camera import world_origin
from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ...optim import metrics
from .descent import Problem, covariance, descend, losses
from .model import Model, Poses
from .search import POSES_PER_PASS, apart, matched, search, settled
from .target import FAR_PRICE, Crop, Picture

_SIZES = 48, 64, 128, 256  # sides of the crops: to compare all candidates, and to refine fewer and fewer
_FACES = (1_000, 3_000), (4_000, 12_000)  # least and most of the models for the first crop, and the next two
_CANDIDATES, _REFINED, _COMPARED = (300, 2000), (6, 24), (3, 4)  # poses; more if parts may be hidden
_SETTLING, _SETTLED = ((0.4, 5), (0.13, 3)), 400  # places tried if parts may be hidden, and poses that remain
_BLOCK = 8  # pixels, of sums of residuals
_LEAST_COLOR = 0.1  # weight of colours, with which the focal length is fitted first
_HOPELESS = 3.0  # a pose whose loss is this many times the best one's is dropped
_OTHER = 0.35  # poses that differ by more, in radians, are distinct; candidates count as one within half of it
_MARGINS = 1.25, 1.7  # of crops around masks: of whole objects, and of partly occluded ones
# Agreement of outlines: least one of a match; below the second, more candidates are refined.
_LEAST_AGREEMENT, _SURE = 0.8, 0.95
_UNLIKE, _MOST_RESIDUAL = 0.92, 0.4  # below this agreement and above this photo residual: another object
_LOST = 0.05  # drop of the agreement between pictures of a video that means the track is lost
_ALIKE = 1.1, 0.01  # two poses explain the pictures equally within this factor and difference of RMS residuals
_INSIDE = 0.99  # mask values above it are purely object
_MOSTLY = 0.9  # mask values above it count for the contrast of colours
_CONTRAST, _MOST_COLOR = 0.3, 4.0  # deviation of colours on the object for which they have the weight 1; most weight
_HIDDEN_COLOR = 1.5  # factor of that weight if parts may be hidden: outlines are weaker evidence then
_FIRST_KEPT, _LAST_STEPS = 16, 40  # poses after the first steps if parts may be hidden; most steps for the best pose
_ROUNDING = 1e-3  # excess of masks over [0, 1] that is accepted
_LEAST_PIXELS = 8  # of a mask
_USUAL_ANGLE = 20.0  # initial viewing angle of an unknown lens

MISMATCH_ADVICE = (
    "the object's outline does not match the pictures: expected an agreement of at least {:.2f}, got {:.2f}; is it "
    "this object, are the masks and the viewing angle right, and are parts of it hidden?"
)
_UNLIKE_ADVICE = (
    "the object differs from the photo: expected a residual of at most {:.2f} or an agreement of at least {:.2f}, got "
    "{:.2f} and {:.2f}; is it this object, with these colours, and are the mask and the viewing angle right?"
)
_AMBIGUOUS = (
    "another pose explains the pictures as well: is the object symmetric, are the parts hidden that distinguish its "
    "sides, or is it another object?"
)

PoseVerdict = Literal["match", "ambiguous", "mismatch"]


@dataclass(frozen=True, eq=False)
class ObjectPose:
    """Pose of an object, with its uncertainty and alternatives.

    Attributes:
        matrix: [4, 4], from the mesh to the world of the cameras: a rotation and a translation. Without given cameras
            the world is the space of the first camera: x right, y **down**, z forward.
        camera: The N cameras in the world of the mesh: ``nr.render(mesh, pose.camera, size)`` draws it over the
            pictures.
        viewing_angle: Half the vertical field of view of the first camera, in degrees.
        covariance: [6, 6], or [7, 7] with the focal length: of a rotation about the object's centre in radians
            (axes right, down and forward of the first camera); of the centre's position relative to its depth (right,
            down, and the logarithm of size); and of the logarithm of the focal length. Excludes errors from a wrong
            mesh or from a fixed, wrong focal length.
        agreement: In [0, 1]: IoU of silhouettes; if parts may be occluded, the fraction of the masks that the
            object covers.
        verdict: "match"; "ambiguous" if another pose explains the pictures as well, as with symmetric objects; or
            "mismatch" if ``agreement`` is below 0.8, or, of a photo that nothing else may hide, below 0.92 with a
            ``residual`` above 0.4.
        advice: Sentences about a verdict that is no match.
        residual: Root mean square residual, relative to the object's area.
        others: [K, 4, 4], other poses that were refined, from best to worst.
        other_residuals: [K], theirs.

    Example:
        >>> image = nr.render(mesh, nr.Camera.look_at((1.0, 1.5, 3.0), viewing_angle=20), 64)
        >>> pose = nr.find_pose(mesh, mask=image.alpha[0], viewing_angle=20)
        >>> pose.verdict  # a sphere looks the same from all sides
        'ambiguous'
    """

    matrix: Tensor
    camera: Camera
    viewing_angle: float
    covariance: Tensor = field(repr=False)
    agreement: float
    verdict: PoseVerdict
    advice: tuple[str, ...]
    residual: float
    others: Tensor = field(repr=False)
    other_residuals: Tensor = field(repr=False)


@torch.no_grad()
def find_pose(
    mesh: Mesh | UVMesh | tuple[Tensor, Tensor],
    photo: Tensor | None = None,
    mask: Tensor | None = None,
    depth: Tensor | None = None,
    *,
    viewing_angle: float | None = None,
    camera: Camera | None = None,
    fit_focal: bool = False,
    hidden: bool = False,
    start: ObjectPose | None = None,
) -> ObjectPose:
    """Find the pose of a known object in one or several pictures, without an initial guess.

    The mesh is drawn from all sides at small size and compared with the mask, then with the colours. Gauss-Newton
    refines the best poses, on crops of growing size. The light of the photo is unknown: for each pose, the
    spherical harmonics of order 2 that fit best are found by least squares.

    Args:
        mesh: The mesh; a tuple (vertices, faces) has one colour. Its units are those of the result.
        photo: [3, H, W] in [0, 1], RGB; or [N, 3, H, W] for N cameras.
        mask: [H, W] or [N, H, W] in [0, 1], the object's silhouette.
        depth: [H, W] or [N, H, W] along the viewing axis, in units of the mesh; 0 where it is not known, as in
            ``torch.where(images.alpha > 0.99, images.depth, 0)`` of a drawing. Without ``mask``, the object is where
            depth is known.
        viewing_angle: Half the vertical field of view in degrees, in (0, 90). None, without ``camera``: it is fitted.
        camera: N cameras with perspective that are known relative to each other; in place of ``viewing_angle``.
        fit_focal: Whether to fit the focal length, from the given one on.
        hidden: Whether other things may hide parts of the object, so that ``mask`` is only what is visible of it.
        start: A pose close to this one, such as that of the last picture of a film. It is searched for everywhere if
            the result is no match, or agrees clearly less than this one.

    Returns:
        The pose.

    Raises:
        TypeError, ValueError: An argument of another type, shape or range, a mask of less than 8 or of all pixels, no
            picture, or a mesh without faces or size.

    Example:
        >>> image = nr.render(mesh, nr.Camera.look_at((1.0, 1.5, 3.0), viewing_angle=20), 64)
        >>> pose = nr.find_pose(mesh, mask=image.alpha[0], viewing_angle=20)
        >>> pose.agreement > 0.95
        True
        >>> nr.render(mesh, pose.camera, 64).alpha.shape
        torch.Size([1, 64, 64])
    """
    if not (start is None or isinstance(start, ObjectPose)):
        raise TypeError(f"start: expected an ObjectPose or None, got {type(start).__name__}")
    pictures, extrinsics, fits = _pictures(mesh, photo, mask, depth, viewing_angle, camera, fit_focal)
    model = Model.of(mesh)
    pictures = [_normalized(one, model.scale) for one in pictures]
    problems = _problems(model, pictures, fits, hidden)
    if start is not None:
        found = _refined(problems, _near(model, start, pictures[0], extrinsics))
        tracked = _result(problems[-1], pictures, found, extrinsics)
        if tracked.verdict != "mismatch" and tracked.agreement > start.agreement - _LOST:
            return tracked
    rough = problems[0]
    poses = search(rough.model, problems[1].crops[0], _CANDIDATES[hidden], hidden)
    if hidden:
        for reach, steps in _SETTLING:
            poses, costs = settled(rough.model, poses, rough.crops[0], rough.motions[0], rough.color, reach, steps)
            poses = poses[costs.argsort()[:_SETTLED]]
    else:
        poses = matched(rough.model, poses, problems[1].crops[0], rough.motions[0])
    costs = torch.cat([losses(rough, poses[i : i + POSES_PER_PASS])[0] for i in range(0, len(poses), POSES_PER_PASS)])
    poses = poses[costs.argsort()]
    few = _REFINED[hidden]
    rows = torch.tensor(apart(poses, few if hidden else 4 * few, _OTHER / 2))
    pose = _result(problems[-1], pictures, _refined(problems, poses[rows[:few]]), extrinsics)
    if pose.agreement < _SURE and len(rows) > few:
        more = _result(problems[-1], pictures, _refined(problems, poses[rows[few:]]), extrinsics)
        pose = min(pose, more, key=lambda each: each.residual)
    return pose if start is None else min(pose, tracked, key=lambda each: each.residual)


def _pictures(
    mesh: Any,
    photo: Tensor | None,
    mask: Tensor | None,
    depth: Tensor | None,
    viewing_angle: float | None,
    camera: Camera | None,
    fit_focal: bool,
) -> tuple[list[Picture], Tensor, bool]:
    """Check arguments: return pictures, the view matrix [3, 4] of the first, and whether focal lengths are fitted."""
    if not isinstance(mesh, (Mesh, UVMesh, tuple)):
        raise TypeError(f"mesh: expected a Mesh, a UVMesh or (vertices, faces), got {type(mesh).__name__}")
    stacks: dict[str, Tensor] = {}
    for name, value, shape in (
        ("photo", photo, (3, "H", "W")),
        ("mask", mask, ("H", "W")),
        ("depth", depth, ("H", "W")),
    ):
        if value is not None:
            single = getattr(value, "ndim", 0) == len(shape)
            validate.floating(name, value, shape if single else ("N", *shape))
            validate.finite(name, value)
            stacks[name] = (value[None] if single else value).detach().float().cpu()
    if not stacks:
        raise ValueError("photo: expected a photo, a mask or depth, got none")
    sizes = {name: (len(each), *each.shape[-2:]) for name, each in stacks.items()}
    if len(set(sizes.values())) > 1:
        raise ValueError(f"photo, mask and depth: expected as many of the same size, got {sizes}")
    if "depth" in stacks and "mask" not in stacks:
        stacks["mask"] = (stacks["depth"] > 0).float()
    if "mask" not in stacks:
        raise ValueError("mask: expected the object's silhouette, got none")
    for index, one in enumerate(stacks["mask"]):
        if not -_ROUNDING <= float(one.min()) <= float(one.max()) <= 1 + _ROUNDING:
            raise ValueError(f"mask: expected numbers in [0, 1], got {float(one.min()):.3g} to {float(one.max()):.3g}")
        covered = int((one > 0.5).sum())
        if not _LEAST_PIXELS <= covered < one.numel():
            some = "an empty mask" if not covered else f"{covered} of {one.numel()} pixels"
            wanted = f"an object of at least {_LEAST_PIXELS} pixels, and others around it, in every picture"
            raise ValueError(f"mask: expected {wanted}, got {some} in picture {index}")
    if "depth" in stacks and not bool(((stacks["depth"] > 0) & (stacks["mask"] > 0.5)).any()):
        raise ValueError("depth: expected distances above 0 within the mask, got none")
    if "photo" in stacks:
        stacks["photo"] = _solid(stacks["photo"], stacks["mask"])
    count, height, width = next(iter(sizes.values()))
    if camera is None:
        if count > 1:
            raise ValueError(f"camera: expected {count}, one for each picture, got none")
        fit_focal = fit_focal or viewing_angle is None
        angle = _USUAL_ANGLE if viewing_angle is None else validate.positive("viewing_angle", viewing_angle)
        if not angle < 90:
            raise ValueError(f"viewing_angle: expected degrees below 90, got {angle}")
        camera = Camera.look((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), viewing_angle=angle)
    elif viewing_angle is not None:
        raise ValueError("viewing_angle: expected None with camera, got both")
    if len(camera) != count:
        raise ValueError(f"camera: expected {count}, one for each picture, got {len(camera)}")
    if not camera.perspective or camera.dist_coeffs is not None or camera.mirrored:
        raise ValueError("camera: expected perspective without distortion, and not mirrored, got another lens")
    camera = camera.to("cpu", torch.float32).with_K((height, width))
    at = world_origin(camera)
    first, pictures = camera.rotation[0], []
    for index, K in enumerate(camera.K):  # type: ignore[arg-type]
        R = camera.rotation[index] @ first.T
        motion = torch.cat((R, (at[index] - R @ at[0])[:, None]), 1)
        pictures.append(Picture(K, motion=motion, **{name: each[index] for name, each in stacks.items()}))
    return pictures, torch.cat((first, at[0, :, None]), 1), fit_focal


def _solid(photo: Tensor, mask: Tensor) -> Tensor:
    """Replace colours at outlines, which are mixed with the background, by the mean of nearby inner ones."""
    inside = (mask > _INSIDE).float()[:, None]
    colors, share = F.avg_pool2d(torch.cat((photo * inside, inside), 1), 3, 1, 1).split((3, 1), 1)
    return torch.where((inside > 0) | (share == 0), photo, colors / share.clamp(min=1e-3))


def _normalized(picture: Picture, scale: float) -> Picture:
    """Change the unit of length to the object's radius."""
    motion = torch.cat((picture.motion[:, :3], picture.motion[:, 3:] / scale), 1)
    return replace(picture, motion=motion, depth=None if picture.depth is None else picture.depth / scale)


def _problems(model: Model, pictures: list[Picture], fits: bool, hidden: bool) -> list[Problem]:
    """Make the problems that are solved one after the other, with crops of growing size."""
    rough, coarse = (model.coarse(*count) for count in _FACES)  # colours at corners are drawn faster
    windows = [one.window(_MARGINS[hidden]) for one in pictures]
    motions = tuple(one.motion for one in pictures)
    result = []
    for size in _SIZES:
        crops = tuple(one.crop(window, size) for one, window in zip(pictures, windows, strict=True))
        robust = hidden and size > _SIZES[1]
        exact = size == _SIZES[-1] or len(model.faces) <= _FACES[1][1]
        result.append(
            Problem(
                model if exact else rough if size == _SIZES[0] else coarse,
                crops,
                motions,
                color=_color_weight(crops) * (_HIDDEN_COLOR if hidden else 1.0),
                zooms=fits and size >= _SIZES[1],
                loss="geman_mcclure" if robust else "huber" if hidden else "squares",
                levels=2 if robust else 3 if size == _SIZES[0] else 4,
                hidden=hidden,
                far=0.0 if robust else FAR_PRICE,
                smooth=size > _SIZES[0],
            )
        )
    return result


def _color_weight(crops: tuple[Crop, ...]) -> float:
    """Weigh colours such that their contrast on the object counts half as much as that of a silhouette."""
    if crops[0].images is None:
        return 0.0
    inside = torch.cat([crop.images[:, crop.mask > _MOSTLY].mean(0) for crop in crops if crop.images is not None])
    return min(max(_CONTRAST / max(float(inside.std()), 1e-3), 1.0), _MOST_COLOR) if len(inside) > 1 else 1.0


def _balanced(problem: Problem, pose: Poses, most: float) -> Problem:
    """Weight colours by the power of their residuals, so that colours which no light explains count less.

    Sums over blocks of pixels measure it, because residuals of neighbouring pixels are alike where the light is wrong.
    """
    images = torch.stack([each[0, :4] for each in problem.residuals(pose, problem.light(pose))])
    masks = torch.stack([crop.mask for crop in problem.crops])
    rims = F.max_pool2d(masks, 3, 1, 1) + F.max_pool2d(-masks, 3, 1, 1)
    power = F.avg_pool2d(images, _BLOCK).square().sum((0, 2, 3))
    ratio = power[0] / rims.sum().clamp(min=1) / (power[1:].mean() / masks.sum()).clamp(min=1e-12)
    return replace(problem, color=min(max(problem.color * float(ratio.sqrt()), _LEAST_COLOR), most))


def _refined(problems: list[Problem], poses: Poses) -> tuple[Poses, Tensor]:
    """Refine poses on growing crops; return the best ones that differ, and their losses at the last size but one."""
    rough, small, middle, large = problems
    steps = [(small, 5, _COMPARED[0], _OTHER)]
    if small.hidden:  # initial poses of occluded objects are less accurate
        first = [(replace(rough, smooth=True), 3, _FIRST_KEPT, _OTHER / 4)] if len(poses) > 1 else []
        steps = [*first, (small, 8, 6, _OTHER / 4), (small, 8, _COMPARED[1], _OTHER)]
        steps.append((replace(middle, loss="huber", levels=4), 10, _COMPARED[1], 0.0))  # from farther away, too
    for problem, iterations, kept, least in [*steps, (middle, 6, _COMPARED[1], 0.0)]:
        poses, loss = descend(problem, poses, iterations)
        order = loss.argsort()
        order = order[apart(poses[order], kept, least)]
        order = order[loss[order] <= _HOPELESS * loss[order[0]]]
        poses, loss = poses[order], loss[order]
    best, _ = descend(large, poses[:1], _LAST_STEPS)
    if large.zooms and large.color and not large.hidden:
        weighed = replace(large, color=_LEAST_COLOR)  # outlines first, as wrong light moves them, too
        best, _ = descend(weighed, best, 10)
        best, _ = descend(_balanced(weighed, best, large.color), best, 10)
    return Poses.cat([best, poses[1:]]), loss


def _near(model: Model, pose: ObjectPose, picture: Picture, view: Tensor) -> Poses:
    """Convert a pose, in the world of cameras, to that of the normalised mesh in the space of the first camera."""
    R = view[:, :3] @ pose.matrix[:3, :3]
    t = view[:, :3] @ (pose.matrix[:3, :3] @ model.center + pose.matrix[:3, 3]) + view[:, 3]
    x, y, z = t / model.scale
    zoom = (len(picture.mask) / 2 / math.tan(math.radians(pose.viewing_angle)) / picture.K[1, 1]).log()
    place = torch.stack((x / z * zoom.exp(), y / z * zoom.exp(), zoom - z.log()))
    return Poses(R[None], place[None], zoom[None, None])


def _matrix(model: Model, poses: Poses, view: Tensor) -> Tensor:
    """Convert poses to matrices [B, 4, 4] from the mesh's own units to the world of the cameras."""
    inverse = view[:, :3].T
    R = inverse @ poses.rotation
    t = (poses.translation() * model.scale - view[:, 3]) @ view[:, :3] - R @ model.center
    matrix = torch.eye(4).repeat(len(R), 1, 1)
    matrix[:, :3, :3], matrix[:, :3, 3] = R, t
    return matrix


def _cameras(model: Model, pictures: list[Picture], pose: Poses) -> Camera:
    """Make the cameras of the pictures in the world of the mesh, in its own units."""
    Ks: list[Tensor] = []
    Rs: list[Tensor] = []
    ts: list[Tensor] = []
    for one in pictures:
        K = one.K.clone()
        K[:2, :2] *= pose.zoom.exp()
        R = one.motion[:, :3] @ pose.rotation[0]
        t = model.scale * (one.motion[:, :3] @ pose.translation()[0] + one.motion[:, 3])
        Ks, Rs, ts = [*Ks, K], [*Rs, R], [*ts, t - R @ model.center]
    return Camera.projection(torch.stack(Ks), torch.stack(Rs), torch.stack(ts), orig_size=tuple(pictures[0].mask.shape))


def _agreement(problem: Problem, pose: Poses) -> float:
    """Compare the silhouettes of a pose with the masks."""
    shares = []
    for crop, motion in zip(problem.crops, problem.motions, strict=True):
        found = problem.model.fragments(pose, crop, motion)
        drawn = found.composite(torch.ones(*found.face_index.shape, 1))[:, 0] * crop.known
        if problem.hidden:
            shares.append(float(torch.minimum(drawn, crop.mask).sum() / crop.mask.sum()))
        else:
            shares.append(float(metrics.silhouette_iou(drawn, crop.mask[None])))
    return sum(shares) / len(shares)


def _result(problem: Problem, pictures: list[Picture], found: tuple[Poses, Tensor], view: Tensor) -> ObjectPose:
    """Judge poses, sorted from the best."""
    poses, loss = found
    model, best = problem.model, poses[:1]
    area = sum(float(one.mask.sum()) for one in problem.crops) * (_SIZES[2] / problem.crops[0].size) ** 2
    residuals = (2 * loss / area).sqrt()
    agreement = _agreement(problem, best)
    residual = float(residuals[0])
    alike = int((residuals[1:] < _ALIKE[0] * residuals[0] + _ALIKE[1]).sum())
    verdict: PoseVerdict = "match"
    advice: tuple[str, ...] = ()
    if agreement < _LEAST_AGREEMENT:
        verdict, advice = "mismatch", (MISMATCH_ADVICE.format(_LEAST_AGREEMENT, agreement),)
    elif problem.color and not problem.hidden and agreement < _UNLIKE and residual > _MOST_RESIDUAL:
        verdict, advice = "mismatch", (_UNLIKE_ADVICE.format(_MOST_RESIDUAL, _UNLIKE, residual, agreement),)
    elif alike:
        verdict, advice = "ambiguous", (_AMBIGUOUS,)
    matrices = _matrix(model, poses, view)
    camera = _cameras(model, pictures, best)
    angle = math.degrees(math.atan(len(pictures[0].mask) / 2 / float(pictures[0].K[1, 1] * best.zoom.exp())))
    spread = covariance(problem, best)
    numbers = agreement, verdict, advice, residual
    return ObjectPose(matrices[0], camera, angle, spread, *numbers, matrices[1:], residuals[1:])
