"""Where colours go on from face to face: numbers for each edge that tell, when compared with the other face's."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch
from ..warp.registration import operator

wp.set_module_options({"enable_backward": False})

_ODD = 0x9E3779B97F4A7C15 - 2**64  # the golden ratio in 64 bits, whose powers' bits are as good as random
_THERE, _BACK = 0x2545F4914F6CDD1D, 0x5851F42D4C957F2D


@operator
def texture_marks(textures: Tensor, light: Tensor) -> Tensor:
    """Marks [B, F, 3, 2] int64 for `boundaries`, of texture cubes [B, F, T, T, T, 3] and light [B, 2, F, 3].

    For edge k, from corner k to the next, one of what is on it in this order, and one of the same in the other. The
    first is equal to the second of the face beyond if the texels that are blended on the edge are, to about one part in
    4000, and the light is.
    """
    batch, count, size = max(len(textures), len(light)), textures.shape[1], textures.shape[2]
    marks = torch.empty((batch, count, 3, 2), dtype=torch.int64, device=textures.device)
    cubes = array(textures.reshape(len(textures), count, size**3, 3), wp.vec3)
    launch(_mark, batch * count, [cubes, array(light, wp.vec3), size, array(marks)], textures.device)
    return marks


@torch.library.register_fake("neural_renderer::texture_marks")
def _(textures, light):  # type: ignore[no-untyped-def]
    batch = max(textures.shape[0], light.shape[0])
    return textures.new_empty((batch, textures.shape[1], 3, 2), dtype=torch.int64)


def image_marks(uv: Tensor, image_index: Tensor, light: Tensor | None) -> Tensor:
    """Likewise [1 or B, F, 3, 2] of texture coordinates [F, 3, 2] on images of that index [F], which must be equal."""
    corners = _hash(torch.cat((_bits(uv.detach()).long(), image_index.long()[:, None, None].expand(-1, 3, 1)), 2))
    following = corners.roll(-1, 1)
    marks = torch.stack((corners * _THERE + following * _BACK, following * _THERE + corners * _BACK), 2)
    # A face without an image has colours of its own.
    own = _hash(torch.arange(len(uv), device=uv.device)[:, None] + 1)[:, None, None]
    marks = _mixed(torch.where(image_index[:, None, None] < 0, own, marks))[None]
    return _never_zero(marks if light is None else marks + _light_hash(light))


def _light_hash(light: Tensor) -> Tensor:
    """[B, F, 1, 1] of the factors [B, 2, F, 3] on both sides of each face."""
    return _hash(_digits(light.detach()).permute(0, 2, 1, 3).flatten(2))[..., None, None]


def _digits(values: Tensor) -> Tensor:
    """Whole numbers that are equal for values that are to one part in 4000: 12 of a float's 23 bits are left."""
    return (_bits(values) + (1 << 10)) >> 11


def _bits(values: Tensor) -> Tensor:
    """Those of float32, int32; the same for 0 and -0."""
    return (values.float() + 0.0).view(torch.int32)


def _hash(numbers: Tensor) -> Tensor:
    """One int64 for the last dimension's."""
    result = torch.zeros(numbers.shape[:-1], dtype=torch.int64, device=numbers.device)
    for part in numbers.unbind(-1):
        result = (result + part) * _ODD
    return _mixed(result)


def _mixed(number: Tensor) -> Tensor:
    number = (number ^ (number >> 32)) * _ODD
    return number ^ (number >> 29)


def _never_zero(marks: Tensor) -> Tensor:
    return torch.where(marks == 0, 1, marks)


# As `_hash`, `_digits` and `_mixed` have it, for numbers without a sign.
_MARK = """
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
    // From one texel to the next along the first corner's axis, and along the second's.
    const wp::int64 along[3] = {square, size, 1}, beside[3] = {size, 1, square};
    for (int k = 0; k < 3; ++k) {
        number there = 0, back = 0;
        for (int i = 0; i < size; ++i)
            for (int j = wp::max(size - 2 - i, 0); j <= wp::min(size - i, size - 1); ++j) {
                const number color = Hash::mixed(Hash::add(0, cube[i * along[k] + j * beside[k]]));
                there += Hash::mixed(color + (number)i * THERE + (number)j * BACK);
                back += Hash::mixed(color + (number)j * THERE + (number)i * BACK);
            }
        wp::int64* to = marks.data + ((b * count + f) * 3 + k) * 2;
        to[0] = (wp::int64)(there + lamp), to[1] = (wp::int64)(back + lamp);
        for (int n = 0; n < 2; ++n) to[n] = to[n] == 0 ? 1 : to[n];  // which says nothing
    }
"""
for _name, _value in {"ODD": _ODD % 2**64, "THERE": _THERE, "BACK": _BACK}.items():
    _MARK = _MARK.replace(_name, f"{_value}ull")


@wp.func_native(_MARK)
def mark_face(
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    size: int,
    b: int,
    f: int,
    marks: wp.array4d(dtype=wp.int64),
):
    """The marks of one face of one image."""
    ...


@wp.kernel
def _mark(
    first: int,
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    size: int,
    marks: wp.array4d(dtype=wp.int64),
):
    task = first + wp.tid()
    mark_face(textures, light, size, task // textures.shape[1], task % textures.shape[1], marks)
