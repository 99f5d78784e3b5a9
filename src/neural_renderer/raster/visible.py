"""From visible faces to images, for every shading model."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

import torch
from torch import Tensor

from ..base.one_line import OneLine
from .colors.downsample import halve, whole
from .colors.interpolate import interpolate
from .colors.texture_cubes import CornerColors
from .depth_limits import background_depth
from .ops.barycentrics import barycentrics
from .ops.coverage import silhouette
from .ops.half_edges import HalfEdges
from .outputs import Images
from .settings import Settings
from .warp.elementwise import FEW, apart, are_for_numpy, joined, views
from .warp.registration import is_plain, needs_gradient

Faces = TypeVar("Faces", bound="VisibleFaces")

_MOST_USES = 8  # operators whose gradients to corners are summed without torch's threads


@dataclass(frozen=True, eq=False, repr=False)
class VisibleFaces(OneLine):
    """The visible face of each pixel of B images. Under anti-aliasing, H and W are twice the returned size.

    Attributes:
        corners: Screen-space corners of the faces, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32; -1 for none. Row 0 is at the top.
        settings: How the faces were drawn.
        half_edges: Half-edges of the faces, as from `Settings.half_edges`.
    """

    corners: Tensor
    face_index: Tensor
    settings: Settings
    half_edges: HalfEdges | None
    _located: tuple[Tensor, Tensor] | None = field(default=None, init=False, repr=False)
    _uses: Iterator[Tensor] | None = field(default=None, init=False, repr=False)

    @property
    def mask(self) -> Tensor:
        """Whether a face is visible, [B, H, W] bool."""
        return self.face_index >= 0

    @property
    def weights(self) -> Tensor:
        """Perspective-correct barycentric weights of the visible point, [B, H, W, 3]; their sum is 1."""
        return self._points[0]

    @property
    def depth(self) -> Tensor:
        """Depth along the viewing axis in world units, [B, H, W]; that of the background where no face is visible."""
        return self._points[1]

    def next_corners(self) -> Tensor:
        """Return the corners for the next operator that reads them; torch's threads do not sum their gradients then."""
        if self.corners.numel() <= FEW or not torch.is_grad_enabled() or torch.compiler.is_compiling():
            return self.corners
        uses = self._uses
        if uses is None:
            uses = iter(apart(self.corners, _MOST_USES))
            object.__setattr__(self, "_uses", uses)  # the class is frozen
        return next(uses, self.corners)

    @property
    def _points(self) -> tuple[Tensor, Tensor]:
        # Cached, unless they were computed under no_grad and may later be needed with gradients.
        points = self._located
        if points is None:
            points = self._locate()
            if torch.is_grad_enabled() or not (self.corners.requires_grad or torch.is_inference_mode_enabled()):
                object.__setattr__(self, "_located", points)  # the class is frozen
        return points

    def _locate(self) -> tuple[Tensor, Tensor]:
        settings = self.settings
        scene, far = (self.next_corners(), self.face_index), settings.far
        behind = background_depth(self.corners) if settings.is_open else None
        if behind is not None and len(behind) and are_for_numpy(self.corners):
            first = float(behind[0])
            if bool((behind == first).all()):  # the operator writes it, which saves a pass
                far, behind = first, None
        weights, depth = barycentrics(*scene, settings.near, far, settings.perspective, *settings.drawn_strip)
        if behind is not None:
            depth = torch.where(self.mask, depth, behind[:, None, None].expand(depth.shape))
        return weights, depth

    def at_pixels(self, attributes: Tensor) -> Tensor:
        """Interpolate attributes of corners, [1 or B, F, 3, C] float32, at each pixel, [B, H, W, C]."""
        settings = self.settings
        scene = (self.next_corners(), self.face_index, settings.perspective)
        return interpolate(attributes, *scene, *settings.drawn_strip)

    @property
    def for_shading(self: Faces) -> Faces:
        """The same faces, without a gradient to corners if the estimator has none inside faces."""
        return self if self.settings.gradient.differentiates_inside else replace(self, corners=self.corners.detach())

    @property
    def in_blocks(self) -> bool:
        """Whether `image` takes an image in blocks, as from the function `in_blocks`."""
        settings = self.settings
        wanted = settings.anti_aliasing and settings.gradient.takes_blocks
        return wanted and needs_gradient(self.corners) and is_plain((self.corners,))

    def image(
        self,
        layers: Tensor | None,
        *,
        seams: bool = False,
        edge_hashes: Callable[[], Tensor] | None = None,
        corner_values: Tensor | None = None,
    ) -> Tensor:
        """Attach the gradient through visibility to an image, and average it; see `Settings.through_visibility`."""
        return self.settings.through_visibility(
            layers, self.next_corners(), self.face_index, seams, edge_hashes, self.half_edges, corner_values
        )

    def images(
        self,
        outputs: Collection[str],
        rgb: Tensor | None = None,
        edge_hashes: Callable[[], Tensor] | None = None,
        corner_colors: CornerColors | None = None,
    ) -> Images:
        """Make the requested images, of "rgb", "alpha" and "depth".

        ``rgb`` are colours with their background, [B, 3, H, W] float32; ``edge_hashes`` as in
        `Settings.through_visibility`, or None where colours do not jump between adjacent faces. ``corner_colors`` are
        the colours that faces interpolate, if they do.
        """
        layers = {} if rgb is None else {"rgb": rgb}
        through = "depth" in outputs and self.settings.gradient.differentiates_inside
        is_silhouette = rgb is None and not through
        if "alpha" in outputs and is_silhouette:
            layers["alpha"] = self.image(None)
        elif "alpha" in outputs:
            layers["alpha"] = silhouette(self.face_index)
        depth = self._locate()[1] if "depth" in outputs else None
        if depth is not None and through:
            layers["depth"] = depth[:, None]
        if layers and not is_silhouette and not needs_gradient(self.corners):
            layers = {name: self.image(layer) for name, layer in layers.items()}
        elif layers and not is_silhouette:
            image = next(iter(layers.values()))
            image = image if len(layers) == 1 else joined([whole(each) for each in layers.values()], 1)
            known = self._corner_values(list(layers), corner_colors)
            image = self.image(image, seams=edge_hashes is not None, edge_hashes=edge_hashes, corner_values=known)
            layers = _split(image, layers)
        if depth is not None and not through:
            layers["depth"] = self._average_depth(depth)[:, None]
        flat = {name: layers[name].squeeze(1) for name in ("alpha", "depth") if name in layers}
        return Images(rgb=layers.get("rgb"), **flat)

    def _corner_values(self, layers: list[str], colors: CornerColors | None) -> Tensor | None:
        """Return what faces interpolate in the last layers, at their corners, [1 or B, F, 3, K]; None for nothing."""
        if not self.settings.gradient.reads_corner_values:
            return None
        corners, known = self.corners.detach(), []
        if "rgb" in layers and colors is not None:
            known.append(colors(corners, self.settings.perspective))
            if "alpha" in layers:
                known.append(known[0].new_ones(()).expand(*known[0].shape[:3], 1))
        if "depth" in layers:
            known.append(corners[..., 2:])
        if len(known) < 2:
            return known[0] if known else None
        batch = max(map(len, known))
        return joined([each.expand(batch, -1, -1, -1) for each in known], 3)

    def _average_depth(self, depth: Tensor) -> Tensor:
        if self.settings.anti_aliasing:
            return halve(depth[:, None]).squeeze(1)  # whose gradient is a view
        # Backward needs the original values, and callers may change theirs in place.
        return joined((depth,), 0) if depth.requires_grad else depth


def _split(image: Tensor, layers: dict[str, Tensor]) -> dict[str, Tensor]:
    """Cut an image into layers of the given numbers of channels."""
    if len(layers) == 1:  # the gradient of a slice is a larger tensor, filled and copied
        return dict.fromkeys(layers, image)
    # Copies: autograd forbids in-place changes of one of several views.
    parts = views(image, [layer.shape[1] for layer in layers.values()], 1)
    return {name: joined((part,), 1) for name, part in zip(layers, parts, strict=True)}
