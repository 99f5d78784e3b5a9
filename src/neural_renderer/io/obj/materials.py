"""Materials of OBJ files from the statements of MTL files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..files import fits_float32
from ..surface_colors import FileTexture
from .mtl import Map, Material

_SAME = 1 / 255  # difference of the channels of a grey image


def material_arguments(
    name: str, material: Material, base: Map | None, image: Callable[[Map], np.ndarray | None]
) -> dict[str, Any]:
    """Collect the arguments of a `Material`, with a `FileTexture` in place of each texture.

    Args:
        name: Name of the material.
        material: Content of the MTL file.
        base: Image of the diffuse colour, whose scale and offset the mesh's texture coordinates have; or None.
        image: Function that loads an image, [H, W, 3 or 4]; None if it is missing.
    """
    numbers, colors, maps = material.numbers, material.colors, material.maps
    opacity = numbers.get("opacity", 1.0)
    result: dict[str, Any] = {
        "name": name,
        "opacity": opacity,
        "metallic": numbers.get("metallic", 0.0),
        "roughness": numbers.get("roughness", 1.0),
        "specular": tuple(colors.get("specular", np.zeros(3)).tolist()),
        "shininess": numbers.get("shininess", 10.0),
        "emissive": tuple(colors.get("emissive", np.zeros(3)).tolist()),
    }

    def add(argument: str, used: str, convert: Callable[[np.ndarray], np.ndarray]) -> None:
        pixels = image(maps[used]) if used in maps else None
        if pixels is not None:
            result[argument] = _texture(convert(pixels), maps[used], base)

    add("specular_texture", "specular", _color)
    if "specular_texture" in result and "specular" not in colors:
        result["specular"] = (1.0, 1.0, 1.0)
    add("emissive_texture", "emissive", _color)
    if "emissive_texture" in result and "emissive" not in colors:
        result["emissive"] = (1.0, 1.0, 1.0)
    add("opacity_texture", "opacity", _alpha)
    if opacity < 1 or "opacity_texture" in result:
        result["alpha_mode"] = "BLEND"
    if "normal" in maps:
        add("normal_texture", "normal", _color)
        result["normal_scale"] = maps["normal"].bump
    elif "bump" in maps:
        _add_bump(result, maps["bump"], image(maps["bump"]), base)
    _add_metallic_roughness(result, material, base, image)
    return result


def _add_bump(result: dict[str, Any], used: Map, pixels: np.ndarray | None, base: Map | None) -> None:
    """Add a normal map from a bump map, which holds heights if it is grey, else normals."""
    if pixels is None:
        return
    colors = _color(pixels)
    if np.abs(colors - colors[..., :1]).max() <= _SAME:
        result["normal_texture"] = _texture(_normals(colors[..., 0], used.bump), used, base)
    else:
        result["normal_texture"], result["normal_scale"] = _texture(colors, used, base), used.bump


def _add_metallic_roughness(
    result: dict[str, Any], material: Material, base: Map | None, image: Callable[[Map], np.ndarray | None]
) -> None:
    """Put the images of metallic and roughness into one, as glTF has them; only one sampler and size is kept."""
    found = [(n, material.maps[name]) for n, name in ((2, "metallic"), (1, "roughness")) if name in material.maps]
    packed: np.ndarray | None = None
    for channel, used in found:
        pixels = image(used)
        if pixels is None:
            continue
        packed = np.ones((*pixels.shape[:2], 3), np.float32) if packed is None else packed
        if packed.shape[:2] == pixels.shape[:2]:
            packed[..., channel] = pixels[..., 0]
            name = "metallic" if channel == 2 else "roughness"
            result[name] = material.numbers.get(name, 1.0)
    if packed is not None:
        result["metallic_roughness_texture"] = _texture(packed, found[0][1], base)


def _texture(pixels: np.ndarray, used: Map, base: Map | None) -> FileTexture:
    """Describe a texture relative to the mesh's coordinates, which have the scale and offset of the base colour."""
    scale, offset = np.array(used.scale), np.array(used.offset)
    if base is not None and (base.scale, base.offset) != (used.scale, used.offset):
        own = np.array(base.scale)
        scale = scale / np.where(own == 0, 1, own)
        offset = offset - np.array(base.offset) * scale
    elif base is not None:
        scale, offset = np.ones(2), np.zeros(2)
    if not (fits_float32(scale).all() and fits_float32(offset).all()):
        scale, offset = np.ones(2), np.zeros(2)
    # In glTF's terms, with v down: 1 − (s v + o) = s (1 − v) + 1 − s − o.
    down = (float(offset[0]), float(1 - scale[1] - offset[1]))
    return FileTexture(pixels, "clamp" if used.clamp else "repeat", down, (float(scale[0]), float(scale[1])))


def _color(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels[..., :3])


def _alpha(pixels: np.ndarray) -> np.ndarray:
    """Take the alpha channel of an image if it has one, else its brightness."""
    return np.ascontiguousarray(pixels[..., 3:] if pixels.shape[2] == 4 else pixels.mean(-1, keepdims=True))


def _normals(heights: np.ndarray, factor: float) -> np.ndarray:
    """Convert heights [H, W] in texels, row 0 at the top, to a normal map by differences; the image repeats."""
    right = np.roll(heights, -1, 1) - np.roll(heights, 1, 1)
    up = np.roll(heights, 1, 0) - np.roll(heights, -1, 0)
    slopes = np.stack((-0.5 * factor * right, -0.5 * factor * up, np.ones_like(heights)), -1)
    return (0.5 + 0.5 * slopes / np.linalg.norm(slopes, axis=-1, keepdims=True)).astype(np.float32)
