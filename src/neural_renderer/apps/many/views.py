"""Views of a model: a function of the model's bytes and of settings, to the bytes of files."""

from __future__ import annotations

import json
import os
import time
import warnings
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from ...camera import Camera
from ...camera.files.opencv import camera_rows
from ...io.files import short
from ...meshes.bounds import bounding_box
from ...meshes.uv_mesh import UVMesh
from ...shading.environments.light import EnvironmentLight
from ...shading.lights import CameraLight, Light
from ..common.pictures.outputs import GREY, depth_range, draw_outputs, radius_of
from ..common.values import encode_output
from .cameras import CameraPlan
from .models import ModelFile, file_checksum, opened
from .options import DatasetOptions

_AMBIENT, _DIRECTIONAL, _SUN = 0.4, 0.65, (0.35, 0.75, 0.55)  # light "sun", and its direction in the world
_PICTURES = ("png", "jpg", "webp", "npy", "exr")
_VALUES = ("npy", "exr")
FORMATS: dict[str, tuple[str, ...]] = {
    "rgba": ("png", "webp", "npy", "exr"),
    "rgb": _PICTURES,
    "alpha": ("png", "npy", "exr"),
    "depth": ("png", *_VALUES),
    "normal": ("png", *_VALUES),
    "position": _VALUES,
    "uv": _VALUES,
    "face_index": _VALUES,
    "barycentric": ("png", *_VALUES),
}
"""Outputs of views, and the suffixes of their files."""


@dataclass(frozen=True)
class ViewSettings:
    """Settings of the views of a data set, some as of `render` and `load_mesh`."""

    outputs: tuple[str, ...] = DatasetOptions.outputs  # files of each view: an output and a suffix of `FORMATS`
    size: tuple[int, int] = (512, 512)  # height and width in pixels
    cameras: CameraPlan = field(default_factory=CameraPlan)
    light: str = DatasetOptions.light  # "lamp", behind the camera; "sun", from one direction for all views; or "none"
    environment: str | None = None  # file with the surroundings, in place of this light
    shading: str = DatasetOptions.shading
    background: tuple[float, float, float] = DatasetOptions.background  # colour behind "rgb"
    layers: int | None = DatasetOptions.layers
    normalize: bool = DatasetOptions.normalize  # move the mesh to the origin, and scale its longest side to 2
    depth_scale: float = DatasetOptions.depth_scale  # steps of a 16-bit depth .png for one unit
    sample: str = DatasetOptions.sample  # a sample for each "view", or for each "model"
    allow_outside: bool = False


@dataclass(frozen=True)
class Sample:
    """Sample of a data set: ``files`` by suffix. ``view`` is None in a sample of all views of a model."""

    key: str
    view: int | None
    files: dict[str, bytes]


@dataclass(frozen=True)
class ModelViews:
    """Samples of a model, facts about it for the index, warnings about its file, and processor seconds by part."""

    samples: list[Sample]
    views: int
    facts: dict[str, Any]
    notes: tuple[str, ...]
    seconds: dict[str, float]


def check_outputs(outputs: tuple[str, ...]) -> None:
    """Raise ValueError unless the names of outputs are known, and each is there once."""
    for output in outputs:
        name, _, suffix = output.partition(".")
        if suffix not in FORMATS.get(name, ()):
            known = ", ".join(f"{key}.{'|'.join(suffixes)}" for key, suffixes in FORMATS.items())
            raise ValueError(f"outputs: expected some of {known}, got {short(output)}")
    if len(set(outputs)) != len(outputs) or not outputs:
        raise ValueError(f"outputs: expected one or more, each once, got {', '.join(outputs) or 'none'}")


