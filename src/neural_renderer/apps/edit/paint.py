"""Colours that an edit optimises: texels of faces, or pixels of texture images."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor
from torch.nn import functional

from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ...textures.color_space import tinted
from ...textures.gutters import fill_gutters
from ..common.texels import Texels

_MOST_BYTES = 2 * 2**30  # memory of colours; gradients, Adam's moments and temporary copies take several times as much
_BYTES = 12  # bytes of an RGB colour in float32


class Paint(Protocol):
    """Parameters of a texture, colours [count, 3] in [0, 1], and how to apply them to a mesh."""

    count: int

    def initial(self) -> Tensor:
        """Return the mesh's own colours, [count, 3]."""
        ...

    def apply(self, vertices: Tensor, colors: Tensor) -> UVMesh | tuple[Tensor, ...]:
        """Make a mesh for `render` from vertices [V, 3] and colours [count, 3]; differentiable in both."""
        ...

    def finish(self, vertices: Tensor, colors: Tensor, known: Tensor) -> Mesh | UVMesh:
        """Make the resulting mesh; colours that are not ``known`` [count] are filled from adjacent ones."""
        ...

    def unpainted(self, vertices: Tensor) -> UVMesh | tuple[Tensor, Tensor, Tensor]:
        """Make a mesh for `render` with its original texture."""
        ...


class FacePaint:
    """Texels of texture cubes, for faces [F, 3] as indices of merged vertices."""

    def __init__(self, mesh: Mesh, corners: Tensor, size: int, seamless: bool) -> None:
        check_cubes(len(corners), size)
        self._mesh, self._texels = mesh, (Texels.shared if seamless else Texels.separate)(corners, size)
        self.count = self._texels.count

    def initial(self) -> Tensor:
        size = self._texels.size
        if self._mesh.texture_size != size:
            raise ValueError(f"mesh: expected textures of {size}³ texels, got {self._mesh.texture_size}³")
        return self._texels.from_cubes(self._mesh.cubes().detach())

    def apply(self, vertices: Tensor, colors: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return vertices, self._mesh.faces, self._texels.cubes(colors)

    def finish(self, vertices: Tensor, colors: Tensor, known: Tensor) -> Mesh:
        return Mesh(*self.apply(vertices, self._texels.fill_unknown(colors, known)))

    def unpainted(self, vertices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return vertices, self._mesh.faces, self._mesh.cubes().detach()


class ImagePaint:
    """Pixels of a mesh's texture images, slightly blurred, and corner colours of faces without an image.

    Faces ``corners`` [F, 3] are indices of merged vertices. Faces without an image share equal colours at a vertex.
    """

    def __init__(self, mesh: UVMesh, corners: Tensor) -> None:
        mesh = _without_tints(mesh)
        self._mesh = mesh
        self._plain = mesh.image_index < 0
        colors = mesh.colors.detach()[self._plain].reshape(-1, 3)
        keys = torch.cat((corners[self._plain].reshape(-1, 1).double(), colors.double()), 1)
        unique, corner = torch.unique(keys, dim=0, return_inverse=True)
        self._corner, self._colors = corner.view(-1, 3), unique[:, 1:].float()
        self._sizes = [image.shape[0] * image.shape[1] for image in mesh.images] + [len(unique)]
        self.count = sum(self._sizes)
        _check_colors(self.count, f"{len(mesh.images)} images of {self.count} pixels in all", "choose smaller images")

    def initial(self) -> Tensor:
        return torch.cat([*(image.reshape(-1, 3) for image in self._mesh.images), self._colors]).detach()

    def apply(self, vertices: Tensor, colors: Tensor) -> UVMesh:
        *pixels, plain = colors.split(self._sizes)
        images = tuple(_blur(new.view_as(old)) for new, old in zip(pixels, self._mesh.images, strict=True))
        corner_colors = self._mesh.colors
        if len(plain):
            corner_colors = corner_colors.index_put((self._plain,), plain[self._corner])
        return replace(self._mesh, vertices=vertices, images=images, colors=corner_colors)

    def finish(self, vertices: Tensor, colors: Tensor, known: Tensor) -> UVMesh:
        mesh = self.apply(vertices, colors)
        known_pixels = known.split(self._sizes)[:-1]
        filled = [
            fill_gutters(image, mesh.uv[mesh.image_index == number], mask.view(image.shape[:2]), wrap=wrap)
            for number, (image, mask, wrap) in enumerate(zip(mesh.images, known_pixels, mesh.wraps, strict=True))
        ]
        return replace(mesh, images=tuple(filled))

    def unpainted(self, vertices: Tensor) -> UVMesh:
        return replace(self._mesh, vertices=vertices)


def _without_tints(mesh: UVMesh) -> UVMesh:
    """Put the tints of faces without an image into their colours, which are painted."""
    if mesh.tints is None:
        return mesh
    plain = (mesh.image_index < 0)[:, None, None]
    colors = torch.where(plain, tinted(mesh.colors, mesh.tints[..., :3]), mesh.colors)
    kept = torch.cat((torch.where(plain, 1.0, mesh.tints[..., :3]), mesh.tints[..., 3:]), -1)
    return mesh.replace(colors=colors.detach(), tints=kept)


def _blur(image: Tensor) -> Tensor:
    """Blur an image [H, W, C] with the kernel 1 : 2 : 1 along both sides.

    If texels are smaller than the pixels of the rendered images, no loss restrains differences between adjacent texels.
    Without the blur they would remain as grain.
    """
    padded = functional.pad(image.movedim(2, 0)[None], (1, 1, 1, 1), mode="replicate")
    return functional.avg_pool2d(functional.avg_pool2d(padded, 2, 1), 2, 1)[0].movedim(0, 2)


def check_images(count: int, side: int) -> None:
    """Raise ValueError if ``count`` images of side² pixels take more than 2 GiB."""
    _check_colors(count * side**2, f"{count} images of {side}² pixels", "choose smaller images")


def check_cubes(faces: int, size: int) -> None:
    """Raise ValueError if texture cubes of size³ texels for this number of faces take more than 2 GiB."""
    advice = "choose a smaller texture size, or a mesh with fewer faces (for example by Blender's Decimate modifier)"
    _check_colors(faces * size**3, f"{faces} faces of {size}³ texels", advice)


def _check_colors(count: int, what: str, advice: str) -> None:
    needed = count * _BYTES
    if needed > _MOST_BYTES:
        raise ValueError(
            f"mesh: expected textures of at most {_MOST_BYTES / 2**30:.0f} GiB, got {needed / 2**30:.1f} GiB ({what}); "
            f"{advice}"
        )
