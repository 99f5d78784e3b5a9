"""MTL material files: their statements, read and written, and the arguments of a `Material`."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..files import fits_float32, read_text, short
from ..surface_colors import FileTexture, linear_to_srgb

# A pattern must not match the same text in two ways, or time grows with the square of a line's length.
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
# Options precede the file name; the name may contain spaces. -o, -s and -t take one to three numbers.
_OPTION = re.compile(
    rf"-(?P<name>o|s|t)(?P<numbers>(?:\s+{_NUMBER}(?=\s)){{1,3}})\s+"
    rf"|-mm\s+{_NUMBER}\s+{_NUMBER}\s+"
    r"|-(?P<word>blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s+(?P<value>\S+)\s+"
)
_TRAILING = re.compile(r"\s-(?:o|s|t|mm|blendu|blendv|cc|clamp|texres|bm|boost|imfchan|type|colorspace)\s.*$")

# Images of a material, by their statements; "bump" may hold heights or normals.
_MAPS = {
    "map_kd": "color",
    "map_ks": "specular",
    "map_ke": "emissive",
    "map_d": "opacity",
    "map_bump": "bump",
    "bump": "bump",
    "norm": "normal",
    "map_pm": "metallic",
    "map_pr": "roughness",
}
_COLORS = {"kd": "color", "ks": "specular", "ke": "emissive"}
_NUMBERS = {"ns": "shininess", "d": "opacity", "tr": "transparency", "pm": "metallic", "pr": "roughness"}
_WRITTEN = {"specular": "map_Ks", "emissive": "map_Ke", "opacity": "map_d", "normal": "norm"}
_SAME = 1 / 255  # difference of the channels of a grey image


@dataclass
class Map:
    """Image of a material, read at uv · scale + offset."""

    image: str  # file name
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False  # the border continues beyond [0, 1]; otherwise the image repeats
    bump: float = 1.0  # factor of heights, or of the slopes of normals


@dataclass
class Material:
    """Material of an MTL file."""

    folder: Path  # place of the file
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # Kd, Ks and Ke, [3] float64 in [0, 1]; Ke may exceed 1
    numbers: dict[str, float] = field(default_factory=dict)  # Ns, d (or 1 − Tr), Pm and Pr
    maps: dict[str, Map] = field(default_factory=dict)


def read_mtl(path: Path) -> dict[str, Material]:
    """Read the materials of an MTL file, by name. Raises ValueError, with file and line, for a wrong colour."""
    materials: dict[str, Material] = {}
    material = Material(path.parent)  # statements before the first newmtl are ignored
    for number, line in enumerate(read_text(path).split("\n"), 1):
        keyword, _, rest = line.strip().replace("\t", " ").partition(" ")
        keyword, rest = keyword.lower(), rest.strip()
        if keyword == "newmtl":
            material = materials[rest] = Material(path.parent)
        elif keyword in _COLORS and not rest.startswith(("spectral", "xyz")):
            color = _color(rest, 1 if keyword != "ke" else None)
            if color is not None:
                material.colors[_COLORS[keyword]] = color
            elif keyword == "kd":
                raise ValueError(f"{path}, line {number}: expected Kd and three finite numbers, got {short(rest)}")
        elif keyword in _NUMBERS:
            _read_number(material, _NUMBERS[keyword], rest)
        elif keyword in _MAPS and rest:
            material.maps[_MAPS[keyword]] = _map(rest)
    return materials


def _color(text: str, most: float | None) -> np.ndarray | None:
    """Parse the one or three numbers of a colour: [3] of at least 0; None if they are none."""
    words = text.partition("#")[0].split()[:3]
    try:
        color = np.array([float(word) for word in words])
    except ValueError:
        return None
    if len(color) not in (1, 3) or not np.isfinite(color).all() or not fits_float32(color.clip(0, most)).all():
        return None
    return np.broadcast_to(color.clip(0, most), 3)


def _read_number(material: Material, name: str, text: str) -> None:
    """Parse a number. Many exporters write other text than the format allows; it is ignored."""
    words = text.partition("#")[0].split()
    words = words[1:] if words[:1] == ["-halo"] else words
    try:
        value = float(words[0])
    except (ValueError, IndexError):
        return
    if not fits_float32(np.array(value)):
        return
    if name == "transparency":
        name, value = "opacity", 1 - value
    material.numbers[name] = max(0.0, value) if name == "shininess" else min(max(0.0, value), 1.0)


def _map(text: str) -> Map:
    """Parse the options and the file name of an image statement."""
    begin, result = 0, Map("")
    while option := _OPTION.match(text, begin):
        begin = option.end()
        numbers = [float(number) for number in (option["numbers"] or "").split()]
        if option["name"] == "s":
            result.scale = (numbers[0], numbers[1] if len(numbers) > 1 else 1.0)
        elif option["name"] == "o":
            result.offset = (numbers[0], numbers[1] if len(numbers) > 1 else 0.0)
        elif option["word"] == "clamp":
            result.clamp = option["value"] == "on"
        elif option["word"] == "bm" and re.fullmatch(_NUMBER, option["value"]):
            result.bump = float(option["value"])
    result.image = _TRAILING.sub("", text[begin:]).strip().strip('"')
    return result


def material_arguments(
    name: str, material: Material, base: Map | None, image: Callable[[Map], np.ndarray | None]
) -> dict[str, Any]:
    """Collect the arguments of a `Material`, with a `FileTexture` in place of each texture.

    ``base`` is the image of the diffuse colour, whose scale and offset the mesh's texture coordinates have, or None.
    ``image`` loads an image, [H, W, 3 or 4]; None if it is missing.
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

    for color in ("specular", "emissive"):
        add(f"{color}_texture", color, _rgb)
        if f"{color}_texture" in result and color not in colors:
            result[color] = (1.0, 1.0, 1.0)
    add("opacity_texture", "opacity", _alpha)
    if opacity < 1 or "opacity_texture" in result:
        result["alpha_mode"] = "BLEND"
    if "normal" in maps:
        add("normal_texture", "normal", _rgb)
        result["normal_scale"] = maps["normal"].bump
    elif "bump" in maps:
        _add_bump(result, maps["bump"], image(maps["bump"]), base)
    _add_metallic_roughness(result, material, base, image)
    return result