@dataclass(frozen=True)
class RenderModel:
    """Draws the views of a `ModelFile`: calling it is a function of the file's content and the settings."""

    settings: ViewSettings

    @torch.no_grad()
    def __call__(self, model: ModelFile) -> ModelViews:
        """Draw and encode. OSError, ValueError: The model cannot be drawn; the message has no path of this machine."""
        clock = _Clock()
        settings = self.settings
        mesh, matrix, facts, notes = self._loaded(model)
        clock.note("loading")
        cameras, words = settings.cameras.make(model.name, radius_of(mesh.vertices), settings.size)
        rows = camera_rows(cameras, settings.size)
        names = dict.fromkeys(output.partition(".")[0] for output in settings.outputs)
        views: list[dict[str, bytes]] = []
        for number, camera in enumerate(cameras):
            images = draw_view(mesh, camera, settings, names)
            clock.note("drawing")
            files = {
                output: encode_output(
                    Path(output),
                    images[output.partition(".")[0]],
                    output.partition(".")[0],
                    settings.depth_scale,
                    fast=True,
                )
                for output in settings.outputs
            }
            rows[number] |= {"view": number, "about": words[number]}
            views.append(files)
            clock.note("encoding")
        about = {"model": model.name, **facts, "normalization": matrix}
        if settings.sample == "model":
            files = {f"{number:03d}.{name}": data for number, row in enumerate(views) for name, data in row.items()}
            samples = [Sample(model.name, None, {**files, "cameras.json": _json({**about, "cameras": rows})})]
        else:
            samples = [
                Sample(f"{model.name}_{number:03d}", number, {**row, "camera.json": _json({**about, **rows[number]})})
                for number, row in enumerate(views)
            ]
        clock.note("encoding")
        return ModelViews(samples, len(views), facts, notes, clock.seconds)

    def _loaded(self, model: ModelFile) -> tuple[UVMesh, list[list[float]], dict[str, Any], tuple[str, ...]]:
        """Load a model: the mesh, its matrix, facts, and warnings. Texts contain no paths of this machine."""
        place = Path(model.path)

        def plain(text: str) -> str:
            for path in (place, Path(model.path)):
                text = text.replace(str(path), model.name)
            for folder in (*place.parents[:-1], *place.resolve().parents[:-1]):  # of its images and materials
                text = text.replace(f"{folder}{os.sep}", "")
            return " ".join(text.split())

        try:
            with opened(model) as place, warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                mesh, matrix = load(place, self.settings)
                facts = {"model_sha256": file_checksum(place), "vertices": mesh.num_vertices, "faces": mesh.num_faces}
        except (OSError, ValueError) as error:
            raise ValueError(plain(str(error))) from None
        said = {plain(str(warning.message)) for warning in caught if issubclass(warning.category, UserWarning)}
        return mesh, matrix, facts, tuple(sorted(said))


def load(path: Path, settings: ViewSettings) -> tuple[UVMesh, list[list[float]]]:
    """Load a mesh as it is drawn; return also the matrix [4, 4] from the file's coordinates to the drawn ones."""
    mesh = UVMesh.load(path, GREY, settings.allow_outside)
    if not settings.normalize:
        return mesh, torch.eye(4).tolist()
    moved = mesh.normalize()  # checks the vertices
    center, half = bounding_box(mesh.vertices.double())
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] /= half
    matrix[:3, 3] = -center / half
    return moved, matrix.tolist()


def draw_view(mesh: UVMesh, camera: Camera, settings: ViewSettings, names: Any) -> dict[str, Any]:
    """Draw outputs of one view, by name; see `draw_outputs`."""
    try:
        near, far = depth_range(mesh, camera)
    except ValueError:  # the mesh is behind the camera: an empty picture
        near, far = 0.1, 100.0
    light: Any = None
    if settings.environment is not None:
        light = _environment(settings.environment)
    elif settings.light != "none":
        light = CameraLight() if settings.light == "lamp" else Light(_AMBIENT, _DIRECTIONAL, direction=_SUN)
    scene = {"light": light, "shading": settings.shading, "background": settings.background, "layers": settings.layers}
    return draw_outputs(mesh, camera, settings.size, names, **scene, near=near, far=far)


@lru_cache(maxsize=1)
def _environment(path: str) -> EnvironmentLight:
    return EnvironmentLight.load(path)


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content) + "\n").encode()


class _Clock:
    """Processor seconds of parts of the work."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.process_time()

    def note(self, part: str) -> None:
        """Add the time since the last note to a part."""
        now = time.process_time()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._last
        self._last = now
