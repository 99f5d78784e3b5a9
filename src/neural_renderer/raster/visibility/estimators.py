"""Estimators of the gradient through visibility, by the names that users give them.

An estimator is an operation on an image: the forward pass returns the image unchanged, the backward pass adds the
gradient through visibility, so that it works with any shading. To add one, derive a class from `Estimator`, and add it
to `ESTIMATORS` or pass an instance as ``gradient=``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..colors.edge_hashes import CubeEdges, texture_edge_hashes
from ..ops.coverage import silhouette
from ..ops.half_edges import HalfEdges
from ..ops.neighbors import neighbors
from ..warp.layout import in_any_order
from .edge import EdgeOptions, edge_gradient
from .intersections import add_intersections
from .nmr import nmr_gradient
from .opendr import opendr_gradient


@dataclass(frozen=True)
class DrawnFaces:
    """Data that an estimator may need besides the image."""

    corners: Tensor  # screen-space corners, [B, F, 3, 3] float32
    face_index: Tensor  # visible face of each pixel, [B, H, W] int32, as from `coverage`
    half_edges: HalfEdges | None  # None without vertex indices
    eps: float  # added to distances, in screen units
    two_sided: bool  # faces whose corners run clockwise on the screen are drawn
    perspective: bool  # else orthographic
    halved: bool  # blocks of 2 x 2 pixels are averaged (anti-aliasing)
    strip: tuple[int, int] = (0, 0)  # rows of the whole image below and above, if a strip of it is drawn
    corner_values: Tensor | None = None  # what faces interpolate in the last K channels, [1 or B, F, 3, K] float32


class Estimator:
    """Base class of estimators; two of one class with equal attributes are equal.

    Attributes:
        differentiates_inside: Whether depth and shading inside faces have derivatives with respect to the faces.
        needs_half_edges: Whether the gradient uses the `HalfEdges` of a mesh.
        is_local: Whether the gradient at a pixel depends only on neighbouring pixels, so that strips of an image have
            the gradients of the whole image.
        takes_blocks: Whether the image may be one in blocks, as from `in_blocks`.
        reads_corner_values: Whether `attach` reads `DrawnFaces.corner_values`.
        joins_layers: Whether `attach_layers` adds the gradient of a picture of several layers; otherwise `attach` adds
            that of each layer.

    Example:
        >>> from neural_renderer.raster.colors.downsample import averaged
        >>> class NoGradient(Estimator):
        ...     def attach(self, image, drawn, seams=False, edge_hashes=None):
        ...         return averaged(image, drawn.face_index, drawn.halved)
        >>> corners = nr.vertices_to_faces(*[part[None] for part in nr.icosphere(1)]) + torch.tensor([0.0, 0.0, 3.0])
        >>> nr.rasterize_images(corners, 32, outputs="alpha", gradient=NoGradient()).alpha.shape
        torch.Size([1, 32, 32])
    """

    differentiates_inside = False
    needs_half_edges = False
    is_local = False
    takes_blocks = False
    reads_corner_values = False
    joins_layers = False

    def attach(
        self,
        image: Tensor | None,
        drawn: DrawnFaces,
        seams: bool = False,
        edge_hashes: Callable[[], Tensor] | None = None,
    ) -> Tensor:
        """Return the image, averaged for anti-aliasing, with the gradient through visibility.

        Args:
            image: Image with its background, before anti-aliasing, [B, C, H, W] float32; None for the silhouette.
            drawn: The faces.
            seams: Whether colours may jump between adjacent faces; see `edge_gradient`.
            edge_hashes: Function that returns hashes of the colours along edges, [1 or B, F, 3, 2] int64.

        Returns:
            [B, C, H, W] float32, or [B, C, H / 2, W / 2] if ``drawn.halved``.
        """
        raise NotImplementedError(f"{type(self).__name__}: expected a method attach")

    def attach_layers(
        self,
        image: Tensor,
        pictures: Tensor,
        shown: list[Tensor],
        drawn: DrawnFaces,
        seams: bool,
        edge_hashes: Callable[[], Tensor] | None,
    ) -> Tensor:
        """Return a picture of several layers, averaged for anti-aliasing, with the gradient through their visibility.

        Args:
            image: Picture with its background, before anti-aliasing, [B, C, H, W] float32.
            pictures: Contribution of each layer and those behind it, [K, B, C, H, W] float32; without a gradient.
            shown: Visible face of each pixel of each layer, K of [B, H, W] int32.
            drawn: The faces, with the first layer's ``face_index``.
            seams, edge_hashes: As in `attach`.

        Returns:
            As `attach`.
        """
        raise NotImplementedError(
            f"{type(self).__name__}: expected a method attach_layers, or joins_layers to be False"
        )

    def needs_mask(self, device: torch.device) -> bool:
        """Test whether backward reads the mask of visible faces, which `coverage` then writes."""
        return True

    def operators(self, silhouettes: bool, cubes: bool) -> tuple[Callable[..., Any], ...]:
        """List the operators whose kernels `attach` needs, to compile them together.

        Args:
            silhouettes: Whether only silhouettes are drawn.
            cubes: Whether colours come from texture cubes.
        """
        return ()

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash(type(self))

    def __repr__(self) -> str:
        return next((repr(name) for name, each in ESTIMATORS.items() if each == self), type(self).__name__)


class PaperGradient(Estimator):
    """The paper's approximate gradient, `nmr_gradient`."""

    def attach(
        self,
        image: Tensor | None,
        drawn: DrawnFaces,
        seams: bool = False,
        edge_hashes: Callable[[], Tensor] | None = None,
    ) -> Tensor:
        """See `Estimator.attach`."""
        corners = drawn.corners
        if not drawn.perspective:  # an orthographic camera has no plane that corners can lie behind
            corners = torch.cat((corners[..., :2], torch.ones_like(corners[..., 2:])), -1)
        return nmr_gradient(image, corners, drawn.face_index, drawn.eps, drawn.two_sided, drawn.halved)

    def needs_mask(self, device: torch.device) -> bool:
        """See `Estimator.needs_mask`."""
        return not in_any_order(device)

    def operators(self, silhouettes: bool, cubes: bool) -> tuple[Callable[..., Any], ...]:
        """See `Estimator.operators`."""
        return (nmr_gradient,)


