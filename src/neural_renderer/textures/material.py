"""`Material` and `Texture`: how the surface of a mesh reflects, emits and passes light, in the terms of glTF 2.0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..base import validate
from ..base.constants import read_once
from ..base.movable import Movable
from ..base.one_line import OneLine
from ..io.images import as_image
from ..io.surface_colors import FileTexture
from ..raster.warp.registration import of_constants
from .sample_texture import Wrap, checked_wrap, sample_texture

ALPHA_MODES = ("OPAQUE", "MASK", "BLEND")


@dataclass(frozen=True, eq=False, repr=False)
class Texture(OneLine, Movable):
    """Image with its sampler and the transform of its texture coordinates.

    Attributes:
        image: [H, W, C] floating, row 0 at the top. `Material` says how many channels, and which of them are sRGB.
        wrap: "repeat", "clamp" or "mirror", or two of them, for u and for v.
        offset, scale, rotation: Transform of ``KHR_texture_transform``: numbers or tensors [2], [2] and [], the
            rotation in radians. It is defined for glTF's coordinates, v down: (u, 1 − v) is scaled, rotated, then
            moved.
        uv_set: 0 for ``UVMesh.uv``, 1, 2, … for the sets of ``UVMesh.uv1``.

    Raises:
        TypeError, ValueError: An attribute does not fit.

    Example:
        >>> texture = nr.Texture(torch.rand(8, 8, 3), wrap=("repeat", "clamp"), scale=(4.0, 1.0))
        >>> texture.sample(torch.rand(1, 16, 16, 2)).shape
        torch.Size([1, 16, 16, 3])
    """

    image: Tensor
    wrap: Wrap = "repeat"
    offset: Any = (0.0, 0.0)
    scale: Any = (1.0, 1.0)
    rotation: Any = 0.0
    uv_set: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "image", as_image("image", self.image))
        validate.floating("image", self.image, ("H", "W", "C"))
        if not self.image.numel():
            raise ValueError(f"image: expected at least one pixel, got {validate.shape_of(self.image)}")
        checked_wrap(self.wrap)
        for name, size in (("offset", 2), ("scale", 2), ("rotation", 0)):
            object.__setattr__(self, name, _factor(name, getattr(self, name), size))
        validate.whole("uv_set", self.uv_set, 0)

    def sample(self, uv: Tensor, face_index: Tensor | None = None) -> Tensor:
        """Sample the image at texture coordinates, after the transform.

        Args:
            uv: [B, H, W, 2] floating, u to the right and v up.
            face_index: As in `sample_texture`; with it, mipmaps are used.

        Returns:
            [B, H, W, C] float32, differentiable in the image, the coordinates and the transform.

        Raises:
            TypeError, ValueError: As `sample_texture`.

        Example:
            >>> nr.Texture(torch.ones(4, 4, 1)).sample(torch.rand(1, 2, 2, 2)).mean().item()
            1.0
        """
        return sample_texture(self.image, self.transformed(uv), face_index, wrap=self.wrap)

    def transformed(self, uv: Tensor) -> Tensor:
        """Transform texture coordinates.

        Args:
            uv: [..., 2] floating, v up.

        Returns:
            [..., 2], v up. The same tensor if there is no transform.

        Example:
            >>> nr.Texture(torch.ones(4, 4, 1), offset=(0.25, 0.0)).transformed(torch.tensor([0.5, 0.5]))
            tensor([0.7500, 0.5000])
        """
        if not self._has_transform():
            return uv
        offset, scale, rotation = (part.to(uv) for part in (self.offset, self.scale, self.rotation))
        u, v = uv[..., 0] * scale[0], (1 - uv[..., 1]) * scale[1]
        cosine, sine = rotation.cos(), rotation.sin()
        return torch.stack((cosine * u + sine * v + offset[0], 1 - (cosine * v - sine * u + offset[1])), -1)

    def _has_transform(self) -> bool:
        return of_constants(_moves, self.offset, self.scale, self.rotation) is not False


@dataclass(frozen=True, eq=False, repr=False)
class Material(OneLine, Movable):
    """Material of glTF 2.0 (metallic-roughness), with the highlight of MTL files.

    A `UVMesh` has several (``materials``), and an index for each face (``material_index``). The base colour is in
    the mesh: its ``images`` and ``colors``, in sRGB, with the factor of the file multiplied in. A ``base_color`` is one
    more factor. Both apply with every shading; the other attributes need ``shading`` or ``layers`` of `render`.

    Factors are numbers or tensors, and become float32 tensors, which keep their gradients. To optimise one, give a
    tensor that requires gradients (``dataclasses.replace``). All factors are linear except ``specular``.

    Attributes:
        name: Name in the file.
        base_color: [3], factor of the mesh's images and colours in linear RGB; 1 in materials from files.
        opacity: [], alpha in [0, 1], and a factor of ``opacity_texture``.
        opacity_texture: [H, W, 1], linear: the alpha channel of glTF's base colour, or MTL's ``map_d``.
        alpha_mode: "OPAQUE" ignores alpha; "MASK" cuts out what is below ``alpha_cutoff``; "BLEND" blends.
        alpha_cutoff: Least alpha of a visible point, for "MASK".
        metallic: [], 0 for dielectrics, 1 for metals; a factor of the texture's blue channel.
        roughness: [], in [0, 1], perceptual (its square is the α of GGX); a factor of the texture's green channel.
        metallic_roughness_texture: [H, W, 3], linear.
        emissive: [3], linear RGB, may exceed 1; a factor of ``emissive_texture``.
        emissive_texture: [H, W, 3], sRGB.
        occlusion_texture: [H, W, C], linear; the first channel is the fraction of ambient light that arrives.
        occlusion_strength: [], in [0, 1]; 0 ignores the texture.
        normal_texture: [H, W, 3], linear: 2 · RGB − 1 is the normal in the tangent space of u, v (up) and the surface.
        normal_scale: [], factor of the normal's x and y.
        specular: [3], colour of the highlight of Phong and Blinn-Phong shading, MTL's ``Ks``, as in the file.
        specular_texture: [H, W, 3], as ``specular``, which is its factor; MTL's ``map_Ks``.
        shininess: [], exponent of that highlight, MTL's ``Ns``.
        double_sided: Whether faces are visible from behind, where their normals are turned round.
        unlit: Whether light leaves the base colour as it is, with every shading (``KHR_materials_unlit``).

    Raises:
        TypeError, ValueError: An attribute does not fit.

    Example:
        >>> gold = nr.Material("gold", base_color=(1.0, 0.77, 0.34), metallic=1.0, roughness=0.3)
        >>> glass = nr.Material("glass", opacity=torch.tensor(0.3, requires_grad=True), alpha_mode="BLEND")
    """

    name: str = ""
    base_color: Any = (1.0, 1.0, 1.0)
    opacity: Any = 1.0
    opacity_texture: Texture | None = None
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    metallic: Any = 0.0
    roughness: Any = 1.0
    metallic_roughness_texture: Texture | None = None
    emissive: Any = (0.0, 0.0, 0.0)
    emissive_texture: Texture | None = None
    occlusion_texture: Texture | None = None
    occlusion_strength: Any = 1.0
    normal_texture: Texture | None = None
    normal_scale: Any = 1.0
    specular: Any = (0.0, 0.0, 0.0)
    specular_texture: Texture | None = None
    shininess: Any = 10.0
    double_sided: bool = True
    unlit: bool = False

    def __post_init__(self) -> None:
        for name, size in _FACTORS.items():
            object.__setattr__(self, name, _factor(name, getattr(self, name), size))
        for name, channels in _CHANNELS.items():
            texture = getattr(self, name)
            if texture is None:
                continue
            if not isinstance(texture, Texture):
                raise TypeError(f"{name}: expected a Texture or None, got {type(texture).__name__}")
            if channels is not None and texture.image.shape[2] != channels:
                raise ValueError(f"{name}: expected [H, W, {channels}], got {validate.shape_of(texture.image)}")
        if self.alpha_mode not in ALPHA_MODES:
            raise ValueError(f"alpha_mode: expected one of {', '.join(ALPHA_MODES)}, got {self.alpha_mode!r}")
        object.__setattr__(self, "alpha_cutoff", validate.number("alpha_cutoff", self.alpha_cutoff))
        validate.flag("double_sided", self.double_sided)
        validate.flag("unlit", self.unlit)

    @property
    def is_tinted(self) -> bool:
        """Whether the base colour may differ from 1."""
        return of_constants(lambda color: read_once(color, _differs_from_one), self.base_color) is not False

    def textures(self) -> dict[str, Texture]:
        """Collect the textures that the material has.

        Returns:
            The textures, by the names of their attributes.

        Example:
            >>> list(nr.Material(opacity_texture=nr.Texture(torch.rand(8, 8, 1))).textures())
            ['opacity_texture']
        """
        return {name: texture for name in _CHANNELS if (texture := getattr(self, name)) is not None}


def materials_of_file(materials: Sequence[dict[str, Any]]) -> tuple[Material, ...]:
    """Convert the materials of `SurfaceColors`."""
    images: dict[int, Tensor] = {}  # textures that share an array share a tensor

    def value(part: Any) -> Any:
        if not isinstance(part, FileTexture):
            return part
        image = images.setdefault(id(part.image), torch.from_numpy(part.image).float())
        return Texture(image, *part[1:])

    return tuple(Material(**{name: value(part) for name, part in one.items()}) for one in materials)


def arrays_of_materials(materials: Sequence[Material]) -> list[dict[str, Any]]:
    """Convert materials to those of `SurfaceColors`."""
    images: dict[int, np.ndarray] = {}

    def value(part: Any) -> Any:
        if isinstance(part, Texture):
            image = images.setdefault(id(part.image), part.image.detach().float().cpu().numpy())
            offset, scale = (tuple(pair.tolist()) for pair in (part.offset, part.scale))
            return FileTexture(image, part.wrap, offset, scale, float(part.rotation), part.uv_set)
        return part.detach().cpu().tolist() if isinstance(part, Tensor) else part

    return [{one.name: value(getattr(material, one.name)) for one in fields(material)} for material in materials]


_FACTORS = {
    "base_color": 3,
    "opacity": 0,
    "metallic": 0,
    "roughness": 0,
    "emissive": 3,
    "occlusion_strength": 0,
    "normal_scale": 0,
    "specular": 3,
    "shininess": 0,
}
"""Factors, and their number of channels; 0 for one number."""

_CHANNELS = {
    "opacity_texture": 1,
    "metallic_roughness_texture": 3,
    "emissive_texture": 3,
    "occlusion_texture": None,
    "normal_texture": 3,
    "specular_texture": 3,
}
"""Textures, and their number of channels; None for any."""


def _factor(name: str, value: Any, size: int) -> Tensor:
    """Convert a number or ``size`` numbers to a float32 tensor; raise TypeError or ValueError otherwise."""
    shape = (size,) if size else ()
    if not isinstance(value, Tensor):
        try:
            value = torch.tensor(value, dtype=torch.float32)
        except (TypeError, ValueError, RuntimeError):
            raise TypeError(f"{name}: expected {size or 'a'} number{'s' * bool(size)}, got {value!r}") from None
    validate.finite(name, validate.floating(name, value, shape))
    return value.float()


def _moves(offset: Tensor, scale: Tensor, rotation: Tensor) -> bool:
    return bool(offset.any() or (scale != 1).any() or rotation != 0)


def _differs_from_one(color: Tensor) -> bool:
    return bool((color != 1).any())
