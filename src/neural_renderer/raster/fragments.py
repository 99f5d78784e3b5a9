"""`Fragments`: the visible face of each pixel, its weights and depth, for shaders; `Layers`: several faces per pixel.

`fragments` of the room `rendering` makes them for a scene. `Layers` are faces one behind the other, for transparency.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..base import validate
from ..base.one_line import OneLine
from .background import background_image
from .colors.composite import composite
from .colors.downsample import in_blocks
from .exact import checked_dtype, exact_interpolate
from .faces import checked_faces
from .ops.corners import gather_corners
from .ops.peel import peel
from .settings import Settings
from .visible import VisibleFaces
from .warp.elementwise import joined
from .warp.registration import needs_gradient


@dataclass(frozen=True, eq=False, repr=False)
class Fragments(VisibleFaces):
    """The visible face of each pixel of B images, for custom shaders.

    Under anti-aliasing, H and W are twice the requested size; `composite` averages to that size.

    Attributes:
        corners: Screen-space corners of the faces, [B, F, 3, 3] float32.
        face_index: Visible face of each pixel, [B, H, W] int32; -1 for none. Row 0 is at the top.
        settings: How the faces were drawn.
        half_edges: Which edges the faces share, for the gradient.
        triangles: Vertex indices of the faces, [F, 3] or [B, F, 3].
        num_vertices: Number of vertices V; None if it is not known.

    Raises:
        TypeError, ValueError: In `interpolate` and `composite`, an argument that does not fit.

    Example:
        >>> fragments = nr.fragments(mesh, camera, 64)
        >>> height = fragments.interpolate(mesh.vertices)[..., 1:2]  # at twice the size
        >>> height.shape
        torch.Size([1, 128, 128, 1])
        >>> fragments.composite(height, background=0.0).shape
        torch.Size([1, 1, 64, 64])
        >>> seen = mesh.submesh(fragments.visible_faces().any(0))  # the half that the camera sees
        >>> fragments.visible_vertices().shape
        torch.Size([1, 162])
    """

    triangles: Tensor
    num_vertices: int | None = None

    @validate.checked_together
    def interpolate(
        self, attributes: Tensor, triangles: Tensor | None = None, *, dtype: torch.dtype = torch.float32
    ) -> Tensor:
        """Interpolate attributes of vertices, or of the corners of faces, at every pixel, perspective-correct.

        The result has the fragments' size: twice the requested size under anti-aliasing. Gradients reach the attributes
        and, through the weights, vertices and camera (``gradient="edge"``).

        Args:
            attributes: [V, C] or [B, V, C] floating for vertices, any number of channels; [F, 3, C] or [B, F, 3, C] for
                corners. If F is 1 or B, three dimensions mean [B, V, C]; [1, F, 3, C] means corners.
            triangles: Per-face indices into ``attributes``, [F, 3] or [B, F, 3] integer, if they are indexed separately
                from vertices (e.g. texture coordinates). Default: the faces of the mesh.
            dtype: Of the result. float64 computes in plain torch: all derivatives with respect to the attributes, as
                `torch.autograd.gradcheck` needs them, but slower, and none with respect to vertices and camera.

        Returns:
            [B, H, W, C] of ``dtype``; 0 where no face is visible.

        Raises:
            TypeError, ValueError: A tensor does not fit, an index is out of range, or an attribute is not finite.
        """
        dims, dtype = getattr(attributes, "ndim", 2), checked_dtype(dtype)
        batch, count = self.corners.shape[:2]
        is_like_corners = dims == 3 and attributes.shape[:2] == (count, 3) and count not in (1, batch)
        if dims == 4 or (is_like_corners and triangles is None):
            return self._interpolate_corners(attributes, triangles, dtype)
        validate.floating("attributes", attributes, ("V", "C") if dims == 2 else ("B", "V", "C"))
        if triangles is None and self.num_vertices not in (None, attributes.shape[-2]):
            corners = f"[{batch}, {count}, 3, C]" if count in (1, batch) else f"[{count}, 3, C]"
            expected = f"[{self.num_vertices}, C] for vertices or {corners} for corners"
            raise ValueError(f"attributes: expected {expected}, got {validate.shape_of(attributes)}")
        triangles = self.triangles if triangles is None else checked_faces(triangles)
        validate.same_device(attributes=attributes, triangles=triangles, faces=self.corners)
        validate.finite("attributes", attributes)
        attributes = attributes if attributes.dim() == 3 else attributes[None]
        triangles = triangles if triangles.dim() == 3 else triangles[None]
        if attributes.shape[0] not in (1, batch) or triangles.shape[0] not in (1, batch):
            raise ValueError(
                f"attributes: expected a batch of 1 or {batch}, got {len(attributes)}, {len(triangles)} triangles"
            )
        if triangles.shape[1] != count:
            raise ValueError(f"triangles: expected {count} like the mesh's faces, got {triangles.shape[1]}")
        validate.in_range("triangles", triangles, attributes.shape[1], padded=True)
        several = attributes if len(triangles) == 1 else attributes.expand(len(triangles), -1, -1)
        if dtype == torch.float64:
            image = torch.arange(len(several), device=several.device)[:, None, None]
            return exact_interpolate(self, several[image, triangles])  # padded faces, of −1, are never visible
        return self.at_pixels(gather_corners(several.float(), triangles.int()))

    def visible_faces(self) -> Tensor:
        """Find the faces that each image shows in at least one pixel.

        Returns:
            [B, F] bool.
        """
        batch, count = self.corners.shape[:2]
        shown = self.corners.new_zeros((batch, count + 1), dtype=torch.bool)
        shown.scatter_(1, self.face_index.long().flatten(1) % (count + 1), True)  # −1 becomes the extra entry
        return shown[:, :count]

    def visible_vertices(self, count: int | None = None) -> Tensor:
        """Find the vertices of the faces that each image shows (`visible_faces`).

        Args:
            count: Number of vertices V. None is that of the mesh.

        Returns:
            [B, V] bool.

        Raises:
            TypeError, ValueError: ``count`` is not a whole number, or less than an index + 1.
        """
        shown = self.visible_faces()
        triangles = self.triangles.long().expand(len(shown), -1, -1)
        most = int(triangles.max()) + 1 if triangles.numel() else 0
        count = (self.num_vertices or most) if count is None else count
        count = validate.whole("count", count, most)
        # Padded faces (−1, −1, −1) are never visible, and go to the extra entry.
        result = shown.new_zeros(len(shown), count + 1).int()
        result.scatter_add_(1, (triangles % (count + 1)).flatten(1), shown.repeat_interleave(3, 1).int())
        return result[:, :count] > 0

    def _interpolate_corners(self, attributes: Tensor, triangles: Tensor | None, dtype: torch.dtype) -> Tensor:
        """Interpolate attributes [F, 3, C] or [1 or B, F, 3, C]."""
        batch, count = self.corners.shape[:2]
        if triangles is not None:
            raise ValueError("triangles: expected None for attributes of corners, [F, 3, C]")
        attributes = attributes if attributes.dim() == 4 else attributes[None]
        validate.floating("attributes", attributes, ("B", count, 3, "C"))
        if attributes.shape[0] not in (1, batch):
            raise ValueError(f"attributes: expected a batch of 1 or {batch}, got {len(attributes)}")
        validate.same_device(attributes=attributes, faces=self.corners)
        validate.finite("attributes", attributes)
        if dtype == torch.float64:
            return exact_interpolate(self, attributes)
        attributes = attributes.float()
        return self.at_pixels(attributes if attributes.is_contiguous() else joined((attributes,), 1))

    @validate.checked_together
    def composite(self, colors: Tensor, background: Any = 0.0, *, seams: bool = False) -> Tensor:
        """Composite colours over a background and add the gradient through visibility.

        Args:
            colors: Colours of the pixels, [B, H, W, C] floating. Colours of pixels without a face are ignored.
            background: Number; colour [C] or [B, C]; or image of the requested size, [C, height, width] or [height,
                width, C], or a batch of them. What fits both has its channels first. It gets gradients.
            seams: Whether colours may jump where two faces of the surface meet, as with texture charts that do not
                match, or light per face. Then ``"edge"`` differentiates the motion of those jumps too. False is faster
                and less noisy, but the gradient is wrong at jumps.

        Returns:
            Images [B, C, height, width] float32, of the size given to `fragments`.

        Raises:
            TypeError, ValueError: A tensor does not fit, or a colour is not finite.
        """
        batch, rows, columns = self.face_index.shape
        validate.floating("colors", colors, (batch, rows, columns, "C"))
        validate.same_device(colors=colors, faces=self.corners)
        return self.blend(colors, background, validate.flag("seams", seams))

    def blend(
        self,
        colors: Tensor,
        background: Any,
        seams: bool,
        edge_hashes: Callable[[], Tensor] | None = None,
        corner_values: Tensor | None = None,
    ) -> Tensor:
        """Composite valid colours, for callers that know the hashes of the edges, as shaders do.

        Args:
            colors: [B, H, W, C] floating, on the device of the corners.
            background, seams: As in `composite`.
            edge_hashes: Function that returns hashes of the colours along edges, [1 or B, F, 3, 2] int64; an edge
                whose hashes match is no seam. None: with ``seams``, every edge may be one.
            corner_values: If the colours are interpolated, their values at the corners of faces, [1 or B, F, 3, C].

        Returns:
            Images as from `composite`.

        Raises:
            ValueError: The background does not fit, or a colour is not finite.

        Example:
            >>> visible = nr.fragments(mesh, camera, 64)
            >>> colors = visible.interpolate(mesh.vertices)
            >>> visible.blend(colors, 0.0, seams=True).shape
            torch.Size([1, 3, 64, 64])
        """
        behind = background_image(background, len(colors), colors.shape[3], self.settings, colors.device)
        image = in_blocks(self.in_blocks, composite, colors.float(), behind, self.face_index)
        known = None if corner_values is None else corner_values.detach().float()
        image = self.image(image, seams=seams, edge_hashes=edge_hashes, corner_values=known).contiguous()
        validate.finite("colors", image)  # means of 2 × 2 pixels are finite where these are
        return image


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
            TypeError, ValueError: A tensor or the number of layers does not fit, or a colour is not finite.

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
        drawn = first.settings.drawn(first.corners, first.face_index, first.half_edges)
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


def visible_fragments(
    corners: Tensor, faces: Tensor, count: int | None, settings: Settings, channels: int
) -> Fragments:
    """Find the visible faces of corners in screen space [B, F, 3, 3]; ``count`` is the number of vertices, or None."""
    corners = settings.corners(corners, channels)
    half_edges = settings.half_edges(corners, faces)
    # The last two by name: some versions of torch.compile also count the fields that `__init__` does not take.
    named: dict[str, Any] = {"triangles": faces, "num_vertices": count}
    return Fragments(corners, settings.face_index(corners), settings, half_edges, **named)


def visible_layers(corners: Tensor, faces: Tensor, count: int, settings: Settings, layers: int) -> Layers:
    """Find the nearest faces of each pixel, as `visible_fragments`."""
    corners = settings.corners(corners, 8 * layers)
    height, width = settings.height * settings.scale, settings.width * settings.scale
    limits = (settings.near, settings.far, settings.two_sided, settings.perspective)
    half_edges = settings.half_edges(corners, faces)
    shown = peel(corners.detach(), height, width, *limits, layers)
    named: dict[str, Any] = {"triangles": faces, "num_vertices": count}  # as in `visible_fragments`
    found = [Fragments(corners, index, settings, half_edges, **named) for index in shown.unbind(0)]
    for layer in found:
        object.__setattr__(layer, "_uses", iter(()))  # torch sums the gradients to corners that layers share
    return Layers(tuple(found))
