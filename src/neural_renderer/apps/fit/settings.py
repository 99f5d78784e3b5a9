"""Settings of `MeshFit`, in groups of a few, with the defaults of all fits. This module does not import torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from ...base.numbers import fraction, whole
from .weights import DetailWeights, FitWeights

DETAIL_STEPS = 200
"""Steps for details, where something shows them."""
MANY_STEPS = 260
"""The same where many views show colours, so that the last steps keep the faces, which takes less time."""
START: Literal["hull"] = "hull"
RECOVER: Literal["shape"] = "shape"
Light = Literal["fitted", "none"]
Gradient = Literal["edge", "nmr"]


@dataclass(frozen=True)
class ShapeSettings:
    """Settings of the shape phase of `MeshFit`.

    Attributes:
        steps: Number of steps, ≥ 1.
        cells: Grid cells along each axis for the visual hull, ≥ 8. None is 64, and 96 or 128 if a hull of 64 covers
            holes or gaps that several silhouettes show.
        color_from: Fraction of the steps in [0, 1] after which colours move the shape, too; see `ShapeFit`. None is 1,
            and 0.4 if cameras are refined.
        weights: Weights of the losses.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.fit import MeshFit, ShapeSettings, Views
        >>> fit = MeshFit(Views.of(mesh, camera, 32), shape=ShapeSettings(steps=50, cells=24))
    """

    steps: int = 150
    cells: int | None = None
    color_from: float | None = None
    weights: FitWeights = field(default_factory=FitWeights)

    def __post_init__(self) -> None:
        whole("steps", self.steps, 1)
        if self.cells is not None:
            whole("cells", self.cells, 8)
        if self.color_from is not None:
            fraction("color_from", self.color_from)


@dataclass(frozen=True)
class DetailSettings:
    """Settings of the detail phase of `MeshFit`, which is a `DetailFit`.

    Attributes:
        steps: Number of steps, ≥ 0. Needs normals, depth or ``light``. None: 200 if there is one, else 0; and 260 for
            colours of more than 24 views with known masks.
        light: "fitted" or "none": details follow the colours of the photos, too; see `DetailFit`. None: they do not.
        weights: Weights of the losses.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.fit import DetailSettings, MeshFit, Views
        >>> fit = MeshFit(Views.of(mesh, camera, 32), cells=24, detail=DetailSettings(light="fitted"))
    """

    steps: int | None = None
    light: Light | None = None
    weights: DetailWeights = field(default_factory=DetailWeights)

    def __post_init__(self) -> None:
        if self.steps is not None:
            whole("steps", self.steps, 0)


@dataclass(frozen=True)
class TextureSettings:
    """Settings of the texture phase of `MeshFit`, which is a `TextureFit`.

    Attributes:
        steps: Number of steps, ≥ 1.
        size: T, texels along the edge of a face's texture cube, ≥ 3.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.fit import MeshFit, TextureSettings, Views
        >>> fit = MeshFit(Views.of(mesh, camera, 32), cells=24, texture=TextureSettings(size=6))
    """

    steps: int = 20
    size: int = 4

    def __post_init__(self) -> None:
        whole("steps", self.steps, 1)
        whole("size", self.size, 3)


@dataclass(frozen=True)
class CameraSettings:
    """Settings of `MeshFit` for cameras that are not exact.

    Attributes:
        refine: Whether to fit the poses of the cameras and their focal length, too: before the shape, and together
            with it. Not with ``recover="texture"``.
        steps: Steps before those for the shape, ≥ 1, for up to 24 views; more views take more.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.fit import CameraSettings, MeshFit, Views
        >>> fit = MeshFit(Views.of(mesh, camera, 32), cells=24, cameras=CameraSettings(refine=True))
    """

    refine: bool = False
    steps: int = 150

    def __post_init__(self) -> None:
        whole("steps", self.steps, 1)


@dataclass(frozen=True)
class DescentSettings:
    """Settings of gradient descent on images.

    Attributes:
        batch: Views per step, ≥ 1.
        gradient: Gradient estimator of the renderer, "edge" or "nmr".
        seed: Seed of the order of the views.

    Raises:
        TypeError, ValueError: A value is out of range.

    Example:
        >>> from neural_renderer.apps.fit import DescentSettings, MeshFit, Views
        >>> fit = MeshFit(Views.of(mesh, camera, 32), cells=24, descent=DescentSettings(batch=1))
    """

    batch: int = 6
    gradient: Gradient = "edge"
    seed: int = 0

    def __post_init__(self) -> None:
        whole("batch", self.batch, 1)
