"""Half and double of each constant of masks before a plain background: ``python -m benchmarks.mask_constants``.

Sixteen pictures of 320² show spot or the teapot before a background that is a quadratic function of position, with
noise of 0.005 to 0.04; eight more show them before a painting, which is no plain background. Printed are the mean and
the least IoU of the masks with the drawn alpha, the number of plain backgrounds that were refused (of 16, IoU 0), and
that of paintings that were not (of 8).
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

import neural_renderer as nr
from neural_renderer.apps.common.masks import operations, rule

from .half_and_double import table

_DATA = Path(__file__).resolve().parents[1] / "examples" / "data"
_SIZE, _NOISES = 320, (0.005, 0.01, 0.02, 0.04)
_CONSTANTS = {
    rule: (
        *("_BORDER", "_BACKGROUND_SHARE", "_SMOOTH", "_ITERATIONS", "_LEAST_RESIDUAL", "_LEAST_THRESHOLD", "_NOISES"),
        *("_MOST_THRESHOLD", "MOST_SEARCHED"),
    ),
    operations: ("_OUTLINE", "_NEAR", "_LEAST_CONTRAST", "_SPECK"),
}


def main() -> None:
    plain, busy = pictures()
    table(_CONSTANTS, lambda: score(plain, busy))


def pictures() -> tuple[list[tuple[Tensor, Tensor]], list[Tensor]]:
    """Draw pictures [H, W, 3] with their alpha [H, W] before plain backgrounds, and pictures before a painting."""
    random = torch.Generator().manual_seed(0)
    meshes = [nr.UVMesh.load(_DATA / name).normalize() for name in ("spot.obj", "teapot.obj")]
    painting = nr.load_image(_DATA / "starry_night.jpg")[..., :3].permute(2, 0, 1)
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, _SIZE)] * 2, indexing="ij")
    plain = []
    for number in range(16):
        rgb, alpha = draw(meshes[number % 2], 40.0 * number, 12.0 + 2 * (number % 3))
        color = torch.rand(3, generator=random) * 0.5 + 0.4
        terms = (torch.rand(5, generator=random) - 0.5) * torch.tensor([0.25, 0.25, 0.15, 0.15, 0.15])
        shade = 1 + (terms[:, None, None] * torch.stack((x, y, x * x, y * y, x * y))).sum(0)
        picture = rgb + (1 - alpha) * (color[:, None, None] * shade).clamp(0, 1)
        picture = picture + _NOISES[number % 4] * torch.randn(picture.shape, generator=random)
        plain.append((picture.clamp(0, 1).permute(1, 2, 0).contiguous(), alpha))
    background = functional.interpolate(painting[None], (_SIZE, _SIZE), mode="area")[0]
    busy = []
    for number in range(8):
        rgb, alpha = draw(meshes[number % 2], 40.0 * number, 13.0)
        busy.append((rgb + (1 - alpha) * background.roll(40 * number, 2)).permute(1, 2, 0).contiguous())
    return plain, busy


def draw(mesh: nr.UVMesh, azimuth: float, viewing_angle: float) -> tuple[Tensor, Tensor]:
    camera = nr.Camera.look_at(nr.get_points_from_angles(6.0, 20.0, azimuth), viewing_angle=viewing_angle)
    images = nr.render(mesh, camera, _SIZE, light=nr.CameraLight())
    return images.rgb[0], images.alpha[0]


def score(plain: list[tuple[Tensor, Tensor]], busy: list[Tensor]) -> str:
    found = [(find(picture), alpha) for picture, alpha in plain]
    ious = [
        0.0 if mask is None else float(torch.minimum(mask, alpha).sum() / torch.maximum(mask, alpha).sum())
        for mask, alpha in found
    ]
    refused, taken = sum(mask is None for mask, _ in found), sum(find(picture) is not None for picture in busy)
    return (
        f"IoU {sum(ious) / len(ious):.3f}, least {min(ious):.3f}; refused {refused} of 16; paintings taken {taken} of 8"
    )


def find(picture: Tensor) -> Tensor | None:
    try:
        return rule.MaskRule().find(picture)
    except ValueError:
        return None


if __name__ == "__main__":
    main()
