"""Gutter filling: colours for the texels between charts, so that mipmaps show no seams."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from ..base import validate
from ..raster.rasterize import rasterize_images
from .sample_texture import Wrap, checked_wrap

# Every circle of this radius, in texels, contains a texel centre: √2 / 2, rounded up.
_COVERING_RADIUS = 0.7072
_MOST_SAMPLES = 1 << 22  # points sampled on small faces: about a second of work


def fill_gutters(texture: Tensor, uv: Tensor, known: Tensor | None = None, *, wrap: Wrap = "repeat") -> Tensor:
    """Replace every texel that no face shows by a blend of the texels around it.

    Mipmaps average across the borders of charts. If the gaps between charts are black, dark lines appear along every
    seam. This function fills the gaps by the pull-push algorithm (Gortler et al., "The Lumigraph", 1996, section 3.4):
    averages of the covered texels at coarser and coarser levels.

    A face shows the texels whose centres it covers. A face too small to cover a centre, as in colour palettes, shows
    the texels that bilinear sampling reads within it.

    Args:
        texture: [h, w, C] floating.
        uv: [F, 3, 2] floating, texture coordinates of the faces' corners, v up.
        known: [h, w] bool, texels that have a colour; the others are replaced, too. None means all. If no texel is both
            known and shown, the texture is returned as it is.
        wrap: Wrapping beyond [0, 1], as in `sample_texture`. If the image repeats within a face, all of it is shown;
            also if a face leaves [0, 1] and the image is mirrored, or wraps differently in u and v.

    Returns:
        [h, w, C] float32, differentiable in ``texture``.

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> texture = torch.zeros(16, 16, 3)
        >>> texture[8:, :8] = 1  # one white chart in the lower left corner
        >>> uv = torch.tensor([[[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]], [[0.0, 0.0], [0.5, 0.5], [0.0, 0.5]]])
        >>> fill_gutters(texture, uv, wrap="clamp").min().item()
        1.0
    """
    validate.floating("texture", texture, ("h", "w", "C"))
    validate.finite("uv", validate.floating("uv", uv, ("F", 3, 2)))
    checked_wrap(wrap)
    size = texture.shape[:2]
    if known is not None and (not isinstance(known, Tensor) or known.shape != size or known.dtype != torch.bool):
        got = validate.shape_of(known) if isinstance(known, Tensor) else type(known).__name__
        raise ValueError(f"known: expected bool {list(size)} like the texture, got {got}")
    with torch.no_grad():
        if wrap in ("repeat", "clamp") or not bool(((uv < 0) | (uv > 1)).any()):
            shown = _shown(uv.float(), size[0], size[1], wrap == "repeat")
        else:
            shown = torch.ones(size, dtype=torch.bool, device=uv.device)
        if known is not None:
            shown = shown & known
        if not shown.any():
            return texture.float()
    filled = texture.new_empty(texture.shape, dtype=torch.float32)
    for channel in range(texture.shape[2]):  # one at a time, to save memory
        filled[..., channel] = pull_push(texture[None, None, ..., channel].float(), shown[None, None])[0, 0]
    return filled


def _shown(uv: Tensor, height: int, width: int, repeat: bool) -> Tensor:
    """Find the texels that faces cover, [height, width] bool."""
    if not uv.numel():
        return torch.zeros(height, width, dtype=torch.bool, device=uv.device)
    low = uv.amin(1, keepdim=True)
    if repeat and bool((uv.amax(1, keepdim=True) - low > 1).any()):
        return torch.ones(height, width, dtype=torch.bool, device=uv.device)
    uv = uv - low.floor() if repeat else uv
    # A chart can cross the border between repetitions of the image, so it is drawn in four of them.
    shifts = ((0, 0), (1, 0), (0, 1), (1, 1)) if repeat else ((0, 0),)
    corners = functional.pad(2 * torch.cat([uv - uv.new_tensor(shift) for shift in shifts]) - 1, (0, 1), value=1.0)
    drawn = {"two_sided": True, "perspective": False, "anti_aliasing": False, "near": 0.5, "far": 2.0}
    alpha = rasterize_images(corners[None], (height, width), outputs=("alpha",), **drawn).alpha  # type: ignore[arg-type]
    shown = alpha[0] > 0

    size = uv.new_tensor((width, height))
    places = torch.stack((uv[..., 0], 1 - uv[..., 1]), 2) * size - 0.5  # integers at the centres of texels
    if not repeat:
        outside = ((uv < 0) | (uv > 1)).any()
        shown[[0, -1]] |= outside
        shown[:, [0, -1]] |= outside
    texels = _blended(_small(places), height, width, repeat)
    if texels is None:
        return torch.ones_like(shown)
    shown.view(-1)[texels] = True
    return shown


def _small(places: Tensor) -> Tensor:
    """Select the triangles [F, 3, 2] that may not contain a texel centre."""
    sides = places.roll(-1, 1) - places
    area = (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]).abs()
    radius = area / sides.norm(dim=2).sum(1).clamp(min=1e-12)  # inscribed circle
    return places[radius < _COVERING_RADIUS]


def _blended(places: Tensor, height: int, width: int, repeat: bool) -> Tensor | None:
    """Find the indices of texels that bilinear sampling reads on the sides and medians of triangles [F, 3, 2].

    Returns None if that takes too many samples, for example for a hundred thousand slivers across a whole image.
    """
    begin = places.repeat(1, 2, 1)
    end = torch.cat((places.roll(-1, 1), (places.roll(-1, 1) + places.roll(-2, 1)) / 2), 1)
    begin, side = begin.reshape(-1, 2), (end - begin).reshape(-1, 2)
    lengths = (2 * side.double().norm(dim=1)).ceil()
    if not float((lengths + 2).sum()) <= _MOST_SAMPLES:  # also refuses NaN, the sum for huge coordinates
        return None
    steps = lengths.long() + 1  # half a texel apart, or less
    line = torch.arange(len(steps), device=places.device).repeat_interleave(steps + 1)
    step = torch.arange(len(line), device=places.device) - (steps + 1).cumsum(0)[line] + steps[line] + 1
    low = (begin[line] + side[line] * (step / steps[line])[:, None]).floor().long()
    found = []
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        x, y = low[:, 0] + right, low[:, 1] + down
        x, y = (x % width, y % height) if repeat else (x.clamp(0, width - 1), y.clamp(0, height - 1))
        found.append(y * width + x)
    return torch.cat(found)


def pull_push(image: Tensor, shown: Tensor) -> Tensor:
    """Fill the texels of image [1, C, h, w] where ``shown`` [1, 1, h, w] is False, from the next coarser level."""
    if image.shape[2:] == (1, 1) or bool(shown.all()):
        return image
    half = (-(-image.shape[2] // 2), -(-image.shape[3] // 2))
    share = functional.adaptive_avg_pool2d(shown.float(), half)
    coarse = functional.adaptive_avg_pool2d(image * shown, half) / share.clamp(min=1e-6)
    coarse = pull_push(coarse, share > 0)
    above = functional.interpolate(coarse, size=image.shape[2:], mode="bilinear", align_corners=False)
    return torch.where(shown, image, above)