class Derivative(Estimator):
    """The derivative of the image averaged over sub-pixel shifts, `edge_gradient`."""

    differentiates_inside = True
    needs_half_edges = True
    is_local = True
    takes_blocks = True
    reads_corner_values = True
    joins_layers = True

    def attach(
        self,
        image: Tensor | None,
        drawn: DrawnFaces,
        seams: bool = False,
        edge_hashes: Callable[[], Tensor] | None = None,
    ) -> Tensor:
        """See `Estimator.attach`."""
        if isinstance(edge_hashes, CubeEdges) and not in_any_order(drawn.corners.device):
            # The one task of a face compares the few edges that it needs.
            cubes = (edge_hashes.textures, edge_hashes.light, edge_hashes.firsts)
            return _edge_gradient(image, drawn, drawn.face_index, seams, None, cubes)
        hashes = edge_hashes() if edge_hashes is not None and seams else None
        return _edge_gradient(image, drawn, drawn.face_index, seams, hashes)

    def attach_layers(
        self,
        image: Tensor,
        pictures: Tensor,
        shown: list[Tensor],
        drawn: DrawnFaces,
        seams: bool,
        edge_hashes: Callable[[], Tensor] | None,
    ) -> Tensor:
        """See `Estimator.attach_layers`."""
        hashes = edge_hashes() if edge_hashes is not None and seams else None
        return _edge_gradient(image, drawn, torch.stack(shown), seams, hashes, pictures=pictures)

    def operators(self, silhouettes: bool, cubes: bool) -> tuple[Callable[..., Any], ...]:
        """See `Estimator.operators`."""
        needed: tuple[Callable[..., Any], ...] = (edge_gradient, neighbors)
        if not silhouettes:  # they do not show intersections
            needed += (add_intersections,)
        return (*needed, texture_edge_hashes) if cubes else needed


def _edge_gradient(
    image: Tensor | None,
    drawn: DrawnFaces,
    face_index: Tensor,
    seams: bool,
    edge_hashes: Tensor | None,
    cubes: tuple[Tensor | None, Tensor | None, Tensor | None] = (None, None, None),
    pictures: Tensor | None = None,
) -> Tensor:
    siblings, boundary = (
        (None, -1) if drawn.half_edges is None else (drawn.half_edges.siblings, drawn.half_edges.boundary)
    )
    options = EdgeOptions(drawn.two_sided, drawn.perspective, seams, drawn.halved, boundary, *drawn.strip)
    known = drawn.corner_values
    return edge_gradient(image, drawn.corners, face_index, options, edge_hashes, siblings, *cubes, pictures, known)


class OpenDR(Estimator):
    """OpenDR's gradient, `opendr_gradient`."""

    def attach(
        self,
        image: Tensor | None,
        drawn: DrawnFaces,
        seams: bool = False,
        edge_hashes: Callable[[], Tensor] | None = None,
    ) -> Tensor:
        image = silhouette(drawn.face_index) if image is None else image
        return opendr_gradient(image, drawn.corners, drawn.face_index, drawn.perspective, drawn.halved)

    def needs_mask(self, device: torch.device) -> bool:
        return False


ESTIMATORS: dict[str, Estimator] = {"nmr": PaperGradient(), "edge": Derivative(), "opendr": OpenDR()}


def estimator(gradient: Any) -> Estimator:
    """Find an estimator by its name; an `Estimator` is returned as it is.

    Raises:
        ValueError: An unknown name.
    """
    if isinstance(gradient, Estimator):
        return gradient
    if not isinstance(gradient, str) or gradient not in ESTIMATORS:
        hint = "; the score-function estimate needs a loss: call reinforce" if str(gradient) == "reinforce" else ""
        if isinstance(gradient, type) and issubclass(gradient, Estimator):
            hint = "; an instance is needed, not the class"
        raise ValueError(f"gradient: expected one of {', '.join(ESTIMATORS)}, got {gradient!r}{hint}")
    return ESTIMATORS[gradient]
