"""Meshes whose colour is images seen through texture coordinates, as artists and files have it."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from . import validate
from .fragments import Fragments
from .io.formats import read_mesh
from .io.painted import save_painted
from .io.skin import Skin
from .mesh import centred
from .raster.rasterize import rasterize_images
from .uv import sample_texture


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
    def load(cls, path: str | os.PathLike[str], grey: float = 0.5) -> UVMesh:
        """Read an OBJ, PLY, STL, OFF, GLB or glTF file with its materials, unbaked, to the CPU.

        What lies between an image's charts, which mipmaps would mix into their borders, is filled with the colours
        around it (`fill_gutters`). A file without colour is ``grey``. Raises what `load_mesh` raises.
        """
        vertices, faces, skin, _ = read_mesh(path)
        skin = skin or Skin.plain(len(faces), validate.number("grey", grey))
        uv = torch.from_numpy(skin.uv).float()
        index = torch.from_numpy(skin.image).long()
        images = [torch.from_numpy(image).float() for image in skin.images]
        return cls(
            vertices=torch.from_numpy(vertices).float(),
            faces=torch.from_numpy(faces).int(),
            uv=uv,
            image_index=index,
            images=tuple(fill_gutters(image, uv[index == n]) for n, image in enumerate(images)),
            colors=torch.from_numpy(skin.colors),
            wraps=tuple("repeat" if wrapping == "REPEAT" else "clamp" for wrapping in skin.wrapping),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the mesh as OBJ, its materials and pictures beside it, or as GLB; colours are clamped to [0, 1].

        The faces of each image come together; those without one get one together, with a tile for each. Raises
        TypeError or ValueError for another suffix, NaN, and tensors that do not fit together.
        """
        count = len(self.faces)
        validate.floating("uv", self.uv, (count, 3, 2))
        validate.floating("colors", self.colors, (count, 3, 3))
        validate.indices("image_index", self.image_index, (count,))
        for name, value in {"uv": self.uv, "colors": self.colors}.items():
            validate.finite(name, value, always=True)
        for image in self.images:
            validate.floating("images", image, ("H", "W", 3))
            validate.finite("images", image, always=True)
        if len(self.image_index) and not -1 <= self.image_index.min() <= self.image_index.max() < len(self.images):
            raise ValueError(
                f"image_index: expected one of {len(self.images)} images or -1, got "
                f"{int(self.image_index.min())} to {int(self.image_index.max())}"
            )
        skin = Skin(
            self.colors.detach().float().cpu().numpy(),
            self.image_index.cpu().numpy(),
            self.uv.detach().double().cpu().numpy(),
            [image.detach().float().cpu().numpy() for image in self.images],
            ["REPEAT" if wrap == "repeat" else "CLAMP_TO_EDGE" for wrap in self.wraps],
        )
        save_painted(path, self.vertices, self.faces, skin)

    def shade(self, seen: Fragments) -> Tensor:
        """The albedo [B, H, W, 3] float32 of what is seen of this mesh, each image filtered by its mipmaps.

        Gradients reach images, colors and, with ``gradient="edge"``, the vertices by what moves under the pixels. Where
        the images' charts do not match, colours jump at their seams: `Fragments.composite` has to be told (``seams``).
        Raises ValueError if ``seen`` is of a mesh with another number of faces.
        """
        count = len(self.uv)
        corners = torch.arange(3 * count, device=self.uv.device).view(count, 3)
        plain = self.image_index < 0
        parts = []  # each 0 where another one is seen
        if not self.images or bool(plain.any()):
            parts.append(seen.interpolate((self.colors * plain[:, None, None]).reshape(-1, 3), corners))
        if self.images:
            uv = seen.interpolate(self.uv.reshape(-1, 2), corners)
            shown = self.image_index[seen.face_index.clamp(min=0).long()] if len(self.images) > 1 or parts else None
            for number, (image, wrap) in enumerate(zip(self.images, self.wraps, strict=True)):
                own = seen.face_index if shown is None else torch.where(shown == number, seen.face_index, -1)
                parts.append(sample_texture(image, uv, own, wrap=wrap))
        return parts[0] if len(parts) == 1 else torch.stack(parts).sum(0)

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


def fill_gutters(texture: Tensor, uv: Tensor, known: Tensor | None = None) -> Tensor:
    """The texture with every texel that no face shows replaced by a blend of those around it.

    texture: [h, w, C] floating. uv: [F, 3, 2] floating, the faces' corners on it, v up; beyond [0, 1] it repeats.
    known: [h, w] bool, where the texture has a colour: others are replaced too; None: everywhere. With no texel left to
        begin from, nothing is replaced.

    Mipmaps average over the borders of charts: with the gaps between them black, thin dark lines follow every seam.
    The gaps are filled from coarser and coarser means of what is shown, each over its own part alone, as in the
    pull-push algorithm (Gortler et al., "The Lumigraph", 1996, section 3.4). Returns [h, w, C] float32; gradients
    reach the texture. Raises TypeError or ValueError for other types or shapes.
    """
    validate.floating("texture", texture, ("h", "w", "C"))
    validate.floating("uv", uv, ("F", 3, 2))
    if known is not None and (known.shape != texture.shape[:2] or known.dtype != torch.bool):
        raise ValueError(
            f"known: expected bool {list(texture.shape[:2])} like the texture, got {validate.shape_of(known)}"
        )
    height, width = texture.shape[:2]
    with torch.no_grad():
        flat = uv.float() - uv.float().amin(1, keepdim=True).floor()
        # A chart that begins in one repetition of the image may end in the next: it is drawn in all four.
        shifts = [flat - flat.new_tensor(shift) for shift in ((0, 0), (1, 0), (0, 1), (1, 1))]
        corners = functional.pad(2 * torch.cat(shifts) - 1, (0, 1), value=1.0)[None]
        drawn = {"two_sided": True, "perspective": False, "anti_aliasing": False, "near": 0.5, "far": 2.0}
        shown = rasterize_images(corners, (height, width), outputs=("alpha",), **drawn).alpha[:, None]  # type: ignore[arg-type, index]
        if known is not None:
            shown = shown * known
        if not shown.any():
            return texture.float()
    return _pull_push(texture.float().permute(2, 0, 1)[None], shown)[0].permute(1, 2, 0).contiguous()


def _pull_push(image: Tensor, shown: Tensor) -> Tensor:
    """image [1, C, h, w] with what is not shown [1, 1, h, w] filled from the level above."""
    if image.shape[2:] == (1, 1) or not bool((shown == 0).any()):
        return image
    half = (-(-image.shape[2] // 2), -(-image.shape[3] // 2))
    share = functional.adaptive_avg_pool2d(shown, half)
    coarse = functional.adaptive_avg_pool2d(image * shown, half) / share.clamp(min=1e-6)
    coarse = _pull_push(coarse, (share > 0).float())
    above = functional.interpolate(coarse, size=image.shape[2:], mode="bilinear", align_corners=False)
    return torch.where(shown > 0, image, above)
