"""What a fit is given: cameras, and what each of them sees of the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ... import metrics, validate
from ...camera import Camera
from ...meshes.mesh import Mesh
from ...raster import Images
from ...rendering import render
from ..seeds import generator


@dataclass(frozen=True, eq=False)
class Views:
    """N cameras, the object's silhouette in each, and its colours where they are known.

    Attributes:
        camera: N cameras.
        masks: [N, H, W] float32 in [0, 1]: 1 where the object covers a pixel.
        photos: [N, 3, H, W] float32 in [0, 1], on black (colours times mask); or None.

    Raises:
        TypeError, ValueError: shapes that do not belong together; no views; a mask without any object.
    """

    camera: Camera
    masks: Tensor
    photos: Tensor | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise TypeError(f"camera: expected a Camera, got {type(self.camera).__name__}")
        if not len(self.camera):
            raise ValueError("camera: expected at least one view, got none")
        validate.floating("masks", self.masks, (len(self.camera), "H", "W"))
        if self.photos is not None:
            validate.floating("photos", self.photos, (len(self.camera), 3, *self.size))
        empty = torch.nonzero(self.masks.amax((1, 2)) <= 0.5).flatten().tolist()
        if empty:
            raise ValueError(f"masks: expected an object in every view, got an empty mask in view {empty[0]}")

    def __len__(self) -> int:
        return len(self.camera)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.masks.shape[1], self.masks.shape[2]

    @classmethod
    def of(cls, mesh: Mesh, camera: Camera, size: int | tuple[int, int] = 256, **options: Any) -> Views:
        """What ``camera`` sees of a known mesh, drawn without light unless ``options`` of `render` say otherwise."""
        with torch.no_grad():
            images = render(mesh, camera, size, outputs=("rgb", "alpha"), **{"light": None, **options})
        return cls(camera, images.alpha, images.rgb)  # type: ignore[arg-type]

    def __getitem__(self, index: Sequence[int] | slice) -> Views:
        """Some of the views."""
        rows = torch.arange(len(self))[index].to(self.masks.device)
        return Views(_rows(self.camera, rows), self.masks[rows], None if self.photos is None else self.photos[rows])

    def to(self, device: torch.device | str) -> Views:
        """The same views on another device."""
        photos = None if self.photos is None else self.photos.to(device)
        return Views(self.camera.to(device), self.masks.to(device), photos)

    def moved(self, centre: Tensor, scale: float) -> Views:
        """The same images of a world whose point ``centre`` [3] is the origin and whose unit is ``scale`` of ours."""
        camera = self.camera
        origin = camera.origin - centre.to(camera.origin)
        if camera.K is not None:  # there the origin is the world's
            turned = torch.einsum("bij,j->bi", camera.rotation, centre.to(camera.translation))
            origin, translation = torch.zeros_like(origin), camera.translation + turned
        else:
            translation = camera.translation
        lens: dict[str, Any] = {} if camera.perspective else {"scale": camera.scale * scale}
        return replace(self, camera=replace(camera, origin=origin / scale, translation=translation / scale, **lens))

    def eyes(self) -> tuple[Tensor, Tensor]:
        """Where the cameras stand and the unit directions in which they look, [N, 3] each."""
        rotation = self.camera.rotation
        eye = self.camera.origin - torch.einsum("bij,bi->bj", rotation, self.camera.translation)
        return eye, rotation[:, 2]

    def draw(self, shape: tuple[Tensor, ...], outputs: str | Sequence[str] = "alpha", gradient: str = "edge") -> Images:
        """A mesh's images in these views, without light: its colours include whatever light there was."""
        # Everything of a world in which objects have a size of about one; cameras may be far from them.
        far = 4.0 * float(self.eyes()[0].norm(dim=1).max()) + 4.0
        return render(shape, self.camera, self.size, light=None, outputs=outputs, near=1e-2, far=far, gradient=gradient)

    def quality(self, shape: tuple[Tensor, ...]) -> dict[str, Tensor]:
        """``iou`` [N] of a mesh's silhouettes and, if both have colours, ``psnr`` [N] of its images in decibels.

        The PSNR is that of the whole image on black, as for the data sets of NeRF.
        """
        coloured = self.photos is not None and len(shape) == 3
        found: dict[str, list[Tensor]] = {"iou": [], "psnr": []} if coloured else {"iou": []}
        with torch.no_grad():
            for start in range(0, len(self), 8):
                part = self[start : start + 8]
                images = part.draw(shape, ("rgb", "alpha") if coloured else "alpha")
                found["iou"].append(agreement(images.alpha, part.masks))  # type: ignore[arg-type]
                if coloured:
                    error = (images.rgb.clamp(0, 1) - part.photos).square().mean((1, 2, 3))  # type: ignore[union-attr, operator]
                    found["psnr"].append(-10 * error.clamp(min=1e-10).log10())
        return {name: torch.cat(values) for name, values in found.items()}


def agreement(alpha: Tensor, masks: Tensor) -> Tensor:
    """The intersection over union [B] of silhouettes, where masks may come from files."""
    # Pixels that are half covered are many, 2 of 4 samples; eight bits make 0.502 of 0.5, which must stay equal to it.
    return metrics.silhouette_iou(alpha.detach(), masks, threshold=0.49)


def chosen(count: int, batch: int, seed: int, step: int) -> list[int]:
    """Which of ``count`` views a step looks at: all in turn, in an order that is shuffled for each round."""
    rows: list[int] = []
    for place in range(step * batch, (step + 1) * batch):
        rows.append(int(torch.randperm(count, generator=generator(seed, place // count))[place % count]))
    return sorted(set(rows))


def smaller(image: Tensor, size: int) -> Tensor:
    """[C, H, W] with a longer side of at most ``size``; each pixel is the mean of those it covers."""
    height, width = image.shape[1:]
    if max(height, width) <= size:
        return image
    scale = size / max(height, width)
    return F.interpolate(image[None], (max(round(height * scale), 1), max(round(width * scale), 1)), mode="area")[0]


def _rows(camera: Camera, rows: Tensor) -> Camera:
    tensors = {f.name: v for f in fields(camera) if isinstance(v := getattr(camera, f.name), Tensor) and v.ndim}
    chosen: dict[str, Any] = {name: v[rows] if len(v) == len(camera) else v for name, v in tensors.items()}
    return replace(camera, **chosen)
