"""`neural-renderer reconstruct predict`: meshes from pictures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor

from ....io import load_image, save_image
from ....io.files import warn
from ....meshes.mesh import Mesh
from ...common.checks import check_earlier, check_outputs, picture_files
from ...common.command import MISMATCH, choose_device, say
from ...common.masks.rule import box_mask, mask_beside, mask_in_file
from ...common.observer import goes_on
from ...common.pictures.animation import save_animation
from ...common.pictures.photograph import turntable
from ...view.watching import stay, watching
from ..data.drawing import MESH_COLOR
from ..data.framing import SIZE
from ..evaluation.cutout import cut_out
from ..evaluation.picture import STEPS, load_shape_network, reconstruct, shipped_network
from ..evaluation.predict import best_frame, predict_meshes, prediction_picture
from ..evaluation.predictors import Predictor, network_predictor
from ..evaluation.refine import refine_steps
from ..networks.checkpoint import Model, load_model
from ..networks.shape_network import ShapeNetwork
from ..options import EvaluateOptions, PredictOptions

if TYPE_CHECKING:
    from ...view.viewer import Viewer

_SUFFIXES = (".obj", ".glb", ".ply")
_TURNTABLE_SIZE = 256  # pixels


def run(options: PredictOptions) -> int:
    """Predict and write meshes; return the exit code: 0, 1 if one of several pictures failed, else 3 for a doubt."""
    given = options.images
    if given and given[0].suffix == ".ckpt":  # earlier versions: predict CHECKPOINT IMAGE …
        options = replace(options, images=given[1:], checkpoint=options.checkpoint or given[0])
    options = replace(options, images=tuple(picture_files(options.images)))
    targets = _check(options)
    model = _network(options)
    with watching(options.watch) as viewer:
        failures, is_doubtful = _predict(options, targets, model, viewer)
        stay(viewer, True)
    if len(options.images) == 1 and failures:
        raise ValueError(failures[0])
    for text in failures:
        say(text, "red")
    return 1 if failures else MISMATCH if is_doubtful else 0


def _network(options: PredictOptions) -> Model | ShapeNetwork:
    """Load the shipped network, the weights of `pretrain`, or a checkpoint of `train`."""
    if options.threshold is not None and (options.checkpoint is None or options.checkpoint.suffix == ".pt"):
        raise ValueError(
            "--threshold: expected a checkpoint of train with it, got a network with an automatic threshold"
        )
    if options.checkpoint is None:
        return shipped_network()
    if options.checkpoint.suffix == ".pt":
        return load_shape_network(options.checkpoint)
    if options.azimuth is not None:
        raise ValueError("--azimuth: expected the shipped network, got a checkpoint that takes no view")
    return load_model(options.checkpoint, choose_device(options.device))


def _predict(
    options: PredictOptions, targets: dict[Path, Path], model: Model | ShapeNetwork, viewer: Viewer | None
) -> tuple[list[str], bool]:
    """Predict and write a mesh for each picture; return messages of those that failed, and whether one is doubtful."""
    make = _with_shapes if isinstance(model, ShapeNetwork) else _with_checkpoint
    console, failures, is_doubtful = Console(stderr=True), [], False
    is_single = len(options.images) == 1
    for path in track(options.images, "Meshes", console=console, transient=True, disable=is_single):
        if not goes_on(viewer):
            break
        try:
            with _naming(path):
                picture, image, mesh, note, doubts = make(options, path, model, viewer)
        except (ValueError, OSError) as error:
            failures.append(_failure(path, error))
            continue
        _write(options, targets[path], picture, image, mesh)
        say(f"{targets[path]}{note}")
        for doubt in doubts:
            say(f"{path}: {doubt}", "yellow")
        is_doubtful |= bool(doubts)
        if viewer is not None:
            viewer.show(mesh, path.stem)
    return failures, is_doubtful


# Picture [H, W, C], input [4, 64, 64] uint8, mesh, text for the terminal, and doubts.
_Made = tuple[Tensor, Tensor, Mesh, str, tuple[str, ...]]


def _with_shapes(options: PredictOptions, path: Path, model: Any, viewer: Viewer | None) -> _Made:
    """Predict a coloured mesh with the shipped network."""
    picture = load_image(path, upright=True)
    steps = STEPS if options.refine is None else options.refine
    found = reconstruct(
        picture,
        _mask(options, path, picture),
        azimuth=options.azimuth,
        steps=steps,
        network=model,
        observe=lambda *_: goes_on(viewer),
    )
    share = f"{found.category} ({found.probabilities[found.category]:.0%})" if found.verdict == "good" else "doubtful"
    note = f": {share}; outline IoU {found.outline:.2f}"
    return picture, (found.cutout * 255 + 0.5).to(torch.uint8), found.mesh, note, found.doubts


def _with_checkpoint(options: PredictOptions, path: Path, model: Any, viewer: Viewer | None) -> _Made:
    """Predict a mesh with a network of `train`."""
    device = choose_device(options.device)
    picture, image = _load(options, path, network_predictor(model, _threshold(options)), device)
    refine = refine_steps(model, options.refine)
    pixels = image[None].to(device)
    [(vertices, faces)] = predict_meshes(model, pixels, _threshold(options), refine, viewer, path.stem)
    return picture, image, Mesh(vertices, faces, face_colors=torch.tensor(MESH_COLOR).expand(len(faces), 3)), "", ()


def _threshold(options: PredictOptions) -> float:
    return EvaluateOptions.threshold if options.threshold is None else options.threshold


def _mask(options: PredictOptions, path: Path, picture: Tensor) -> Tensor | None:
    if options.box is not None:
        return box_mask(picture, options.box)
    if options.mask is None:
        return None
    file = mask_beside(options.mask, path.name) if options.mask.is_dir() else options.mask
    if file is None:
        raise ValueError(f"{options.mask}: expected a mask {path.stem}.png, got none")
    return mask_in_file(file, upright=True)


def _check(options: PredictOptions) -> dict[Path, Path]:
    """Check the options; return the mesh file of each picture."""
    mask, count = options.mask, len(options.images)
    targets = _targets(options)
    if options.output not in targets.values():
        check_earlier(options.output, False, options.force, targets.values())
    extras = [_beside(target, name) for target in targets.values() for name in ("sheet.png", "turntable.gif")]
    masks = list(mask.iterdir()) if mask is not None and mask.is_dir() else [mask]
    check_outputs([*targets.values(), *extras], [*options.images, *masks, options.checkpoint])
    if mask is not None and count > 1 and not mask.is_dir():
        raise ValueError(f"--mask: expected a folder of masks for {count} pictures, got {mask}")
    return targets


def _targets(options: PredictOptions) -> dict[Path, Path]:
    """Choose the mesh file of each picture."""
    images, output = options.images, options.output
    if output.suffix.lower() in _SUFFIXES:
        if len(images) > 1:
            raise ValueError(f"--output: expected a folder for {len(images)} meshes, got {output.name!r}")
        return {images[0]: output}
    if output.suffix and not output.is_dir() and len(images) == 1:
        expected = ", ".join(_SUFFIXES)
        raise ValueError(f"--output: expected a name that ends in {expected}, or a folder, got {output.name!r}")
    targets = {path: output / f"{path.stem}.{options.format}" for path in images}
    first: dict[str, Path] = {}
    for path, target in targets.items():
        if (other := first.setdefault(str(target).casefold(), path)) != path:  # some file systems ignore case
            raise ValueError(f"images: expected pictures with different names, got {other} and {path} for {target}")
    return targets


def _load(options: PredictOptions, path: Path, predict: Predictor, device: torch.device) -> tuple[Tensor, Tensor]:
    """Load a picture [H, W, 3 or 4], and make the input of the network."""
    picture = load_image(path, upright=True)
    mask = _mask(options, path, picture)
    if (
        mask is None
        and picture.shape == (SIZE, SIZE, 4)
        and float(picture[..., 3].min()) < 0.5 < float(picture[..., 3].max())
    ):
        return picture, (picture.permute(2, 0, 1) * 255 + 0.5).to(torch.uint8)
    return picture, best_frame(predict, cut_out(picture, mask), device)


def _write(options: PredictOptions, target: Path, picture: Tensor, image: Tensor, mesh: Mesh) -> None:
    mesh.save(target)
    if options.sheet:
        save_image(_beside(target, "sheet.png"), prediction_picture(picture, image, mesh))
    if options.turntable:
        frames = turntable(mesh.normalize(), options.turntable, size=_TURNTABLE_SIZE)
        save_animation(_beside(target, "turntable.gif"), frames, fps=15)


def _beside(target: Path, name: str) -> Path:
    """Return the path of an additional file of a mesh: ``chair.obj`` → ``chair_sheet.png``."""
    return target.with_name(f"{target.stem}_{name}")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Let warnings name the picture that they are about."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        text = str(warning.message)
        warn(text if str(path) in text else f"{path}: {text}")


def _failure(path: Path, error: Exception) -> str:
    """Format an error on one line, with the name of the picture."""
    text = " ".join(str(error).split())
    return text if str(path) in text or text.startswith("--") else f"{path}: {text}"
