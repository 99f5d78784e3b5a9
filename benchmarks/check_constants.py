"""Half and double of constants of masks, agreement and exposure: ``python -m benchmarks.check_constants [STAGE …]``.

All pictures are drawn here. Stages:

- agreement: 10 views of a bent bar, right; with one of seven mistakes in all views; and with one view turned by 180°.
  Counted are the right answers of nine, and beside them is the least share of a right mask that the hull fills.
- exposure: a painted torus in 12 views with gains of half to double; with highlights; with dark corners. Largest error
  of a gain in each, in logarithms, and the error of the vignetting.
- known: pictures of `benchmarks.mask_constants`: IoU of plain backgrounds, plain ones refused, paintings taken.
- box: the paintings, with a box around the object: mean and least IoU.
- cutout: eight studio pictures with a shadow on the ground: mean and least IoU.
- outline: `reconstruct` of drawings of four models that its network has not seen, from a side that is given: mean IoU
  of outlines, distance of true points, and error of their colours. colors: the same without refinement.
- gloss: the torus in nine sets of photos: doubts of five that agree with its colours, and missing ones of four others.
- moves: matches of 30 points of an object, 200 around it, eleven motions, three seeds: right answers of 33 with
  little noise, with wrong matches, and with a plane around the object.
- up: 40 sets of 8 cameras that are held by hand, upright or on their sides: mean error of the direction in degrees.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.geometry.sample_points import sample_points
from neural_renderer.apps.common.masks import rule
from neural_renderer.apps.common.pictures.photograph import photograph
from neural_renderer.apps.common.views import up
from neural_renderer.apps.fit import Views, agreement, doubts, exposure
from neural_renderer.apps.fit.photos.masks import known_masks, surroundings
from neural_renderer.apps.reconstruct.data.framing import scale_to_unit
from neural_renderer.apps.reconstruct.evaluation import cutout
from neural_renderer.apps.reconstruct.evaluation import picture as reconstruction
from tests.apps.fit import bent_bar

from .half_and_double import Stage, run_stages
from .mask_constants import _DATA, draw, pictures

_MODELS = Path(__file__).resolve().parents[2] / "shared/data/models"
_NAMES = (
    "car/gazebo__suv",
    "airplane/bluebell__BE20",
    "chair/quaternius_furn2019__Chair",
    "sofa/quaternius_furn2019__Sofa3",
)
_AZIMUTH = 140.0  # of drawings of models


def main() -> None:
    run_stages("python -m benchmarks.check_constants", __doc__, _STAGES)


MISTAKES: dict[str, Callable[[Views], Views]] = {
    "turning the images by 180°": bent_bar.upside_down,
    "mirroring the images left": bent_bar.mirrored,
    "exchanging OpenCV's": bent_bar.with_axes,
    "exchanging camera-to-world": bent_bar.inverted,
    "exchanging width and height in the intrinsics": lambda v: bent_bar.scaled(v, [[0.75] * 3, [4 / 3] * 3, [1] * 3]),
    "scaling the intrinsics by 0.5": lambda v: bent_bar.scaled(v, [[2] * 3, [2] * 3, [1] * 3]),
    "scaling the principal point by 0.5": lambda v: bent_bar.scaled(v, [[1, 1, 2], [1, 1, 2], [1] * 3]),
    "1 of 10 views (view 3)": bent_bar.with_one_turned,
}
"""Mistakes by a part of the message that names them."""


def score_agreement() -> str:
    views, right = bent_bar.bent_bar(), 0
    for expected, spoil in {"": lambda v: v, **MISTAKES}.items():
        try:
            agreement.check_agreement(spoil(views))
            right += not expected
        except ValueError as error:
            right += bool(expected) and expected in str(error)
    return f"{right} of 9, {float(agreement.hull_coverage(views).min()):.3f}"


@cache
def torus() -> tuple[nr.Mesh, Views]:
    """Draw a painted torus in twelve views."""
    vertices, faces = nr.torus(0.7, 0.28, 32, 16)
    cubes = (vertices[faces.long()].mean(1) * 0.3 + 0.45)[:, None, None, None].expand(-1, 2, 2, 2, -1)
    mesh = nr.Mesh(vertices, faces, cubes)
    eyes = nr.get_points_from_angles(3.2, torch.tensor([75.0, 15.0, -40.0, 45.0]).repeat(3), torch.arange(12) * 30.0)
    return mesh, Views.of(mesh, nr.Camera.look_at(eyes, viewing_angle=22.0), 64)


def score_exposure() -> str:
    mesh, even = torus()
    values = 0.25 * torch.randn(12, 3, generator=torch.Generator().manual_seed(0))
    gains = (values - values.mean(0)).exp()
    photos = (even.photos * gains[:, :, None, None]).clamp(max=1)  # type: ignore[operator]
    shiny = photos.clone()
    shiny[::3, :, 24:30, 20:44] = 0.9 * even.masks[::3, None, 24:30, 20:44]
    place = (torch.arange(64) - 31.5) / 32
    dark = photos * 0.5 ** ((place.square() + place[:, None].square()) / 2)
    found = []
    for each in (photos, shiny, dark):
        gain, vignetting = exposure.estimate_exposure(replace(even, photos=each), mesh.vertices.detach(), mesh.faces)
        found.append(float((gain / gains).log().abs().max()))
    return " ".join(f"{error:.3f}" for error in (*found, abs(vignetting - math.log(0.5))))


@cache
def drawn() -> tuple[list[tuple[Path, Tensor]], list[Path]]:
    """Write the pictures of `benchmarks.mask_constants` to files."""
    folder = Path(tempfile.mkdtemp())
    plain, busy = pictures()
    files = []
    for number, picture in enumerate([picture for picture, _ in plain] + busy):
        files.append(folder / f"{number}.png")
        nr.save_image(files[-1], picture)
    return [(file, alpha) for file, (_, alpha) in zip(files, plain, strict=False)], files[len(plain) :]


def score_known() -> str:
    plain, busy = drawn()
    ious = []
    for file, alpha in plain:
        try:
            ious.append(iou(known_masks._mask(file, rule.MaskRule())[0], alpha))
        except ValueError:
            ious.append(0.0)
    taken = 0
    for file in busy:
        try:
            taken += known_masks._mask(file, rule.MaskRule()) is not None
        except ValueError:
            continue
    return f"{sum(ious) / len(ious):.3f}, {ious.count(0.0)} of 16, {taken} of 8"


@cache
def boxed() -> list[tuple[Tensor, Tensor]]:
    """Return the pictures before a painting with the alpha that was drawn."""
    meshes = [nr.UVMesh.load(_DATA / name).normalize() for name in ("spot.obj", "teapot.obj")]
    busy = pictures()[1]
    return [(picture, draw(meshes[row % 2], 40.0 * row, 13.0)[1]) for row, picture in enumerate(busy)]


def score_box() -> str:
    found = []
    for picture, alpha in boxed():
        rows, columns = (torch.nonzero((alpha > 0.5).any(axis)).flatten() for axis in (1, 0))
        edges = columns[0] - 6, rows[0] - 6, columns[-1] + 7, rows[-1] + 7
        left, top, right, bottom = (float(edge) / len(alpha) for edge in edges)
        found.append(iou(rule.box_mask(picture, (left, top, right, bottom)), alpha))
    return f"{sum(found) / len(found):.3f}, {min(found):.3f}"


@cache
def studio() -> list[tuple[Tensor, Tensor]]:
    """Draw pictures [H, W, 3] with a shadow on the ground, and their alpha."""
    found = []
    for name in ("spot.obj", "teapot.obj"):
        mesh = nr.UVMesh.load(_DATA / name).normalize()
        for azimuth in (20.0, 110.0, 200.0, 290.0):
            camera = nr.Camera.look_at(nr.get_points_from_angles(4.2, 12.0, azimuth), viewing_angle=19.0)
            alpha = nr.render(mesh, camera, 320, outputs=("alpha",)).alpha[0]
            found.append((photograph(mesh, azimuth).permute(1, 2, 0), alpha))
    return found


def score_cutout() -> str:
    found = []
    for picture, alpha in studio():
        try:
            found.append(iou(cutout.cut_out(picture)[3], alpha))
        except ValueError:
            found.append(0.0)
    return f"{sum(found) / len(found):.3f}, {min(found):.3f}"


@cache
def models() -> list[tuple[Tensor, Tensor, Tensor]]:
    """Draw models of the test split, RGBA [H, W, 4], with points [P, 3] of their surfaces and colours [P, 3]."""
    found = []
    for name in _NAMES:
        mesh = nr.Mesh.load(_MODELS / f"{name}.obj", texture_size=4)
        mesh = mesh.replace(vertices=scale_to_unit(mesh.vertices.detach()))
        camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 25.0, _AZIMUTH), viewing_angle=16.0)
        images = nr.render(mesh, camera, 320, light=nr.CameraLight())
        alpha = images.alpha[0][None]
        rgba = torch.cat((images.rgb[0] / alpha.clamp(min=1e-3), alpha)).clamp(0, 1).permute(1, 2, 0)
        some = sample_points(mesh, 4000, torch.Generator().manual_seed(0))
        found.append((rgba, some.points, mesh.colors_of_faces()[some.face_index].flatten(1, -2).mean(1)))
    return found


def score_reconstruct(steps: int) -> str:
    found = []
    for rgba, points, colors in models():
        made = reconstruction.reconstruct(rgba, azimuth=_AZIMUTH, steps=steps)
        distance, near = cKDTree(made.mesh.vertices.numpy()).query(points.numpy())
        error = (made.mesh.vertex_colors[torch.from_numpy(near)] - colors).abs().mean()
        found.append((made.outline, float(distance.mean()), float(error)))
    return ", ".join(f"{value:.4f}" for value in np.mean(found, 0))


@cache
def glossy() -> tuple[list[tuple[Views, tuple[Tensor, ...]]], list[tuple[Views, tuple[Tensor, ...]]]]:
    """Make views of the torus with colours that a shape explains, and others."""
    mesh, even = torus()
    random = torch.Generator().manual_seed(0)
    shape = mesh.vertices.detach(), mesh.faces, mesh.textures.detach()
    grey = *shape[:2], torch.full_like(shape[2], 0.5)
    at, photos = torch.arange(64.0), even.photos
    if photos is None:
        raise ValueError("photos: expected those of the torus, got none")

    def noisy(images: Tensor, noise: float) -> Tensor:
        return (images + noise * torch.randn(images.shape, generator=random)).clamp(0, 1)

    shiny = []
    for view, (photo, mask) in enumerate(zip(photos, even.masks, strict=True)):
        row, column = 20 + 4 * (view % 6), 20 + 3 * (view % 8)
        light = torch.exp(-((at[:, None] - row).square() + (at - column).square()) / 72)
        shiny.append(photo + (1 - photo) * light * mask)
    exposed = (photos * torch.linspace(0.8, 1.2, 12)[:, None, None, None]).clamp(0, 1)
    plain = 0.5 * even.masks[:, None].expand(-1, 3, -1, -1)
    right = [(photos, shape), (noisy(photos, 0.05), shape), (exposed, shape)]
    right += [(noisy(plain, 0.005), grey), (noisy(plain, 0.02), grey)]
    tinted = 0.5 * photos + 0.5 * torch.rand(12, 3, 1, 1, generator=random)
    wrong = [torch.stack(shiny), photos.roll(1, 0), tinted, torch.rand(photos.shape, generator=random)]
    return [(replace(even, photos=each), drawn) for each, drawn in right], [
        (replace(even, photos=each), shape) for each in wrong
    ]


def score_gloss() -> str:
    right, wrong = ([doubts.doubt_colors(*one) is not None for one in part] for part in glossy())
    return f"{sum(right)} of 5, {wrong.count(False)} of 4"


def score_moves() -> str:
    import pycolmap

    lens = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500.0, 640, 480)
    found = []
    for noise, wrong, is_flat in ((0.2, 0.0, False), (0.5, 0.2, False), (0.5, 0.2, True)):
        right = 0
        for *motions, expected in _MOTIONS:
            for seed in range(3):
                places, inside = matches(np.random.default_rng(seed), motions, noise, wrong, is_flat)
                right += surroundings._moves_as_one(pycolmap, (lens, lens), places, (inside, ~inside)) == expected
        found.append(str(right))
    return ", ".join(found)


_MOTIONS: list[tuple[float | None, float | None, float, tuple[int, bool]]] = [
    (12, 12, 0, (2, True)),  # degrees that the object and the surroundings turn, and the camera on the spot
    (12, 0, 0, (2, False)),
    (12, 0, 4, (2, False)),
    (-20, 12, 0, (2, False)),
    (None, 12, 0, (1, True)),  # nothing of the object is matched
    (None, 0, 4, (1, False)),
    (12, None, 0, (2, False)),
    (None, None, 0, (0, False)),
    (5, 5, 0, (2, True)),
    (5, 0, 1, (2, False)),
    (0, 0, 8, (2, False)),
]


def matches(
    random: np.random.Generator, motions: list[float | None], noise: float, wrong: float, is_flat: bool
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Draw points [N, 2] of an object and of its surroundings in two pictures; return also which are of the object."""

    def turned(points: np.ndarray, degrees: float) -> np.ndarray:
        angle = math.radians(degrees)
        return points @ np.array(
            [[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]]
        )

    def seen(points: np.ndarray, camera: float) -> np.ndarray:
        tilt = np.array([[1, 0, 0], [0, math.cos(0.4), -math.sin(0.4)], [0, math.sin(0.4), math.cos(0.4)]])
        place = turned(points @ tilt.T + [0, 0, 5], camera)
        return place[:, :2] / place[:, 2:] * 500 + [320, 240] + random.normal(0, noise, (len(points), 2))

    near, far = random.uniform(-0.5, 0.5, (30, 3)), random.uniform(-2, 2, (200, 3))
    far[:, 1] = 0.5 if is_flat else random.uniform(0.5, 1, 200)
    *turns, camera = motions
    parts = [(points, turn) for points, turn in zip((near, far), turns, strict=True) if turn is not None]
    if not parts:
        return (np.zeros((0, 2)), np.zeros((0, 2))), np.zeros(0, bool)
    first = np.concatenate([seen(points, 0) for points, _ in parts])
    second = np.concatenate([seen(turned(points, turn), camera or 0) for points, turn in parts])
    bad = random.random(len(second)) < wrong
    second[bad] = random.uniform(0, 1, (int(bad.sum()), 2)) * [640, 480]
    return (first, second), np.concatenate([np.full(len(points), points is near) for points, _ in parts])


