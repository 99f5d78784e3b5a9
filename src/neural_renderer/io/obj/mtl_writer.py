"""Writing of the materials of MTL files."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..surface_colors import FileTexture

_SLOTS = {"specular": "map_Ks", "emissive": "map_Ke", "opacity": "map_d", "normal": "norm"}


def statements(
    name: str, own: dict[str, Any], color: np.ndarray, picture: str | None, clamp: bool, images: str
) -> tuple[str, dict[str, np.ndarray]]:
    """Format a material.

    Args:
        name: Name of the material.
        own: Arguments of a `Material`, with a `FileTexture` for each texture.
        color: [3], colour of faces without an image, sRGB.
        picture: Name of the image of the diffuse colour, or None.
        clamp: Whether this image is clamped.
        images: Beginning of the names of the other images.

    Returns:
        The statements, and the other images by file name, [H, W, 1 or 3] each.
    """
    base = np.asarray(own.get("base_color", (1.0, 1.0, 1.0)), dtype=np.float64).clip(0, 1)
    diffuse = _srgb(base) * color
    lines = [f"newmtl {name}", f"Ka {_words(diffuse)}", f"Kd {_words(diffuse)}"]
    specular = np.asarray(own.get("specular", (0.0, 0.0, 0.0)))
    shiny = specular.any()
    lines.append(f"Ks {_words(specular)}")
    if shiny:
        lines.append(f"Ns {_words([own.get('shininess', 10.0)])}")
    if np.any(own.get("emissive", 0.0)):
        lines.append(f"Ke {_words(own['emissive'])}")
    opaque = own.get("alpha_mode", "OPAQUE") == "OPAQUE"
    lines += [f"d {_words([1.0 if opaque else own.get('opacity', 1.0)])}", f"illum {2 if shiny else 1}"]
    for key, word, default in (("metallic", "Pm", 0.0), ("roughness", "Pr", 1.0)):
        if own.get(key, default) != default or own.get("metallic_roughness_texture") is not None:
            lines.append(f"{word} {_words([own.get(key, default)])}")
    if picture is not None:
        lines.append(f"map_Kd {'-clamp on ' if clamp else ''}{picture}")
    files: dict[str, np.ndarray] = {}

    def add(slot: str, word: str, texture: FileTexture | None, pixels: np.ndarray | None = None) -> None:
        if texture is not None:
            files[f"{images}_{slot}.png"] = texture.image if pixels is None else pixels
            bump = f"-bm {own.get('normal_scale', 1.0):.9g} " if word == "norm" else ""
            lines.append(f"{word} {bump}{_options(texture)}{images}_{slot}.png")

    for slot, word in _SLOTS.items():
        if slot != "opacity" or not opaque:
            add(slot, word, own.get(f"{slot}_texture"))
    packed: FileTexture | None = own.get("metallic_roughness_texture")
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


def _srgb(colors: np.ndarray) -> np.ndarray:
    """Convert linear colours to sRGB."""
    return np.where(colors <= 0.0031308, colors * 12.92, 1.055 * np.maximum(colors, 1e-9) ** (1 / 2.4) - 0.055)
