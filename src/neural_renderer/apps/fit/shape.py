"""`ShapeFit`: gradient descent on vertices, and optionally cameras, for silhouettes and optionally colours."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...io.cubes import bake_corners
from ...meshes.subdivision import split_faces
from ...meshes.topology import Topology
from ...optim import losses
from ..common.adjustable import Adjustable
from ..common.short_names import short_names
from ..common.views.views import Views, mask_iou, photos_of, views_of_step
from .cameras import COARSE_RATE, CameraRefinement
from .descent import SmoothDescent
from .detail.pyramid import coarse
from .hull import carve
from .settings import DescentSettings, ShapeSettings
from .weights import FitWeights

_REGULARIZERS = {"laplacian": 2, "normal_consistency": 1}
"""Loss on the mesh → power of the number of vertices that makes its value independent of the resolution.

The distance of a vertex from the mean of its neighbours is proportional to V^(-1) in a mesh with V vertices.
"""
_TYPICAL_VERTICES = 10_000  # vertices of the mesh for which the default weights are chosen
_COLOR_RATE, _COLOR_SMOOTH = 0.1, 1.0  # step and λ of the descent on colours
_COARSE_CELLS = 40  # cells of the hull's grid along each axis
_SMALLER = 4  # growth of the batch: images have at most a quarter of the pixels
_MISSED = 1 / 8  # fraction of the masks that may miss a point of the visual hull
_COARSE_LAPLACIAN = 30.0  # weight: the shape has to follow the cameras
_COARSE_RATE = 0.02  # step of vertices


class ShapeFit(Adjustable):
    """Fit the vertices of a mesh to posed images by gradient descent. Call `advance` until ``done``.

    Args:
        views: Views that are `Views.normalized`, so that the object lies in about [-1, 1]³.
        vertices: [V, 3] float32, initial positions.
        faces: [F, 3], whole numbers of any real dtype.
        steps: Number of steps, ≥ 1.
        subdivisions: Number of times each face is split into four, evenly over the steps (coarse to fine). 0 for a
            mesh that is fine already.
        color_from: Fraction of the steps in [0, 1] after which vertices get colours. These are fitted to the photos
            together with the shape. 1 means never. Ignored for views without photos.
        weights: Weights of the losses.
        rate: Distance that the fastest vertex moves in a step.
        smooth: λ of `SmoothDescent`.
        descent: Settings of gradient descent; short: ``batch``, ``gradient``, ``seed``.
        cameras: The cameras of the views, which then move together with the vertices; None keeps them.
        camera_rate: Length of a step of a camera, in radians and relative to its distance.

    Raises:
        TypeError, ValueError: An argument does not fit.

    Example:
        >>> from neural_renderer.apps.fit import ShapeFit, Views
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> fit = ShapeFit(views, *nr.icosphere(2, radius=0.5), steps=2)
        >>> torch.save(fit.state_dict(), "start.pt")
        >>> while not fit.done:
        ...     numbers = fit.advance()
        ...     fit.adjust("laplacian", 50.0)
        >>> vertices, faces = fit.shape
        >>> [knob.name for knob in fit.knobs()][:2]
        ['rate', 'silhouette']
        >>> fit.load_state_dict(torch.load("start.pt"))  # back to the start
    """

    _vertices: Tensor
    _faces: Tensor
    _colors: Tensor | None
    _topology: Topology
    _descent: SmoothDescent
    _color_descent: SmoothDescent

    @short_names("descent.batch", "descent.gradient", "descent.seed")
    def __init__(
        self,
        views: Views,
        vertices: Tensor,
        faces: Tensor,
        *,
        steps: int = ShapeSettings.steps,
        subdivisions: int = 0,
        color_from: float = 1.0,
        weights: FitWeights = FitWeights(),  # noqa: B008 (immutable)
        rate: float = 0.01,
        smooth: float = 8.0,
        descent: DescentSettings = DescentSettings(),  # noqa: B008 (immutable)
        cameras: CameraRefinement | None = None,
        camera_rate: float = 0.005,
    ) -> None:
        self.steps = validate.whole("steps", steps, 1)
        self.step = 0
        self._views, self._weights, self._gradient = views, weights, descent.gradient
        self._rate, self._smooth = validate.positive("rate", rate), smooth
        self._batch, self._seed = min(descent.batch, len(views)), descent.seed
        self._subdivisions, self._subdivided = validate.whole("subdivisions", subdivisions, 0), 0
        color_from = validate.fraction("color_from", color_from)
        self._cameras, self._camera_rate = cameras, validate.positive("camera_rate", camera_rate)
        self._color_from = self.steps if views.photos is None else round(color_from * self.steps)
        self._set_shape(vertices.detach().clone(), faces.long(), None)

    @property
    def shape(self) -> tuple[Tensor, ...]:
        """Current vertices, faces and, if vertices have colours, textures, in the form of `render`."""
        if self._colors is None:
            return self._vertices, self._faces
        return self._vertices, self._faces, bake_corners(self._colors[self._faces], 2).clamp(0, 1)

    def advance(self) -> dict[str, float]:
        """Take one step.

        Returns:
            "loss" and "iou", the mean silhouette IoU of the views of the step, both before it.
        """
        while self._subdivided < min(self._subdivisions, self.step * (self._subdivisions + 1) // self.steps):
            self._subdivide()
        if self.step == self._color_from and self._colors is None:
            self._set_shape(self._vertices, self._faces, torch.full_like(self._vertices, 0.5))
        rows = views_of_step(len(self._views), self._batch, self._seed, self.step)
        # Without colours only masks are copied.
        known = self._views if self._colors is not None else self._views.silhouettes()
        views = known[rows]
        parameters = [self._vertices.requires_grad_()]
        if self._colors is not None:
            parameters.append(self._colors.requires_grad_())
        if self._cameras is None:
            loss, iou = self._loss(views, *parameters)
        else:
            loss, iou = self._loss(self._cameras.place(views, rows), *parameters)
            loss = loss + self._cameras.prior()
            parameters += self._cameras.parameters
        gradients = torch.autograd.grad(loss, parameters)
        decay = min(1.0, 2 * (1 - self.step / self.steps))  # constant in the first half, then linear
        self._vertices = self._descent.step(self._vertices.detach(), gradients[0], self._rate * decay)
        if self._colors is not None:
            self._colors = self._color_descent.step(self._colors.detach(), gradients[1], _COLOR_RATE * decay)
        if self._cameras is not None:
            self._cameras.step(gradients[-2:], rows, self._camera_rate * decay)
        self.step += 1
        return {"loss": loss.item(), "iou": iou.item()}

    def _loss(self, views: Views, vertices: Tensor, colors: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Compute the loss and the mean silhouette IoU."""
        shape: tuple[Tensor, ...] = vertices, self._faces
        if colors is not None:
            shape = (*shape, bake_corners(colors[self._faces], 2))
        images = views.draw(shape, "alpha" if colors is None else ("rgb", "alpha"), self._gradient)
        weights = self._weights
        loss = weights.silhouette * losses.silhouette_iou_loss(images.alpha, views.masks)
        if colors is not None:
            loss = loss + weights.photometric * losses.photometric(images.rgb, photos_of(views), views.masks)
        for name, exponent in _REGULARIZERS.items():
            if getattr(weights, name):
                scale = (len(vertices) / _TYPICAL_VERTICES) ** exponent
                loss = loss + scale * getattr(weights, name) * getattr(losses, name)(vertices, self._topology)
        return loss, mask_iou(images.alpha, views.masks).mean()

    def _set_shape(self, vertices: Tensor, faces: Tensor, colors: Tensor | None) -> None:
        """Replace the mesh, and start new descents."""
        self._vertices, self._faces, self._colors = vertices, faces, colors
        self._topology = Topology.of(faces)
        self._descent = SmoothDescent(self._topology, self._smooth)
        self._color_descent = SmoothDescent(self._topology, _COLOR_SMOOTH)

    def _subdivide(self) -> None:
        """Split each face into four at the midpoints of its edges."""
        edges, faces = split_faces(self._faces, len(self._vertices))
        vertices = torch.cat((self._vertices, self._vertices[edges].mean(1)))
        colors = None if self._colors is None else torch.cat((self._colors, self._colors[edges].mean(1)))
        self._set_shape(vertices, faces, colors)
        self._subdivided += 1

    def state_dict(self) -> dict[str, Any]:
        return {
            "step": self.step,
            "subdivided": self._subdivided,
            "vertices": self._vertices.detach(),
            "faces": self._faces,
            "colors": None if self._colors is None else self._colors.detach(),
            "descent": self._descent.state_dict(),
            "color_descent": self._color_descent.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.step, self._subdivided = state["step"], state["subdivided"]
        self._set_shape(state["vertices"], state["faces"], state["colors"])
        self._descent.load_state_dict(state["descent"])
        self._color_descent.load_state_dict(state["color_descent"])


def coarse_misses(views: Views) -> int:
    """Choose how many masks may miss a point of the visual hull."""
    return math.floor(_MISSED * len(views))


def coarse_hull(views: Views) -> tuple[Tensor, Tensor]:
    """Carve a coarse hull: the points inside most of the masks."""
    return carve(views, _COARSE_CELLS, coarse_misses(views))


def coarse_fit(
    views: Views,
    vertices: Tensor,
    faces: Tensor,
    cameras: CameraRefinement,
    steps: int,
    descent: DescentSettings,
) -> ShapeFit:
    """Make the fit of a coarse shape, from vertices [V, 3] and faces [F, 3], and of the cameras to small silhouettes.

    The views are `Views.normalized`. ``steps`` is the number of steps if a step shows all views; more views take more.
    The batch of ``descent`` is that of images of full size.
    """
    small, batch = coarse(views), _SMALLER * descent.batch
    return ShapeFit(
        small,
        vertices,
        faces,
        steps=steps * math.ceil(len(views) / batch),
        weights=FitWeights(laplacian=_COARSE_LAPLACIAN),
        rate=_COARSE_RATE,
        descent=replace(descent, batch=batch),
        cameras=cameras,
        camera_rate=COARSE_RATE,
    )
