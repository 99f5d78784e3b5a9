"""Hashes of the colours along each edge, which tell whether the colour is continuous across it.

Each edge of a face gets two 64-bit hashes: of the colours from its first corner to its second, and of the colours in
the opposite order. An adjacent face has the same edge in the opposite direction, so the colour is continuous if the
first hash of one face equals the second hash of the other. Equal hashes are nearly certain to mean equal colours; 0
never matches.
"""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch
from ..warp.layout import images_of
from ..warp.registration import operator

wp.set_module_options({"enable_backward": False})

_ODD = 0x9E3779B97F4A7C15 - 2**64  # the golden ratio in 64 bits, whose powers have well-mixed bits
_THERE, _BACK = 0x2545F4914F6CDD1D, 0x5851F42D4C957F2D


@operator
def texture_edge_hashes(textures: Tensor, light: Tensor) -> Tensor:
    """Hash the colours of texture cubes under light along each edge.

    The hashes of two faces match if the light and the texels that are blended on the edge are equal, to about one part
    in 4000.

    Args:
        textures: Cubes, [B or 1, F, T, T, T, 3] float32.
        light: Factors on the front and the back of each face, [B or 1, 2, F, 3] float32.

    Returns:
        [B, F, 3, 2] int64: for edge k, from corner k to the next, the hash in this direction and in the other.
    """
    batch, count, size = images_of(textures, light), textures.shape[1], textures.shape[2]
    hashes = torch.empty((batch, count, 3, 2), dtype=torch.int64, device=textures.device)
    cubes = array(textures.reshape(len(textures), count, size**3, 3), wp.vec3)
    launch(_hash_edges, batch * count, [cubes, array(light, wp.vec3), size, array(hashes)], textures.device)
    return hashes


@torch.library.register_fake("neural_renderer::texture_edge_hashes")
def _(textures, light):
    batch = images_of(textures, light)
    return textures.new_empty((batch, textures.shape[1], 3, 2), dtype=torch.int64)


def image_edge_hashes(uv: Tensor, image_index: Tensor, light: Tensor | None) -> Tensor:
    """Hash the texture coordinates along each edge.

    The hashes of two faces match if the coordinates and the image are exactly equal, and the light is equal to about
    one part in 4000. A face without an image matches no other face.

    Args:
        uv: Texture coordinates of the corners, [F, 3, 2] or [B, F, 3, 2] float32.
        image_index: Texture image of each face, [F] or [B, F] int64; -1 for none.
        light: Factors on the front and the back of each face, [B, 2, F, 3]; None for 1.

    Returns:
        [1 or B, F, 3, 2] int64, as from `texture_edge_hashes`.
    """
    uv, image = (uv, image_index) if uv.dim() == 4 else (uv[None], image_index[None])
    corners = _hash(torch.cat((_bits(uv.detach()).long(), image.long()[..., None, None].expand(-1, -1, 3, 1)), 3))
    hashes = _along(corners)
    own = _hash(torch.arange(uv.shape[1], device=uv.device)[:, None] + 1)[:, None, None]
    hashes = _mixed(torch.where(image[..., None, None] < 0, own, hashes))
    return _never_zero(hashes if light is None else hashes + _light_hash(light))


def attribute_edge_hashes(values: Tensor) -> Tensor:
    """Hash attributes of corners along each edge, to add to the hashes of colours that depend on them.

    Args:
        values: Attributes of the corners, [F, 3, C] or [B, F, 3, C] float32; equal ones match to about one part in
            4000.

    Returns:
        [1 or B, F, 3, 2] int64.
    """
    hashes = _mixed(_along(_hash(_digits(values.detach()).long())))
    return hashes if values.dim() == 4 else hashes[None]


def _along(corners: Tensor) -> Tensor:
    """Combine hashes of corners, [..., F, 3], to those of edges in both directions, [..., F, 3, 2]."""
    following = corners.roll(-1, -1)
    return torch.stack((corners * _THERE + following * _BACK, following * _THERE + corners * _BACK), -1)


def _light_hash(light: Tensor) -> Tensor:
    """Hash light [B, 2, F, 3] on both sides of each face; returns [B, F, 1, 1]."""
    return _hash(_digits(light.detach()).permute(0, 2, 1, 3).flatten(2))[..., None, None]


def _digits(values: Tensor) -> Tensor:
    """Round float32 to 12 of its 23 mantissa bits, one part in 4000, as an int32."""
    return (_bits(values) + (1 << 10)) >> 11


