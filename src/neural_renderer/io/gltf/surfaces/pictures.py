"""Pictures of a glTF file, decoded once each."""

from __future__ import annotations

import hashlib
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...files import short
from ...image_formats.pictures import PictureSum
from ...images import decode_picture, unpack
from ...surface_colors import linear_to_srgb, srgb_to_linear
from ..accessors import Accessors, Resolve, uri_content
from ..decoders import KTX2, basis_picture
from ..tree import GltfError, extension, item, label

BASIS = "KHR_texture_basisu"
_FORMATS = ("EXT_texture_webp", "EXT_texture_avif")


class Pictures:
    """The images of a file as arrays [H, W, 3 or 4] float32 in [0, 1], display values as they are stored."""

    def __init__(self, tree: dict[str, Any], arrays: Accessors, resolve: Resolve) -> None:
        self._tree, self._arrays, self._resolve = tree, arrays, resolve
        self._pixels: dict[int, np.ndarray | None] = {}
        self._first: dict[bytes, int] = {}  # number of the first image of each content, by its hash
        self._same: dict[int, int] = {}  # that number for each image
        self._sum = PictureSum()
        self._made: dict[tuple[Any, ...], np.ndarray] = {}
        self._expected: set[tuple[Any, ...]] = set()
        self.warnings: list[str] = []

    def color(self, texture: int, factor: tuple[float, ...] = (1.0, 1.0, 1.0)) -> np.ndarray | None:
        """Return the RGB of a texture, multiplied by a factor of linear light; None if its file is missing."""
        number, pixels = self._of_texture(texture)
        if pixels is None:
            return None
        key = ("color", number, *factor)
        if key not in self._made:
            rgb = np.ascontiguousarray(pixels[..., :3])
            if min(factor) < 1:
                rgb = linear_to_srgb(srgb_to_linear(rgb) * np.array(factor)).astype(np.float32)
            self._made[key] = rgb
        return self._made[key]

    def expect(self, texture: int, factor: tuple[float, ...], is_converted: bool) -> None:
        """Count in advance the pictures that a material derives from a texture: a product by a factor, a conversion."""
        number, pixels = self._of_texture(texture)
        if pixels is not None:
            if min(factor) < 1 and (number, *factor) not in self._expected:
                self._expected.add((number, *factor))
                self._count(f"texture {texture}", pixels)
            if is_converted:
                self._count(f"texture {texture}", pixels)

    def alpha(self, texture: int) -> np.ndarray | None:
        """Return the alpha channel of a texture, [H, W, 1]; None if it has none."""
        number, pixels = self._of_texture(texture)
        if pixels is None or pixels.shape[2] < 4:
            return None
        if ("alpha", number) not in self._made:
            self._made["alpha", number] = np.ascontiguousarray(pixels[..., 3:])
        return self._made["alpha", number]

    def rgba(self, texture: int) -> np.ndarray | None:
        """Return the pixels of a texture, [H, W, 4]; None if its file is missing."""
        _, pixels = self._of_texture(texture)
        if pixels is None or pixels.shape[2] == 4:
            return pixels
        return np.concatenate((pixels, np.ones_like(pixels[..., :1])), 2)

    def _of_texture(self, number: int) -> tuple[int, np.ndarray | None]:
        """Decode the image of a texture: that of an extension, or the plain one where the library is missing."""
        texture = item(self._tree, "textures", number)
        for name in (BASIS, *_FORMATS):
            found = extension(texture, name)
            if found is not None:
                try:
                    return self._decoded(found.get("source"), name == BASIS)
                except ModuleNotFoundError:
                    if "source" not in texture:
                        raise
        if "source" not in texture:
            sentence = f"texture {number} has no image that can be read, so it is left out"
            self.warnings += [sentence] if sentence not in self.warnings else []
            return -1, None
        return self._decoded(texture["source"], False)

    def _decoded(self, number: Any, basis: bool) -> tuple[int, np.ndarray | None]:
        entry = item(self._tree, "images", number)
        if number not in self._same and number not in self._pixels:
            uri = str(entry.get("uri", "data:"))
            name = label(entry, "") if uri.startswith("data:") else short(unquote(uri))[1:-1]
            what = f"image {number}{f' ({name})' if name else ''}"
            try:
                content = self._content(what, entry)
                key = bytes([basis]) + hashlib.sha256(content).digest()
                if key not in self._first:
                    self._pixels[number] = self._unpacked(what, content, basis)
                self._same[number] = self._first.setdefault(key, number)
            except FileNotFoundError:  # whose reader warns
                self._pixels[number] = None
        number = self._same.get(number, number)
        return number, self._pixels[number]

    def _unpacked(self, what: str, content: bytes, basis: bool) -> np.ndarray:
        pixels = _unpacked(what, content, basis)
        self._count(what, pixels, len(content))
        return pixels

    def _count(self, what: str, pixels: np.ndarray, size: int = 0) -> None:
        """Count a picture that is read or made; GltfError if all together have too many pixels."""
        try:
            self._sum.add(what, pixels.shape[0] * pixels.shape[1], size)
        except ValueError as error:
            raise GltfError(str(error)) from None

    def _content(self, what: str, entry: dict[str, Any]) -> bytes:
        if "bufferView" in entry:
            return bytes(self._arrays.view(entry["bufferView"]))
        if "uri" not in entry:
            raise GltfError(f"{what}: expected a URI or a view, got {short(entry)}")
        return uri_content(what, entry["uri"], self._resolve)


def _unpacked(what: str, content: bytes, basis: bool) -> np.ndarray:
    if not basis and content.startswith(KTX2):
        raise GltfError(f"{what}: expected a picture, got KTX 2.0, which only textures with {BASIS} may have")
    try:
        return unpack(what, basis_picture(what, content)) if basis else decode_picture(what, content, "AVIF")
    except ValueError as error:
        raise GltfError(str(error)) from error