def _add_bump(result: dict[str, Any], used: Map, pixels: np.ndarray | None, base: Map | None) -> None:
    """Add a normal map from a bump map, which holds heights if it is grey, else normals."""
    if pixels is None:
        return
    colors = _rgb(pixels)
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
        base_scale = np.array(base.scale)
        scale = scale / np.where(base_scale == 0, 1, base_scale)
        offset = offset - np.array(base.offset) * scale
    elif base is not None:
        scale, offset = np.ones(2), np.zeros(2)
    if not (fits_float32(scale).all() and fits_float32(offset).all()):
        scale, offset = np.ones(2), np.zeros(2)
    # In glTF's terms, with v down: 1 − (s v + o) = s (1 − v) + 1 − s − o.
    down = (float(offset[0]), float(1 - scale[1] - offset[1]))
    return FileTexture(pixels, "clamp" if used.clamp else "repeat", down, (float(scale[0]), float(scale[1])))


def _rgb(pixels: np.ndarray) -> np.ndarray:
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


def statements(
    name: str, properties: dict[str, Any], color: np.ndarray, picture: str | None, clamp: bool, images: str
) -> tuple[str, dict[str, np.ndarray]]:
    """Format a material: return the statements, and images by file name, [H, W, 1 or 3] each, but that of the colour.

    ``properties`` are the arguments of a `Material`, with a `FileTexture` for each texture; ``color`` [3] is the sRGB
    colour of faces without an image. ``picture`` is the image of the diffuse colour; ``images`` is the prefix of the
    names of the others.
    """
    base = np.asarray(properties.get("base_color", (1.0, 1.0, 1.0)), dtype=np.float64).clip(0, 1)
    diffuse = linear_to_srgb(base) * color
    lines = [f"newmtl {name}", f"Ka {_words(diffuse)}", f"Kd {_words(diffuse)}"]
    specular = np.asarray(properties.get("specular", (0.0, 0.0, 0.0)))
    shiny = specular.any()
    lines.append(f"Ks {_words(specular)}")
    if shiny:
        lines.append(f"Ns {_words([properties.get('shininess', 10.0)])}")
    if np.any(properties.get("emissive", 0.0)):
        lines.append(f"Ke {_words(properties['emissive'])}")
    opaque = properties.get("alpha_mode", "OPAQUE") == "OPAQUE"
    lines += [f"d {_words([1.0 if opaque else properties.get('opacity', 1.0)])}", f"illum {2 if shiny else 1}"]
    for key, word, default in (("metallic", "Pm", 0.0), ("roughness", "Pr", 1.0)):
        if properties.get(key, default) != default or properties.get("metallic_roughness_texture") is not None:
            lines.append(f"{word} {_words([properties.get(key, default)])}")
    if picture is not None:
        lines.append(f"map_Kd {'-clamp on ' if clamp else ''}{picture}")
    files: dict[str, np.ndarray] = {}

    def add(slot: str, word: str, texture: FileTexture | None, pixels: np.ndarray | None = None) -> None:
        if texture is not None:
            files[f"{images}_{slot}.png"] = texture.image if pixels is None else pixels
            bump = f"-bm {properties.get('normal_scale', 1.0):.9g} " if word == "norm" else ""
            lines.append(f"{word} {bump}{_options(texture)}{images}_{slot}.png")

    for slot, word in _WRITTEN.items():
        if slot != "opacity" or not opaque:
            add(slot, word, properties.get(f"{slot}_texture"))
    packed: FileTexture | None = properties.get("metallic_roughness_texture")
    if packed is not None:
        add("metallic", "map_Pm", packed, packed.image[..., 2:3])
        add("roughness", "map_Pr", packed, packed.image[..., 1:2])
    return "\n".join(lines) + "\n", files


def _options(texture: FileTexture) -> str:
    """Format the sampler and the transform of a texture; MTL has neither rotations nor mirrored images."""
    wrap = (texture.wrap, texture.wrap) if isinstance(texture.wrap, str) else texture.wrap
    result = "-clamp on " if wrap == ("clamp", "clamp") else ""
    (u, v), (x, y) = texture.scale, texture.offset
    if (u, v) != (1.0, 1.0):
        result += f"-s {_words([u, v, 1.0])} "
    up = (x, 1 - v - y)  # in glTF v points down: s (1 − v) + o = 1 − (s v + 1 − s − o)
    return result + (f"-o {_words([*up, 0.0])} " if any(up) else "")


def _words(numbers: Any) -> str:
    return " ".join(f"{float(number) + 0.0:.9g}" for number in numbers)