def _bits(values: Tensor) -> Tensor:
    """Reinterpret as float32 and then as int32; -0 becomes 0."""
    return (values.float() + 0.0).view(torch.int32)


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
    """Replace 0, which matches nothing."""
    return torch.where(hashes == 0, 1, hashes)


# The same as `_hash`, `_digits` and `_mixed`, for unsigned integers.
_HASH_FACE = """
    typedef unsigned long long number;
    struct Hash {
        static CUDA_CALLABLE number mixed(number n) {
            n = (n ^ (number)((long long)n >> 32)) * ODD;
            return n ^ (number)((long long)n >> 29);
        }
        static CUDA_CALLABLE number add(number hash, const wp::vec_t<3, float>& color) {
            for (int c = 0; c < 3; ++c) {
                const float value = color[c] + 0.0f;  // -0 is 0
                int bits;
                memcpy(&bits, &value, 4);
                hash = (hash + (number)(long long)((int)((unsigned)bits + 1024u) >> 11)) * ODD;
            }
            return hash;
        }
    };
    const wp::int64 count = textures.shape[1], cubes = textures.shape[0], lamps = light.shape[0];
    const wp::int64 texels = (wp::int64)size * size * size, square = (wp::int64)size * size;
    const auto* cube = textures.data + ((b < cubes ? b : cubes - 1) * count + f) * texels;
    const auto* lit = light.data + (b < lamps ? b : lamps - 1) * 2 * count + f;
    const number lamp = Hash::mixed(Hash::add(Hash::add(0, lit[0]), lit[count]));
    // Strides from texel to texel along the axis of the edge's first corner, and of its second.
    const wp::int64 along[3] = {square, size, 1}, beside[3] = {size, 1, square};
    for (int k = 0; k < 3; ++k) {
        number there = 0, back = 0;
        for (int i = 0; i < size; ++i)
            for (int j = wp::max(size - 2 - i, 0); j <= wp::min(size - i, size - 1); ++j) {
                const number color = Hash::mixed(Hash::add(0, cube[i * along[k] + j * beside[k]]));
                there += Hash::mixed(color + (number)i * THERE + (number)j * BACK);
                back += Hash::mixed(color + (number)j * THERE + (number)i * BACK);
            }
        wp::int64* to = hashes.data + ((b * count + f) * 3 + k) * 2;
        to[0] = (wp::int64)(there + lamp), to[1] = (wp::int64)(back + lamp);
        for (int n = 0; n < 2; ++n) to[n] = to[n] == 0 ? 1 : to[n];  // 0 matches nothing
    }
"""
for _name, _value in {"ODD": _ODD % 2**64, "THERE": _THERE, "BACK": _BACK}.items():
    _HASH_FACE = _HASH_FACE.replace(_name, f"{_value}ull")


@wp.func_native(_HASH_FACE)
def hash_face(
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    size: int,
    b: int,
    f: int,
    hashes: wp.array4d(dtype=wp.int64),
):
    """Hash the edges of one face of one image."""
    ...


@wp.kernel
def _hash_edges(
    first: int,
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    size: int,
    hashes: wp.array4d(dtype=wp.int64),
):
    """Hash the edges of one face of one image."""
    task = first + wp.tid()
    hash_face(textures, light, size, task // textures.shape[1], task % textures.shape[1], hashes)


@wp.func
def colors_continue(
    edge_hashes: wp.array4d(dtype=wp.int64),
    faces: wp.array3d(dtype=wp.vec3),
    adjacent: wp.array3d(dtype=int),
    b: int,
    f: int,
    k: int,
) -> bool:
    """Test whether the hashes of edge k of face f match the hashes of the same edge of the adjacent face.

    If there are fewer hashes than images or faces, the last image and the last face are repeated.
    """
    own = wp.min(b, edge_hashes.shape[0] - 1)
    last = edge_hashes.shape[1] - 1
    own_hash = edge_hashes[own, wp.min(f, last), k, 0]
    g = adjacent[b, f, k]
    if own_hash != wp.int64(0):
        for m in range(3):
            if faces[b, g, (m + 1) % 3] == faces[b, f, k] and faces[b, g, m] == faces[b, f, (k + 1) % 3]:
                return edge_hashes[own, wp.min(g, last), m, 1] == own_hash
    return False