def score_up() -> str:
    random = torch.Generator().manual_seed(0)
    errors = []
    for number in range(40):
        goal = F.normalize(torch.randn(3, generator=random), dim=0)
        across = F.normalize(torch.linalg.cross(goal, torch.randn(3, generator=random)), dim=0)
        axes = torch.stack((across, goal, torch.linalg.cross(across, goal)))
        elevation = 5 + 50 * torch.rand(8, generator=random)
        eyes = nr.get_points_from_angles(3.0, elevation, torch.arange(8) * 30.0) @ axes
        held = F.normalize(goal + 0.05 * torch.randn(8, 3, generator=random), dim=1)
        camera = nr.Camera.look_at(eyes, up=held)
        if number % 2:
            turn = nr.rotations.from_axis_angle(torch.tensor([[0.0, 0.0, math.pi / 2]]))[0]
            camera = replace(camera, rotation=turn @ camera.rotation)
        found = up.up_of_cameras(Views(camera, torch.ones(8, 2, 2)))
        errors.append(math.degrees(math.acos(max(-1.0, min(1.0, float(found @ goal))))))
    return f"{sum(errors) / len(errors):.2f}, {sum(error > 20 for error in errors)} of 40 wrong"


def iou(mask: Tensor, alpha: Tensor) -> float:
    return float(torch.minimum(mask, alpha).sum() / torch.maximum(mask, alpha).sum())


