"""Files of single outputs that `neural-renderer render --save` writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from ..camera import Camera
from ..io.values import VALUE_SUFFIXES, open_exr, save_output
from ..rendering import render
from .options import RenderOptions

_PICTURES = {
    "rgb": (".png", ".jpg", ".jpeg"),
    "alpha": (".png", ".jpg", ".jpeg"),
    "depth": (".png",),
    "normal": (".png",),
    "barycentric": (".png",),
}


def check_saved(save: Sequence[tuple[str, Path]]) -> None:
    """Raise ValueError for files whose suffix does not fit the output, ModuleNotFoundError if a writer is missing."""
    for name, path in save:
        suffixes = (*_PICTURES.get(name, ()), *VALUE_SUFFIXES)
        if path.suffix.lower() not in suffixes:
            raise ValueError(f"--save {name}: expected a name that ends in {', '.join(suffixes)}, got {path.name!r}")
        if path.suffix.lower() == ".exr":
            open_exr(path)


@torch.no_grad()
def save_outputs(options: RenderOptions, mesh: Any, camera: Camera, size: tuple[int, int], **scene: Any) -> None:
    """Draw the outputs of ``--save`` from one camera and write them.

    Args:
        options: The options of the command.
        mesh: The mesh.
        camera: One camera.
        size: Height and width in pixels.
        **scene: Light, shading, background, layers, and near and far planes, as in `render`.
    """
    names = dict(options.save)  # each once
    smooth = [name for name in names if name in ("rgb", "alpha")]
    plain = [name for name in names if name not in smooth]
    images: dict[str, Any] = {}
    if smooth:
        drawn = render(mesh, camera, size, outputs=smooth, **scene)
        images |= {name: getattr(drawn, name)[0] for name in smooth}
    if plain:
        geometry = {name: scene[name] for name in ("near", "far")}
        drawn = render(
            mesh, camera, size, outputs=(*plain, "alpha"), anti_aliasing=False, shading="smooth", light=None, **geometry
        )
        images |= {name: getattr(drawn, name)[0] for name in plain}
        if "depth" in images:
            images["depth"] = images["depth"] * drawn.alpha[0]  # 0 in place of the far plane
    for name, path in options.save:
        image = images[name].cpu()
        save_output(path, (image.movedim(0, 2) if image.dim() == 3 else image).numpy(), name, options.depth_scale)
