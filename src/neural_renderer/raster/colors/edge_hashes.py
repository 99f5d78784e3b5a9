"""Hashes of the colours along each edge, to test whether the colour is continuous across it.

Each edge of a face gets two 64-bit hashes: of the colours from its first corner to its second, and of those in the
opposite order. An adjacent face has the same edge in the opposite direction, so the colour is continuous if the first
hash of one face equals the second hash of the other. Equal hashes almost surely mean equal colours; 0 never matches.
"""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

import weakref
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from ...base import private
from ..warp.elementwise import equal, in_pieces
from ..warp.launch import launch, stream_of
from ..warp.layout import images_of, readable
from ..warp.native import Kernels, constant
from ..warp.registration import fake, is_plain, of_constants, operator
from .texture_cubes import lit_cubes

_KERNELS = Kernels(__name__, "edge_hashes.h")
_Scene, _HashEdges = _KERNELS.struct("Scene"), _KERNELS.struct("HashEdges")
_LitHashes = _KERNELS.struct("LitHashes")
_hash_edges = _KERNELS.kernel("hash_edges", _HashEdges)
_add_light = _KERNELS.kernel("add_light", _LitHashes)
_MANY_FACES = 1 << 12  # that justify another CPU thread

_cache = WeakTensorKeyDictionary()  # by the tensor ``image_index``: copies of uv and of it, and their hashes
_cache_of_cuda = WeakTensorKeyDictionary()  # the same on CUDA: uv itself, the stream and the versions, and their hashes

_ODD, _THERE, _BACK = (constant("edge_hashes.h", name) for name in ("ODD", "THERE", "BACK"))
_ODD -= 2**64  # the same bits in torch's int64


@operator
def texture_edge_hashes(textures: Tensor, light: Tensor, firsts: Tensor | None = None) -> Tensor:
    """Hash the lit colours of faces along each edge; textures and light [B or 1, 2, F, 3] as for `sample_textures`.

    The hashes of two faces match if the light and the texels that are blended on the edge are equal, to about one part
    in 4000. Returns [B, F, 3, 2] int64: for edge k, from corner k to the next, the hash in this direction and the
    other. ``firsts`` as in `sample_textures`; padding matches nothing.
    """
    batch, count = _images(textures, light, firsts), light.shape[2]
    hashes = torch.empty((batch, count, 3, 2), dtype=torch.int64, device=textures.device)
    call = _HashEdges(scene=_Scene(count=count), textures=lit_cubes(textures, light, firsts=firsts), hashes=hashes)
    launch(_hash_edges, batch * count, [call], textures.device)
    return hashes


@fake(texture_edge_hashes)
def _(textures: Tensor, light: Tensor, firsts: Tensor | None) -> Tensor:
    return textures.new_empty((_images(textures, light, firsts), light.shape[2], 3, 2), dtype=torch.int64)


@dataclass(frozen=True, eq=False)
class CubeEdges:
    """`texture_edge_hashes` with its arguments, for callers that compare colours without hashes."""

    textures: Tensor
    light: Tensor
    firsts: Tensor | None

    def __call__(self) -> Tensor:
        """Hash the colours along edges."""
        return texture_edge_hashes(self.textures, self.light, self.firsts)


def _images(textures: Tensor, light: Tensor, firsts: Tensor | None) -> int:
    return images_of(textures, light) if firsts is None else len(firsts) - 1


def image_edge_hashes(uv: Tensor, image_index: Tensor, light: Tensor | None, colors: Tensor | None = None) -> Tensor:
    """Hash the texture coordinates of the corners, [F, 3, 2] or [B, F, 3, 2] float32, along each edge.

    The hashes of two faces match if the coordinates and the image, [F] or [B, F] int64, are exactly equal, and the
    light [B, 2, F, 3] is equal to about one part in 4000. Faces without an image, -1, match if the ``colors`` of their
    corners, [F, 3, 3] or [B, F, 3, 3] float32, are equal to this precision; without ``colors``, they match no face.

    Returns:
        [1 or B, F, 3, 2] int64, as from `texture_edge_hashes`.
    """
    if readable(uv.device):
        hashes = of_constants(_cached_hashes, uv.detach(), image_index)
    else:
        hashes = _cached_on_cuda(uv, image_index)
    hashes = _image_hashes(uv.detach(), image_index) if hashes is None else hashes
    if colors is not None and not (
        readable(uv.device) and of_constants(lambda index: bool((index >= 0).all()), image_index)
    ):
        plain = (image_index < 0).view(-1, image_index.shape[-1], 1, 1)
        hashes = torch.where(plain, _never_zero(attribute_edge_hashes(colors)), hashes)
    return hashes if light is None else light_edge_hashes(hashes, light.detach())


