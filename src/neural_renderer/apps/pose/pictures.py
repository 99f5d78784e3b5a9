"""Pictures of poses: the object's outline, and what does not fit, drawn on the photographs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from ...camera import Camera
from ...io import save_image
from ...rendering.forward import render
from .model import Model

_MOST_ROWS = 12  # of a file
_FADED = 0.35  # of the picture, towards white
_GAP, _GREY = 3, 0.6  # pixels between panels, and their colour
_EXCESS, _LACK, _OUTLINE = (0.85, 0.2, 0.15), (0.1, 0.3, 0.85), (0.95, 0.55, 0.0)
_OUTSIDE, _OBJECT = 0.2, 0.8  # grey values of a silhouette
_TINT = 0.8  # most share of the colours of differences
_NEAR = 0.02  # nearest surface that is drawn, in radii of the object


@torch.no_grad()
def overlay(mesh: object, camera: Camera, photo: Tensor | None, mask: Tensor) -> Tensor:
    """Draw poses on pictures: photo, the drawn object and both, one picture below the other.

    The outline is orange, and grey around the drawn object, which may be white. Where the object covers more than the
    mask, the picture is red; where it covers less, blue.

    Args:
        mesh: The mesh.
        camera: N cameras in its world.
        photo: [N, 3, H, W] in [0, 1], or None.
        mask: [N, H, W] in [0, 1].

    Returns:
        [3, N · (H + 3), 3 · (W + 3)] in [0, 1], with gaps below and right of each.
    """
    size = mask.shape[1], mask.shape[2]
    scale = Model.of(mesh).scale  # type: ignore[arg-type]
    near = _NEAR * scale
    images = render(mesh, camera, size, near=near, far=1e5 * near, outputs=("rgb", "alpha"))  # type: ignore[arg-type]
    alpha, given = images.alpha[:, None], mask[:, None]
    under = _OUTSIDE + (_OBJECT - _OUTSIDE) * given.expand(-1, 3, -1, -1) if photo is None else photo
    inside = (alpha > 0.5).float()
    around = functional.max_pool2d(inside, 3, 1, 1) - inside
    drawn = images.rgb + 1 - alpha
    drawn = drawn + around * (_GREY - drawn)
    both = _FADED + (1 - _FADED) * under
    for share, color in (((alpha - given).clamp(min=0), _EXCESS), ((given - alpha).clamp(min=0), _LACK)):
        both = both + _TINT * share * (torch.tensor(color)[:, None, None] - both)
    rim = inside - (-functional.max_pool2d(-inside, 3, 1, 1))
    both = both + rim * (torch.tensor(_OUTLINE)[:, None, None] - both)
    gap = 0, _GAP, 0, _GAP
    rows = torch.cat([functional.pad(panel, gap, value=_GREY) for panel in (under, drawn, both)], 3)
    return torch.cat(list(rows), 1).clamp(0, 1)


def save_overlays(path: Path, poses: Sequence[tuple[object, Camera, Tensor | None, Tensor]]) -> None:
    """Draw poses, given by the arguments of `overlay`, one below the other; of many, every second, third, ….

    Raises:
        OSError: The file cannot be written.
    """
    rows = [overlay(*pose) for pose in poses[:: math.ceil(len(poses) / _MOST_ROWS)]]
    width = max(row.shape[2] for row in rows)
    save_image(path, torch.cat([functional.pad(row, (0, width - row.shape[2]), value=1.0) for row in rows], 1))
