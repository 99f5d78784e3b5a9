"""Meshes whose colour is images seen through texture coordinates, as artists and files have it."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.nn import functional

from .. import validate
from ..io.formats import read_mesh
from ..io.mesh_writer import save_painted
from ..io.surface_colors import Skin
from ..textures.gutters import fill_gutters
from ..textures.sample_texture import checked_wrap, sampled
from .mesh import centred

if TYPE_CHECKING:
    from ..deferred import Fragments


@dataclass(frozen=True, eq=False)
class UVMesh:
    """A mesh with images as its albedo, to be sampled at every pixel and not baked into cubes.

    `render` and `fragments` draw it. Replace a tensor by one that asks for gradients (``dataclasses.replace``) to fit
    it.

    Attributes:
        vertices: [V, 3] float32. faces: [F, 3] int32.
        uv: [F, 3, 2] float32, where each face's corners lie on its image: u to the right, v up, the image over [0, 1]².
        image_index: [F] int64, the number of the face's image; -1 where it has none.
        images: [H, W, 3] float32 each, row 0 at the top.
        colors: [F, 3, 3] float32, the RGB of the corners of faces without an image.
        wraps: for each image what lies beyond [0, 1], as in `sample_texture`.

    >>> mesh = UVMesh.load("spot.obj")                                          # doctest: +SKIP
    >>> images = render(mesh, Camera.look_at((0, 1, -2.7), viewing_angle=30))   # doctest: +SKIP
    >>> mesh.save("spot.glb")                                                   # doctest: +SKIP
    """

    vertices: Tensor
    faces: Tensor
    uv: Tensor
    image_index: Tensor
    images: tuple[Tensor, ...]
    colors: Tensor
    wraps: tuple[str, ...]

    @classmethod
    def load(cls, path: str | os.PathLike[str], grey: float = 0.5, allow_outside: bool = False) -> UVMesh:
        """Read an OBJ, PLY, STL, OFF, GLB or glTF file with its materials, unbaked, to the CPU.

        What lies between an image's charts, which mipmaps would mix into their borders, is filled with the colours
        around it (`fill_gutters`). A file without colour is ``grey``. Images of GLB and glTF repeat beyond [0, 1],
        whatever the file's samplers say. An image that several materials share is one of ``images``. ``allow_outside``
        and what is raised are those of `load_mesh`.
        """
        vertices, faces, skin, _ = read_mesh(path, allow_outside)
        skin = skin or Skin.plain(len(faces), validate.number("grey", grey))
        uv = torch.from_numpy(skin.uv).float()
        index = torch.from_numpy(skin.image).long()
        wraps = tuple("repeat" if wrapping == "REPEAT" else "clamp" for wrapping in skin.wrapping)
        images = [
            fill_gutters(torch.from_numpy(image).float(), uv[index == number], wrap=wrap)
            for number, (image, wrap) in enumerate(zip(skin.images, wraps, strict=True))
        ]
        return cls(
            vertices=torch.from_numpy(vertices).float(),
            faces=torch.from_numpy(faces).int(),
            uv=uv,
            image_index=index,
            images=tuple(images),
            colors=torch.from_numpy(skin.colors),
            wraps=wraps,
        )

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the mesh as OBJ or as GLB, where images repeat beyond [0, 1]; colours are clamped to [0, 1].

        Beside ``spot.obj`` come ``spot.mtl`` and ``spot_texture.png``, or ``spot_texture_1.png`` and so on. The faces
        of each image come together; those without one get one together, with a tile for each.

        Args:
            path: Ends in ``.obj`` or ``.glb``; missing folders are made. A file of that name is replaced.
            overwrite: Replace the files beside an OBJ whoever made them; otherwise only those that were written with
                an OBJ of this name before. So a model from elsewhere keeps its materials and images.

        Raises:
            TypeError, ValueError: Another suffix, NaN, and tensors that do not fit together.
            FileExistsError: A file beside an OBJ would be replaced that was not written with it.
            OSError: The files cannot be written. All that was there before stays.
        """
        self._check(always=True)
        skin = Skin(
            self.colors.detach().float().cpu().numpy(),
            self.image_index.long().cpu().numpy(),
            self.uv.detach().double().cpu().numpy(),
            [image.detach().float().cpu().numpy() for image in self.images],
            ["REPEAT" if wrap == "repeat" else "CLAMP_TO_EDGE" for wrap in self.wraps],
        )
        save_painted(path, self.vertices, self.faces, skin, overwrite=overwrite)

    def shade(self, seen: Fragments) -> Tensor:
        """The albedo [B, H, W, 3] float32 of what is seen of this mesh, each image filtered by its mipmaps.

        Gradients reach images, colors and, with ``gradient="edge"``, the vertices by what moves under the pixels. Where
        the images' charts do not match, colours jump at their seams: `Fragments.composite` has to be told (``seams``).
        Raises ValueError if ``seen`` is of a mesh with another number of faces.
        """
        self._check()
        count = len(self.uv)
        corners = torch.arange(3 * count, device=self.uv.device).view(count, 3)
        plain = self.image_index < 0
        parts = []  # each 0 where another one is seen
        if not self.images or bool(plain.any()):
            parts.append(seen.interpolate((self.colors * plain[:, None, None]).reshape(-1, 3), corners))
        if self.images:
            uv = seen.interpolate(self.uv.reshape(-1, 2), corners)
            shown = None
            if len(self.images) > 1 or parts:
                # One more than there are faces: -1, which is no face, finds the last.
                shown = torch.cat((self.image_index, self.image_index.new_tensor([-1])))[seen.face_index.long()]
            for number, (image, wrap) in enumerate(zip(self.images, self.wraps, strict=True)):
                own = seen.face_index if shown is None else torch.where(shown == number, seen.face_index, -1)
                parts.append(sampled(image[None].float(), uv, own, wrap))
        return parts[0] if len(parts) == 1 else torch.stack(parts).sum(0)

    def _check(self, always: bool = False) -> None:
        """TypeError or ValueError unless all parts fit together; values are checked as `validate.finite` does it."""
        count = len(self.faces)
        for name, value, shape in (("uv", self.uv, (count, 3, 2)), ("colors", self.colors, (count, 3, 3))):
            validate.finite(name, validate.floating(name, value, shape).float(), always)
        validate.indices("image_index", self.image_index, (count,))
        for name, several in (("images", self.images), ("wraps", self.wraps)):
            if not isinstance(several, (tuple, list)):
                raise TypeError(f"{name}: expected a tuple, got {type(several).__name__}")
        for image in self.images:
            validate.finite("images", validate.floating("images", image, ("H", "W", 3)), always)
            if not image.numel():
                raise ValueError(f"images: expected at least one pixel in each, got {validate.shape_of(image)}")
        if len(self.wraps) != len(self.images):
            raise ValueError(f"wraps: expected {len(self.images)} like images, got {len(self.wraps)}")
        for wrap in self.wraps:
            checked_wrap(wrap)
        if count and (always or validate.values_are_checked(self.image_index)):
            low, high = (int(value) for value in torch.aminmax(self.image_index))
            if low < -1 or high >= len(self.images):
                wrong = low if low < -1 else high
                raise ValueError(f"image_index: expected one of {len(self.images)} images or -1, got {wrong}")

    def normalize(self) -> UVMesh:
        """The same, centred at the origin and its longest side from -1 to 1; see `Mesh.normalize`."""
        return replace(self, vertices=centred(self.vertices).float())

    def resized(self, side: int) -> UVMesh:
        """The same with all images of ``side`` x ``side`` pixels, filtered; where they lie on the mesh stays."""
        size = (validate.whole("side", side, 1),) * 2
        images = [image.movedim(2, 0)[None] for image in self.images]
        resized = [functional.interpolate(image, size, mode="bilinear", antialias=True) for image in images]
        return replace(self, images=tuple(image[0].movedim(0, 2).contiguous() for image in resized))

    def to(self, device: torch.device | str) -> UVMesh:
        """The same with all tensors on ``device``."""

        def moved(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(moved, value))
            return value.to(device) if isinstance(value, Tensor) else value

        return replace(self, **{part.name: moved(getattr(self, part.name)) for part in fields(self)})