_STAGES: Mapping[str, Stage] = {
    "agreement": ({agreement: "_SIZE _RAYS _PARTNERS _COMMON _WIDER _LEAST _BETTER"}, score_agreement),
    "exposure": ({exposure: "_CELLS _DARK _ITERATIONS _EXACT _PRIOR"}, score_exposure),
    "known": (
        {known_masks: "_LEAST_OBJECT _MOST_OBJECT _MOST_PATTERN _STEP _MOST_FAINT SMALL_HOLE _MOST_HOLES"},
        score_known,
    ),
    "box": ({rule: "_LEVELS _ELLIPSE SMALL_HOLE"}, score_box),
    "cutout": ({cutout: "_SHADOW_SEARCHED _LEAST_INSIDE _FAINT _HUE _EDGE _DARKEST"}, score_cutout),
    "outline": (
        {reconstruction: "_THRESHOLDS _LATTICE _RATE _STIFF _BETAS"},
        partial(score_reconstruct, reconstruction.STEPS),
    ),
    "colors": ({reconstruction: "_DETAIL _INSIDE _ROUNDING _NORMAL _NEARER _BEHIND"}, partial(score_reconstruct, 0)),
    "gloss": ({doubts: "_MATT _NOISE"}, score_gloss),
    "moves": ({surroundings: "_LEAST _TOLERANCE _FLAT _TOGETHER"}, score_moves),
    "up": ({up: "_UPRIGHT _SPREAD _SNAP"}, score_up),
}

if __name__ == "__main__":
    main()
