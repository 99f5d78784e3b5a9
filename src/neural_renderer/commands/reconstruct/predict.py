"""`neural-renderer reconstruct predict`: a mesh from one picture, for one picture or for many."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor

from ...io import load_image, save_animation, save_image, save_mesh
from ...pictures.clay import clay_mesh
from ...pictures.photograph import photograph
from ...tasks.reconstruction.data.drawing import MESH_COLOR
from ...tasks.reconstruction.evaluation.cutout import cut_out
from ...tasks.reconstruction.evaluation.predict import best_frame, predict_meshes, prediction_picture
from ...tasks.reconstruction.evaluation.predictors import Predictor, network_predictor
from ...tasks.reconstruction.evaluation.refine import refine_steps
from ...tasks.reconstruction.networks.checkpoint import load_model
from ..common import check_outputs, checked_count, chosen_device
from ..options.reconstruct.predict import PredictOptions

_SUFFIXES = (".obj", ".glb", ".ply")
_PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp")


@dataclass(frozen=True)
class Predict(PredictOptions):
    """Turns pictures into meshes, as the options say."""

    def run(self) -> int:
        """Predict; returns the exit code: 0, or 1 if there was a picture that nothing could be made of."""
        checked_count("turntable", self.turntable, 0)
        if self.refine is not None:
            checked_count("refine", self.refine, 0)
        if not 0 < self.threshold < 1:
            raise ValueError(f"--threshold: expected a number above 0 and below 1, got {self.threshold}")
        targets = self._targets()
        others = [_beside(target, name) for target in targets.values() for name in ("sheet.png", "turntable.gif")]
        masks = list(self.mask.iterdir()) if self.mask is not None and self.mask.is_dir() else [self.mask]
        check_outputs([*targets.values(), *others], [*self.images, *masks, self.checkpoint])
        if self.mask is not None and len(self.images) > 1 and not self.mask.is_dir():
            raise ValueError(f"--mask: expected a folder of masks for {len(self.images)} pictures, got {self.mask}")
        device = chosen_device(self.device)
        model = load_model(self.checkpoint, device)
        refine = refine_steps(model, self.refine)
        predict = network_predictor(model, self.threshold)
        console, failures = Console(stderr=True), []
        for path in track(self.images, "Meshes", console=console, transient=True, disable=len(self.images) == 1):
            try:
                picture, image = self._prepared(path, predict, device)
                [(vertices, faces)] = predict_meshes(model, image[None].to(device), self.threshold, refine)
            except (ValueError, OSError) as error:
                failures.append(_named(path, error))
                continue
            self._write(targets[path], picture, image, vertices, faces)
            Console().print(f"{targets[path]}", highlight=False, soft_wrap=True)
        if len(self.images) == 1 and failures:
            raise ValueError(failures[0])
        for text in failures:
            console.print(text, style="red", markup=False, highlight=False, soft_wrap=True)
        return 1 if failures else 0

    def _targets(self) -> dict[Path, Path]:
        """The mesh's file for each picture."""
        if not self.images:
            raise ValueError("images: expected at least one picture, got none")
        if self.output.suffix.lower() in _SUFFIXES:
            if len(self.images) > 1:
                count = len(self.images)
                raise ValueError(f"--output: expected a folder for {count} meshes, got {self.output.name!r}")
            return {self.images[0]: self.output}
        if self.output.suffix and not self.output.is_dir() and len(self.images) == 1:
            expected = ", ".join(_SUFFIXES)
            raise ValueError(
                f"--output: expected a name that ends in {expected}, or a folder, got {self.output.name!r}"
            )
        targets = {path: self.output / f"{path.stem}.{self.format}" for path in self.images}
        if len(set(targets.values())) < len(set(self.images)):
            raise ValueError("images: expected pictures of different names, got some whose meshes would be one file")
        return targets

    def _prepared(self, path: Path, predict: Predictor, device: torch.device) -> tuple[Tensor, Tensor]:
        """The picture [H, W, 3 or 4], and what the network gets of it."""
        picture = load_image(path, upright=True)
        mask = None
        if self.mask is not None:
            mask = _as_mask(load_image(self._mask_of(path), upright=True))
        elif picture.shape == (64, 64, 4) and float(picture[..., 3].min()) < 0.5 < float(picture[..., 3].max()):
            return picture, (picture.permute(2, 0, 1) * 255 + 0.5).to(torch.uint8)
        return picture, best_frame(predict, cut_out(picture, mask), device)

    def _mask_of(self, path: Path) -> Path:
        folder = self.mask
        if folder is None or not folder.is_dir():
            return folder or path
        for suffix in (path.suffix, *_PICTURES):
            if (folder / (path.stem + suffix)).is_file():
                return folder / (path.stem + suffix)
        raise ValueError(f"{folder}: expected a mask {path.stem}.png, got none")

    def _write(self, target: Path, picture: Tensor, image: Tensor, vertices: Tensor, faces: Tensor) -> None:
        save_mesh(target, vertices, faces)
        if self.sheet:
            save_image(_beside(target, "sheet.png"), prediction_picture(picture, image, vertices, faces))
        if self.turntable:
            upright = clay_mesh(vertices, faces, MESH_COLOR).normalize()
            frames = (photograph(upright, 145 + 360 * i / self.turntable, size=256) for i in range(self.turntable))
            save_animation(_beside(target, "turntable.gif"), frames, fps=15)


def _beside(target: Path, name: str) -> Path:
    return target.with_name(f"{target.stem}_{name}")


def _as_mask(image: Tensor) -> Tensor:
    """[H, W]: the transparency, if there is any, else the brightness."""
    transparent = image.shape[2] == 4 and float(image[..., 3].min()) < 1
    return image[..., 3] if transparent else image[..., :3].mean(2)


def _named(path: Path, error: Exception) -> str:
    """The sentence of an error, with the picture that it is about."""
    text = " ".join(str(error).split())
    return text if str(path) in text or text.startswith("--") else f"{path}: {text}"
