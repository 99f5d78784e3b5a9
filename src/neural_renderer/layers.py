"""Layers of faces, one behind the other, for transparency: `Layers`, as from `fragments` with ``layers``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from . import validate
from .one_line import OneLine
from .raster.background import background_image
from .raster.colors.composite import composite
from .raster.warp.registration import needs_gradient

if TYPE_CHECKING:
    from .deferred import Fragments


@dataclass(frozen=True, eq=False, repr=False)
class Layers(OneLine):
    """The K nearest faces of each pixel, in order: a sequence of K `Fragments`, the nearest ones first.

    A shader runs on each layer, then `composite` blends the layers from front to back.

    Attributes:
        layers: One `Fragments` for each layer. All have the same corners and settings.

    Raises:
        TypeError, ValueError: In `composite`, an argument that does not fit.

    Example:
        >>> layers = nr.fragments(mesh, camera, 64, layers=2)
        >>> colors = [0.5 + 0.5 * layer.interpolate(mesh.vertices) for layer in layers]
        >>> layers.composite(colors, opacity=0.3, background=1.0).shape
        torch.Size([1, 3, 64, 64])
    """

    layers: tuple[Fragments, ...]

    def __len__(self) -> int:
        return len(self.layers)

    def __iter__(self) -> Iterator[Fragments]:
        return iter(self.layers)

    def __getitem__(self, index: int) -> Fragments:
        return self.layers[index]

    @validate.checked_together
    def composite(
        self, colors: Sequence[Tensor] | Tensor, opacity: Any, background: Any = 0.0, *, seams: bool = False
    ) -> Tensor:
        """Blend the layers from front to back over a background, and add the gradient through their visibility.

        A face with opacity a and colour c over a picture S of what is behind it shows a · c + (1 − a) · S. Gradients
        reach colours, opacities, the background and, through the visibility of each layer, vertices and camera. Faces
        behind the last layer count as nothing.

        A cut-out is an opacity of 0: the layers behind it show. Where opacity jumps inside a face, as at the border of
        a cut-out, the motion of the jump has no gradient.

        Args:
            colors: Colours of the pixels of each layer: K tensors [B, H, W, C] floating, or one [K, B, H, W, C]. Those
                of pixels without a face are ignored.
            opacity: Number; or opacities in [0, 1] of the pixels of each layer, K tensors [B, H, W] or [B, H, W, 1]
                floating, or one with K in front.
            background, seams: As in `Fragments.composite`.

        Returns:
            Images [B, C, height, width] float32, of the size given to `fragments`.

        Raises:
            TypeError: A tensor of another dtype.
            ValueError: Another shape, number of layers or device; NaN or infinite colours.

        Example:
            >>> layers = nr.fragments(mesh, camera, 64, layers=2)
            >>> ones = [torch.ones(*layer.face_index.shape, 1) for layer in layers]
            >>> alpha = layers.composite(ones, opacity=0.5)  # 0.5 through one face, 0.75 through two
            >>> round(alpha.max().item(), 2)
            0.75
        """
        return self.blend(self._of_layers("colors", colors, "C"), opacity, background, seams)

    def blend(
        self,
        colors: list[Tensor],
        opacity: Any,
        background: Any,
        seams: bool,
        edge_hashes: Callable[[], Tensor] | None = None,
    ) -> Tensor:
        """Apply `composite` to valid colours, with the function that returns the hashes for `edge_gradient`."""
        first, estimator = self.layers[0], self.layers[0].settings.gradient
        channels = colors[0].shape[3]
        opacities = self._opacities(opacity)
        behind = background_image(background, len(first.face_index), channels, first.settings, first.corners.device)
        picture = through = behind.expand(-1, -1, *first.face_index.shape[1:])
        pictures = [picture]
        for layer, color, alpha in zip(self.layers[::-1], colors[::-1], opacities[::-1], strict=True):
            blended = alpha * color.float() + (1 - alpha) * through.movedim(1, 3)
            through = picture = composite(blended, picture, layer.face_index)
            if not estimator.joins_layers and layer is not first:
                # The gradient of a hidden layer counts where the layer is seen through the one in front. Elsewhere
                # the faces in front, which may end at the same edges, have the gradient.
                whole = replace(first.settings, anti_aliasing=False)
                through = whole.through_visibility(picture, layer.corners, layer.face_index)
            pictures.append(picture)
        validate.finite("colors", picture)
        seams = validate.flag("seams", seams)
        if not estimator.joins_layers or not needs_gradient(first.corners):
            return first.image(picture, seams=seams, edge_hashes=edge_hashes).contiguous()
        drawn = first.settings.drawn(first.corners, first.face_index, first.rings)
        passing, shown = self._passing(pictures[:0:-1], opacities), [layer.face_index for layer in self.layers]
        return estimator.attach_layers(picture, passing, shown, drawn, seams, edge_hashes).contiguous()

    def _passing(self, pictures: list[Tensor], opacities: list[Tensor]) -> Tensor:
        """Multiply each layer's picture by the share that passes the layers in front, [K, B, C, H, W]; no gradient."""
        share: Tensor | float = 1.0
        result = []
        with torch.no_grad():  # a block: the decorator would end a compiled graph
            for layer, picture, alpha in zip(self.layers, pictures, opacities, strict=True):
                result.append(share * picture)
                share = share * torch.where(layer.mask, 1 - alpha[..., 0], 1.0)[:, None]
            return torch.stack(result)

    def _of_layers(self, name: str, values: Any, *channels: Any) -> list[Tensor]:
        """Check values of the pixels of each layer; return K tensors."""
        if isinstance(values, Tensor):
            values = values.unbind(0) if values.dim() else (values,)
        if not isinstance(values, (list, tuple)):
            raise TypeError(f"{name}: expected a tensor for each layer, got {type(values).__name__}")
        if len(values) != len(self):
            raise ValueError(f"{name}: expected a tensor for each of {len(self)} layers, got {len(values)}")
        for value in values:
            validate.floating(name, value, (*self.layers[0].face_index.shape, *channels))
            validate.same_device(**{name: value}, faces=self.layers[0].corners)
        sizes = {value.shape for value in values}
        if len(sizes) > 1:
            raise ValueError(f"{name}: expected one number of channels, got {', '.join(map(str, map(list, sizes)))}")
        return list(values)

    def _opacities(self, opacity: Any) -> list[Tensor]:
        """Check opacities; return K tensors that broadcast to [B, H, W, 1]."""
        if isinstance(opacity, (int, float)) or (isinstance(opacity, Tensor) and opacity.dim() == 0):
            number = torch.as_tensor(opacity, dtype=torch.float32, device=self.layers[0].corners.device)
            opacities = [number.reshape(1, 1, 1, 1)] * len(self)
        else:
            dims = len(self.layers[0].face_index.shape)
            sample = opacity[0] if isinstance(opacity, (list, tuple, Tensor)) and len(opacity) else opacity
            flat = getattr(sample, "ndim", dims) == dims
            opacities = self._of_layers("opacity", opacity, *(() if flat else (1,)))
            opacities = [alpha.float()[..., None] if flat else alpha.float() for alpha in opacities]
        for alpha in opacities:
            validate.finite("opacity", alpha)
        return opacities
