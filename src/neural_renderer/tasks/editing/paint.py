"""What an edit paints on: texels of a mesh's faces, or the images that its texture coordinates lead to."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor
from torch.nn import functional

from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ...textures.gutters import fill_gutters
from ..texels import Texels

_MOST_BYTES = 2 * 2**30  # of texels; gradients, Adam's means and temporary copies are several times that


class Paint(Protocol):
    """Colours [count, 3] in [0, 1], and what they make of a mesh."""

    count: int

    def first(self) -> Tensor:
        """The mesh's own."""
        ...

    def drawn(self, vertices: Tensor, colours: Tensor) -> UVMesh | tuple[Tensor, ...]:
        """What `render` draws, differentiable in the vertices [V, 3] and the colours."""
        ...

    def finished(self, vertices: Tensor, colours: Tensor, known: Tensor) -> Mesh | UVMesh:
        """The mesh to keep; where colours are not ``known`` [count] it has those around."""
        ...

    def unpainted(self, vertices: Tensor) -> UVMesh | tuple[Tensor, Tensor, Tensor]:
        """What `render` draws with the mesh's own colours as they are."""
        ...


class FacePaint:
    """Texture cubes of ``size``³ texels; neighbouring faces share those on their edges if ``seamless``.

    corners: [F, 3], the faces' vertices, with those that are at one place taken for one.
    """

    def __init__(self, mesh: Mesh, corners: Tensor, size: int, seamless: bool) -> None:
        check_cubes(len(corners), size)
        self._mesh, self._texels = mesh, (Texels.shared if seamless else Texels.separate)(corners, size)
        self.count = self._texels.count

    def first(self) -> Tensor:
        size = self._texels.size
        if self._mesh.texture_size != size:
            raise ValueError(f"mesh: expected textures of {size}³ texels, got {self._mesh.texture_size}³")
        return self._texels.from_cubes(self._mesh.textures.detach())

    def drawn(self, vertices: Tensor, colours: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return vertices, self._mesh.faces, self._texels.cubes(colours)

    def finished(self, vertices: Tensor, colours: Tensor, known: Tensor) -> Mesh:
        return Mesh(*self.drawn(vertices, self._texels.fill_unknown(colours, known)))

    def unpainted(self, vertices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return vertices, self._mesh.faces, self._mesh.textures.detach()


class ImagePaint:
    """The pixels of a mesh's images, a little smoothed, and of faces that have none the colours of their corners.

    corners: [F, 3] as for `FacePaint`: at a vertex, faces without an image share their colour if it is the same.
    """

    def __init__(self, mesh: UVMesh, corners: Tensor) -> None:
        self._mesh = mesh
        self._plain = mesh.image_index < 0
        colors = mesh.colors.detach()[self._plain].reshape(-1, 3)
        both = torch.cat((corners[self._plain].reshape(-1, 1).double(), colors.double()), 1)
        own, corner = torch.unique(both, dim=0, return_inverse=True)
        self._corner, self._colors = corner.view(-1, 3), own[:, 1:].float()
        self._sizes = [image.shape[0] * image.shape[1] for image in mesh.images] + [len(own)]
        self.count = sum(self._sizes)
        _check_texels(self.count, f"{len(mesh.images)} images of {self.count} pixels in all", "choose smaller images")

    def first(self) -> Tensor:
        return torch.cat([*(image.reshape(-1, 3) for image in self._mesh.images), self._colors]).detach()

    def drawn(self, vertices: Tensor, colours: Tensor) -> UVMesh:
        *pixels, plain = colours.split(self._sizes)
        images = tuple(_smooth(own.view_as(old)) for own, old in zip(pixels, self._mesh.images, strict=True))
        colors = self._mesh.colors
        if len(plain):
            colors = colors.index_put((self._plain,), plain[self._corner])
        return replace(self._mesh, vertices=vertices, images=images, colors=colors)

    def finished(self, vertices: Tensor, colours: Tensor, known: Tensor) -> UVMesh:
        mesh = self.drawn(vertices, colours)
        filled = [
            fill_gutters(image, mesh.uv[mesh.image_index == number], own.view(image.shape[:2]), wrap=wrap)
            for number, (image, own, wrap) in enumerate(
                zip(mesh.images, known.split(self._sizes)[:-1], mesh.wraps, strict=True)
            )
        ]
        return replace(mesh, images=tuple(filled))

    def unpainted(self, vertices: Tensor) -> UVMesh:
        return replace(self._mesh, vertices=vertices)


def _smooth(image: Tensor) -> Tensor:
    """The image [H, W, C] with each pixel mixed with its neighbours, 1 : 2 : 1 along both sides.

    Where pixels are smaller than those that a network sees, their differences are nobody's concern, and would stay as
    grain.
    """
    padded = functional.pad(image.movedim(2, 0)[None], (1, 1, 1, 1), mode="replicate")
    return functional.avg_pool2d(functional.avg_pool2d(padded, 2, 1), 2, 1)[0].movedim(0, 2)


def check_images(count: int, side: int) -> None:
    """ValueError if so many images of side² pixels would take more than 2 GiB."""
    _check_texels(count * side**2, f"{count} images of {side}² pixels", "choose smaller images")


def check_cubes(faces: int, size: int) -> None:
    """ValueError if textures of size³ texels for so many faces would take more than 2 GiB."""
    advice = "choose a smaller texture size, or a mesh of fewer faces (Blender's modifier Decimate makes one)"
    _check_texels(faces * size**3, f"{faces} faces of {size}³ texels", advice)


def _check_texels(count: int, what: str, advice: str) -> None:
    needed = count * 12
    if needed > _MOST_BYTES:
        raise ValueError(
            f"mesh: expected textures of at most {_MOST_BYTES / 2**30:.0f} GiB, got {needed / 2**30:.1f} GiB ({what}); "
            f"{advice}"
        )