@operator
def light_edge_hashes(hashes: Tensor, light: Tensor) -> Tensor:
    """Add the light of faces, [1 or B, 2, F, 3] float32, to hashes of their edges, [1 or B, F, 3, 2] int64."""
    batch, count = images_of(hashes, light), light.shape[2]
    lit = torch.empty((batch, count, 3, 2), dtype=torch.int64, device=light.device)
    call = _LitHashes(hashes=hashes, light=light, owners=len(hashes), lamps=len(light), count=count, lit=lit)
    launch(_add_light, batch * count, [call], light.device, _MANY_FACES)
    return lit


@fake(light_edge_hashes)
def _(hashes: Tensor, light: Tensor) -> Tensor:
    return hashes.new_empty((images_of(hashes, light), light.shape[2], 3, 2))


def _cached_hashes(uv: Tensor, image_index: Tensor) -> Tensor:
    """Return `_image_hashes`, cached for the lifetime of ``image_index``, and valid only for equal values."""
    known = _cache.get(image_index)
    if known is None or not (equal(known[0], uv) and equal(known[1], image_index)):
        with torch.inference_mode(False):
            copies = uv.clone(), image_index.clone()
            known = _cache[image_index] = (*copies, _image_hashes(*copies))
    return known[2]


def _cached_on_cuda(uv: Tensor, image_index: Tensor) -> Tensor | None:
    """Return `_image_hashes` as `_cached_hashes`, but recognise tensors, unless changed in place: values would wait.

    None for tensors that have no version, and while a CUDA graph is captured, whose replays compute the hashes.
    """
    stream, versions = stream_of(uv.device), private.version_of(uv, image_index)
    if stream is None or versions is None or not is_plain((uv, image_index)):
        return None
    state = stream, versions
    known = _cache_of_cuda.get(image_index)
    if known is None or known[0]() is not uv or known[1] != state:
        with torch.inference_mode(False):
            hashes = _image_hashes(uv.detach(), image_index)
        known = _cache_of_cuda[image_index] = weakref.ref(uv), state, hashes
    return known[2]


def _image_hashes(uv: Tensor, image_index: Tensor) -> Tensor:
    uv, image = (uv, image_index) if uv.dim() == 4 else (uv[None], image_index[None])
    corners = _hash(torch.cat((float_bits(uv).long(), image.long()[..., None, None].expand(-1, -1, 3, 1)), 3))
    hashes = _along(corners)
    own = _hash(torch.arange(uv.shape[1], device=uv.device)[:, None] + 1)[:, None, None]
    return _never_zero(_mixed(torch.where(image[..., None, None] < 0, own, hashes)))


def attribute_edge_hashes(values: Tensor) -> Tensor:
    """Hash attributes of corners along each edge, to add to the hashes of colours that depend on them.

    Attributes [F, 3, C] or [B, F, 3, C] float32 match to about one part in 4000. Returns [1 or B, F, 3, 2] int64.
    """
    values = values.detach() if values.dim() == 4 else values.detach()[None]
    # 12 of 23 mantissa bits, rounded
    return in_pieces(lambda part: _mixed(_along(_hash((float_bits(part) + (1 << 10) >> 11).long()))), values, dim=1)


def _along(corners: Tensor) -> Tensor:
    """Combine hashes of corners, [..., F, 3], to hashes of edges in both directions, [..., F, 3, 2]."""
    following = corners.roll(-1, -1)
    return torch.stack((corners * _THERE + following * _BACK, following * _THERE + corners * _BACK), -1)


@operator
def float_bits(values: Tensor) -> Tensor:
    """Reinterpret as float32 and then as int32; -0 becomes 0.

    An operator, because `torch.func.vmap` of torch 2.11 has no rule for views of another dtype.
    """
    return (values.float() + 0.0).view(torch.int32)


@fake(float_bits)
def _(values: Tensor) -> Tensor:
    return values.new_empty(values.shape, dtype=torch.int32)


def _hash(numbers: Tensor) -> Tensor:
    """Hash the numbers of the last dimension into one int64."""
    result = torch.zeros(numbers.shape[:-1], dtype=torch.int64, device=numbers.device)
    for part in numbers.unbind(-1):
        result = (result + part) * _ODD
    return _mixed(result)


def _mixed(number: Tensor) -> Tensor:
    """Mix the high bits into the low ones."""
    number = (number ^ (number >> 32)) * _ODD
    return number ^ (number >> 29)


def _never_zero(hashes: Tensor) -> Tensor:
    """Replace 0, which matches nothing, in hashes [B, F, 3, 2]."""
    return in_pieces(lambda part: torch.where(part == 0, 1, part), hashes, dim=1)
