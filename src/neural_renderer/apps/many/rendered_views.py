"""Data for training that is drawn when it is needed: `RenderedViews`."""

from __future__ import annotations

import os
import warnings
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import IterableDataset, get_worker_info

from ...base import validate
from ...camera import Camera
from ...meshes.uv_mesh import UVMesh, tensors_of
from ...raster.settings import image_size
from ..common.pictures.outputs import radius_of
from ..common.short_names import short_names
from .cameras import CameraPlan, generator
from .models import ModelFile, list_models, opened
from .views import FORMATS, ViewSettings, draw_view, load

_SETTINGS = ViewSettings(("rgb", "alpha"), cameras=CameraPlan("sphere", elevation=(-90.0, 90.0)))
Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


class RenderedViews(IterableDataset[dict[str, Any]]):
    """Views of many models for training, drawn when they are needed: no files, and new views in each epoch.

    It is torch's ``IterableDataset`` for ``DataLoader(views, batch_size=None, num_workers=…)``. The models are divided
    among the processes of a training (torch.distributed, if it is initialised) and the workers of each loader; each
    keeps the meshes of its share in memory. The views of a model depend on its name, the seed and the epoch only. An
    item is a dictionary:

    - each of ``outputs``: [N, C, H, W] or [N, H, W] float32 (face_index int32), as `Images` explains them; "rgba" is
      [N, 4, H, W] with colours that are not multiplied by alpha. Outputs but rgb, rgba and alpha are not anti-aliased,
      and 0 (face_index -1) where nothing is visible.
    - "camera": `Camera`, N of them.
    - "model": int64 [N], the number of the model in ``models``.

    Args:
        models: Mesh files, folders, archives of meshes (.zip, .tar, .tar.gz), or lists of paths (.txt, .csv, .parquet).
        size: Side of the images, or (height, width), in pixels.
        views: Views of a model in an item, ≥ 1.
        settings: What is drawn, and how, in a group. Keywords set single fields, too: those below.
        batch: Models in an item, ≥ 1; N is views · batch, and less in the last item of an epoch.
        shuffle: Draw the models in another order in each epoch.
        seed: Seed of the order and of the cameras.
        memory: Bytes of meshes that each worker keeps, ≥ 0.
        outputs: Some of "rgba", "rgb", "alpha", "depth", "normal", "position", "uv", "face_index", "barycentric".
        cameras: "sphere": random directions; "orbit": around the y axis; or a file of cameras, all of which are drawn.
        elevation: Least and greatest elevation of the sphere, or those of the orbits, in degrees.
        viewing_angle: Half of the vertical field of view in degrees.
        distance: Distance of the cameras from the origin; None for one at which the whole model is visible.
        normalize: Move each model to the origin and scale its longest side to 2 units.
        light: "lamp", over the viewer's shoulder; "sun", from one direction; or "none".
        shading, background, layers: As `render` takes them.
        allow_outside: Read materials and images outside the folder of a mesh, too. Use it for trusted files only.

    Attributes:
        models: Names of the models, sorted.

    Raises:
        FileNotFoundError: A path does not exist.
        TypeError, ValueError: An argument does not fit.

    Warns:
        UserWarning: A model cannot be read; it is left out.

    Example:
        >>> nr.save_mesh("models/ball.obj", *nr.icosphere(2))
        >>> nr.save_mesh("models/box.obj", *nr.cube())
        >>> views = nr.data.RenderedViews("models", size=32, views=3, batch=2)
        >>> for item in torch.utils.data.DataLoader(views, batch_size=None):
        ...     print(item["rgb"].shape, item["camera"], sorted(item["model"].tolist()))
        torch.Size([6, 3, 32, 32]) Camera(6 cameras, viewing angle 20, cpu) [0, 0, 0, 1, 1, 1]
    """

    @short_names(
        *("settings.outputs", "settings.normalize", "settings.light", "settings.shading", "settings.background"),
        *("settings.layers", "settings.allow_outside"),
        *("settings.cameras.elevation", "settings.cameras.viewing_angle", "settings.cameras.distance"),
        cameras="settings.cameras.kind",
    )
    def __init__(
        self,
        models: Paths,
        size: int | tuple[int, int] = 256,
        views: int = 4,
        *,
        settings: ViewSettings = _SETTINGS,
        batch: int = 1,
        shuffle: bool = True,
        seed: int = 0,
        memory: int = 1 << 30,
    ) -> None:
        super().__init__()
        paths = [models] if isinstance(models, (str, os.PathLike)) else models
        self._files = list_models([Path(path) for path in paths])
        self.models = tuple(file.name for file in self._files)
        for name in settings.outputs:
            if name not in FORMATS:
                raise ValueError(f"outputs: expected some of {', '.join(FORMATS)}, got {name!r}")
        if settings.light not in ("lamp", "sun", "none"):
            raise ValueError(f'light: expected "lamp", "sun" or "none", got {settings.light!r}')
        self._batch, self._shuffle = validate.whole("batch", batch, 1), shuffle
        self._seed, self._memory = validate.whole("seed", seed, 0), validate.whole("memory", memory, 0)
        cameras = replace(
            settings.cameras,
            kind=os.fspath(settings.cameras.kind),
            views=validate.whole("views", views, 1),
            elevation=tuple(map(float, settings.cameras.elevation)),
            seed=seed,
        )
        self._settings = replace(
            settings, outputs=tuple(settings.outputs), size=image_size("size", size), cameras=cameras
        )
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()  # workers that persist see changes
        self._meshes: OrderedDict[int, UVMesh] = OrderedDict()
        self._size_of_meshes = 0

    def set_epoch(self, epoch: int) -> None:
        """Choose the views and the order of an epoch. Call it before each, as of a DistributedSampler.

        Args:
            epoch: Number of the epoch, ≥ 0.

        Raises:
            TypeError, ValueError: The number is not whole, or below 0.

        Example:
            >>> nr.save_mesh("ball.obj", *nr.icosphere(2))
            >>> views = nr.data.RenderedViews("ball.obj", size=32)
            >>> views.set_epoch(3)
        """
        self._epoch.fill_(validate.whole("epoch", epoch, 0))

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Draw the models of this process's share, in batches."""
        epoch, share = int(self._epoch), self._share()
        if self._shuffle:
            share = share[generator("order", self._seed, epoch).permutation(len(share))]
        parts: list[tuple[int, Camera, dict[str, Tensor]]] = []
        for number in share[: self._even(len(share))].tolist():
            drawn = self._drawn(number, epoch)
            if drawn is not None:
                parts.append((number, *drawn))
            if len(parts) == self._batch:
                yield _joined(parts)
                parts = []
        if parts:
            yield _joined(parts)

    def _share(self) -> np.ndarray:
        """Return the numbers of the models that this process draws, the same in all epochs."""
        rank, world = _rank()
        info = get_worker_info()
        workers, worker = (1, 0) if info is None else (info.num_workers, info.id)
        return np.arange(len(self._files))[rank * workers + worker :: world * workers]

    def _even(self, count: int) -> int:
        """Return how many models of a share are drawn: equally many in all processes of a training."""
        world = _rank()[1]
        info = get_worker_info()
        return count if world == 1 else len(self._files) // (world * (1 if info is None else info.num_workers))

    @torch.no_grad()
    def _drawn(self, number: int, epoch: int) -> tuple[Camera, dict[str, Tensor]] | None:
        """Draw the views of a model; warn and return None if it cannot be read."""
        file, settings = self._files[number], self._settings
        try:
            mesh = self._mesh(number, file)
            camera, _ = settings.cameras.make(file.name, radius_of(mesh.vertices), settings.size, epoch)
            images = [draw_view(mesh, one, settings, settings.outputs) for one in camera]
        except (OSError, ValueError) as error:
            warnings.warn(f"{file.name} is left out: {error}", stacklevel=2)
            return None
        stacked = {name: torch.from_numpy(np.stack([image[name] for image in images])) for name in settings.outputs}
        return camera, {name: image.movedim(3, 1) if image.dim() == 4 else image for name, image in stacked.items()}

    def _mesh(self, number: int, file: ModelFile) -> UVMesh:
        """Load a mesh, or find it among those that are kept; forget the ones that were not used for longest."""
        if number in self._meshes:
            self._meshes.move_to_end(number)
            return self._meshes[number]
        with opened(file) as path:
            mesh, _ = load(path, self._settings)
        self._meshes[number] = mesh
        self._size_of_meshes += _bytes(mesh)
        while self._size_of_meshes > self._memory:
            self._size_of_meshes -= _bytes(self._meshes.popitem(last=False)[1])
        return mesh


def _rank() -> tuple[int, int]:
    """Return number and count of the processes of a training; workers of a loader know them by the environment."""
    distributed = torch.distributed
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    return int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))


def _joined(parts: Sequence[tuple[int, Camera, dict[str, Tensor]]]) -> dict[str, Any]:
    numbers = torch.tensor([number for number, camera, _ in parts for _ in range(len(camera))])
    images = {name: torch.cat([images[name] for *_, images in parts]) for name in parts[0][2]}
    return {**images, "camera": Camera.cat([camera for _, camera, _ in parts]), "model": numbers}


def _bytes(mesh: UVMesh) -> int:
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors_of(mesh))
