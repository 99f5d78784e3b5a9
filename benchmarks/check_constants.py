"""Half and double of constants of masks, agreement and exposure: ``python -m benchmarks.check_constants [STAGE …]``.

All pictures are drawn here. Stages:

- agreement: 10 views of a bent bar, right; with one of seven mistakes in all views; and with one view turned by 180°.
  Counted are the right answers of nine, and beside them is the least share of a right mask that the hull fills.
- exposure: a painted torus in 12 views with gains of half to double; with highlights; with dark corners. Largest error
  of a gain in each, in logarithms, and the error of the vignetting.
- known: pictures of `benchmarks.mask_constants`: IoU of plain backgrounds, plain ones refused, paintings taken.
- box: the paintings, with a box around the object: mean and least IoU.
- cutout: eight studio pictures with a shadow on the ground: mean and least IoU.
- up: 40 sets of 8 cameras that are held by hand, upright or on their sides: mean error of the direction in degrees.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType

import torch
import torch.nn.functional as F
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps.common.masks import rule
from neural_renderer.apps.common.pictures.photograph import photograph
from neural_renderer.apps.common.views import up
from neural_renderer.apps.fit import Views, agreement, exposure
from neural_renderer.apps.fit.photos.masks import known_masks
from neural_renderer.apps.reconstruct.evaluation import cutout

from .half_and_double import table
from .mask_constants import _DATA, draw, pictures

_SIGNS = torch.tensor([1.0, -1.0, -1.0])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.check_constants", description=__doc__)
    parser.add_argument("stages", nargs="*", choices=[[], *_STAGES], help="stages; all by default")
    torch.set_num_threads(1)
    for name in parser.parse_args().stages or _STAGES:
        constants, score = _STAGES[name]
        print(f"\n{name}\n| constant | half | value | double |\n|---|---|---|---|")
        table(constants, score)


@cache
def bar() -> Views:
    """Draw ten views of a bent bar without symmetry, by calibrated cameras."""
    parts = [
        nr.cube()[0] * torch.tensor(size) + torch.tensor(place)
        for size, place in (
            ((0.7, 0.2, 0.25), (0.0, 0.0, 0.0)),
            ((0.2, 0.5, 0.2), (0.55, 0.5, 0.1)),
            ((0.1, 0.15, 0.5), (-0.5, -0.2, 0.5)),
        )
    ]
    mesh = nr.Mesh(torch.cat(parts), torch.cat([nr.cube()[1] + 8 * row for row in range(3)]))
    elevation = torch.tensor([-25.0, 10.0, 40.0, 20.0, 30.0]).repeat(2)
    camera = nr.Camera.look_at(nr.get_points_from_angles(3.2, elevation, torch.arange(10) * 36.0))
    rotation = camera.rotation * torch.tensor([1.0, -1.0, 1.0])[:, None]
    K = torch.tensor([[24 / math.tan(math.radians(22)), 0.0, 33.0], [0.0, 24 / math.tan(math.radians(22)), 23.0]])
    K = torch.cat((K, torch.tensor([[0.0, 0.0, 1.0]])))
    origin = -torch.einsum("bij,bj->bi", rotation, camera.origin)
    return Views.of(mesh, nr.Camera.projection(K, rotation, origin, orig_size=(48, 64)), (48, 64))


def spoiled(views: Views) -> dict[str, Views]:
    """Make views with usual mistakes, by a part of the advice that mends them."""
    camera, masks = views.camera, views.masks
    axes = replace(camera, rotation=camera.rotation * _SIGNS[:, None], translation=camera.translation * _SIGNS)
    inverse = replace(camera, rotation=camera.rotation.transpose(1, 2).contiguous(), translation=views.eyes()[0])

    def scaled(first: float, second: float, center: float) -> Views:
        rows = torch.tensor([[first, first, first * center], [second, second, second * center], [1.0] * 3])
        return Views(replace(camera, K=camera.K * rows), masks)  # type: ignore[operator]

    return {
        "turning the images by 180°": Views(camera, masks.rot90(2, (1, 2))),
        "mirroring the images left": Views(camera, masks.flip(2)),
        "exchanging OpenCV's": Views(axes, masks),
        "exchanging camera-to-world": Views(inverse, masks),
        "exchanging width and height in the intrinsics": scaled(0.75, 4 / 3, 1.0),
        "scaling the intrinsics by 0.5": scaled(2.0, 2.0, 1.0),
        "scaling the principal point by 0.5": scaled(1.0, 1.0, 2.0),
    }


def score_agreement() -> str:
    views, right = bar(), 0
    one = views.masks.clone()
    one[3] = one[3].rot90(2, (0, 1))
    for expected, wrong in {"": views, **spoiled(views), "1 of 10 views (view 3)": Views(views.camera, one)}.items():
        try:
            agreement.check_agreement(wrong)
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


_STAGES: Mapping[str, tuple[Mapping[ModuleType, Iterable[str]], Callable[[], str]]] = {
    "agreement": (
        {agreement: ("_SIZE", "_RAYS", "_PARTNERS", "_COMMON", "_WIDER", "_LEAST", "_BETTER")},
        score_agreement,
    ),
    "exposure": ({exposure: ("_CELLS", "_DARK", "_ITERATIONS", "_EXACT", "_PRIOR")}, score_exposure),
    "known": (
        {
            known_masks: (
                *("_LEAST_OBJECT", "_MOST_OBJECT", "_MOST_PATTERN", "_STEP", "_MOST_FAINT", "_SMALL"),
                "_MOST_HOLES",
            )
        },
        score_known,
    ),
    "box": ({rule: ("_LEVELS",)}, score_box),
    "cutout": (
        {cutout: (*("_SHADOW_SEARCHED", "_LEAST_INSIDE", "_FAINT", "_HUE", "_EDGE"),)},
        score_cutout,
    ),
    "up": ({up: ("_UPRIGHT", "_SPREAD", "_SNAP")}, score_up),
}

if __name__ == "__main__":
    main()
