"""`UVMesh`: a mesh with images and texture coordinates."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.nn import functional

from .. import validate
from ..constants import read_once
from ..deprecated import old_argument
from ..io.formats import read_mesh
from ..io.mesh_writer import save_uv_mesh
from ..io.surface_colors import SurfaceColors
from ..textures.base_colors import tinted_by_materials
from ..textures.file_materials import arrays_of_materials, attributes_of_file, wrap_of, wrapping
from ..textures.gutters import fill_gutters
from ..textures.sample_texture import sampled
from .bounds import centered
from .pieces import chosen_faces, merged_vertices, used_vertices
from .subdivision import checked_levels, split_corners, subdivided
from .uv_data import FACE_ATTRIBUTES, UVMeshData, has_negative

if TYPE_CHECKING:
    from ..deferred import Fragments


@dataclass(frozen=True, eq=False, init=False, repr=False)
class UVMesh(UVMeshData):
    """Triangle mesh with images as albedo, sampled at every pixel.

    `render` and `fragments` draw it, and what takes a `Mesh` takes it, too. To optimise it, call `trainable`, or
    replace a tensor by one that requires gradients (``dataclasses.replace``). `batch` of several is a UVMesh whose
    vertices, faces and attributes of faces have a leading dimension [B, …]; it is for drawing only.

    ``UVMesh(vertices, faces, uv, image)`` is a mesh with one image; tensors keep their gradients. The long form
    ``UVMesh(vertices, faces, uv, image_index, images, colors, wraps)`` takes all attributes as they are.

    Args:
        vertices: [V, 3] floating tensor or array.
        faces: [F, 3] whole numbers.
        uv: [V, 2] for vertices, [F, 3, 2] for the faces' corners, or a pair: texture coordinates [U, 2] and indices
            into them [F, 3].
        image_index: The image [H, W, 3] floating, RGB in [0, 1], row 0 at the top; in the long form, the attribute.
        images, colors, wraps: The attributes; not in the short form.
        image: The image of the short form, by its name.
        wrap: As in `sample_texture`, in the short form.
        materials, material_index, normals, tangents, uv1: The attributes, in both forms.

    Attributes:
        vertices: [V, 3] float32.
        faces: [F, 3] int32, indices into the vertices.
        uv: [F, 3, 2] float32, texture coordinates of the faces' corners: u to the right, v up, the image over [0, 1]².
        image_index: [F] int64, index into ``images``; −1 for a face without an image.
        images: [H, W, 3] float32 each, RGB, row 0 at the top. Sizes may differ.
        colors: [F, 3, 3] float32, RGB at the corners of faces without an image.
        wraps: "repeat", "clamp" or "mirror" for each image, or a pair of them, as in `sample_texture`.
        materials: `Material` each: what ``shading`` and ``layers`` of `render` use, and base colours. Empty for a mesh
            that is matt and opaque.
        material_index: [F] int64, index into ``materials``; −1 for a face without a material, which looks as in a mesh
            without materials. None: all faces have the only material.
        normals: [F, 3, 3] float32, normals of the faces' corners, as in the file; or None.
        tangents: [F, 3, 4] float32, tangents of the corners, towards larger u, and the sign (1 or −1) of the bitangent
            sign · normal × tangent, towards larger v; or None.
        uv1: [F, 3, 2] float32, second texture coordinates of the corners, for textures with ``uv_set=1``; or None.

    Raises:
        TypeError, ValueError: In the short form, an argument that does not fit. In drawing or saving, attributes that
            do not fit together or are not finite.

    Example:
        >>> vertices, faces = nr.cube()
        >>> uv = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]).expand(12, 3, 2)
        >>> image = torch.rand(64, 64, 3, requires_grad=True)
        >>> cube = nr.UVMesh(vertices, faces, uv, image)
        >>> nr.render(cube, camera, 64).rgb.mean().backward()
    """

    @classmethod
    def load(cls, path: str | os.PathLike[str], grey: float = 0.5, allow_outside: bool = False) -> UVMesh:
        """Read a mesh file with its materials and images, to the CPU.

        The gaps between an image's charts are filled (`fill_gutters`). An image that several materials share appears
        once in ``images``. Materials of OBJ, GLB and glTF files, and the normals of the files, are read, too. Texture
        coordinates have the transform of the base colour's texture (``KHR_texture_transform``).

        Args:
            path: OBJ, PLY, STL, OFF, GLB or glTF file.
            grey: Colour of a mesh without colours, in [0, 1].
            allow_outside: Read materials and images outside the file's folder, too. Use it for trusted files only.

        Returns:
            The mesh, on the CPU.

        Raises:
            OSError, TypeError, ValueError: As `load_mesh`.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> nr.UVMesh.load("sphere.obj").uv.shape
            torch.Size([320, 3, 2])
        """
        grey = validate.number("grey", grey)
        vertices, faces, surface, _ = read_mesh(path, allow_outside, materials=True)
        surface = surface or SurfaceColors.plain(len(faces), grey)
        if not surface.has_colors:
            surface.colors[:] = grey
        uv = torch.from_numpy(surface.uv).float()
        index = torch.from_numpy(surface.image).long()
        wraps = tuple(map(wrap_of, surface.wrapping))
        images = [
            fill_gutters(torch.from_numpy(image).float(), uv[index == number], wrap=wrap)
            for number, (image, wrap) in enumerate(zip(surface.images, wraps, strict=True))
        ]
        return cls(
            vertices=torch.from_numpy(vertices).float(),
            faces=torch.from_numpy(faces).int(),
            uv=uv,
            image_index=index,
            images=tuple(images),
            colors=torch.from_numpy(surface.colors),
            wraps=wraps,
            **attributes_of_file(surface),
        )

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the mesh as OBJ or GLB, with colours clamped to [0, 1].

        With ``spot.obj`` this writes ``spot.mtl`` and ``spot_texture.png``, or ``spot_texture_1.png`` and so on. Faces
        are grouped by image and material; in OBJ files, those without an image share one more, with a tile for each.
        GLB files have no highlight of Phong. MTL files have neither transforms nor wraps of textures but the first, no
        occlusion, tangents, ``uv1``, ``double_sided`` or ``alpha_cutoff``: what is cut out ("MASK") is read as "BLEND".

        Args:
            path: Name that ends in ``.obj`` or ``.glb``. A file of this name is replaced, missing folders are made.
            overwrite: Replace any MTL and PNG beside an OBJ. By default only those are replaced that were written with
                an OBJ of this name, so that a foreign model keeps its materials and images.

        Raises:
            TypeError, ValueError: The suffix is unknown, a tensor does not fit, or a number is not finite.
            FileExistsError: The MTL or a PNG would replace a foreign file.
            OSError: A file cannot be written. All existing files stay as they were.

        Example:
            >>> nr.Mesh.icosphere(2).save("white.obj")
            >>> sphere = nr.UVMesh.load("white.obj")
            >>> sphere.save("sphere.glb")
        """
        self._check(always=True)
        surface = SurfaceColors(
            self.colors.detach().float().cpu().numpy(),
            self.image_index.long().cpu().numpy(),
            self.uv.detach().double().cpu().numpy(),
            [image.detach().float().cpu().numpy() for image in self.images],
            [wrapping(wrap) for wrap in self.wraps],
            **arrays_of_materials(self),
        )
        save_uv_mesh(path, self.vertices, self.faces, surface, overwrite=overwrite)

    @old_argument("seen", "fragments")
    @validate.checked_together
    def shade(self, fragments: Fragments) -> Tensor:
        """Sample the albedo of each pixel, with mipmaps and the base colours of materials.

        Gradients flow to ``images``, ``colors`` and base colours, and with ``gradient="edge"`` to ``vertices``. If
        adjacent charts differ in colour at their border, pass ``seams`` to `Fragments.composite`.

        Args:
            fragments: Fragments of this mesh; see `fragments`.

        Returns:
            [B, H, W, 3] float32, RGB.

        Raises:
            ValueError: ``fragments`` belongs to a mesh with another number of faces.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> sphere = nr.UVMesh.load("sphere.obj")
            >>> fragments = nr.fragments(sphere, camera, 64)
            >>> fragments.composite(sphere.shade(fragments)).shape
            torch.Size([1, 3, 64, 64])
        """
        self._check()
        albedo = self._shade_each(fragments) if self.uv.dim() == 4 else self._sampled(fragments)
        return tinted_by_materials(albedo, self.materials, self.material_index, fragments.face_index)

    def _sampled(self, fragments: Fragments) -> Tensor:
        """Sample images and colours at each pixel, [B, H, W, 3]."""
        count = len(self.uv)
        corners = torch.arange(3 * count, device=self.uv.device).view(count, 3)
        plain = self.image_index < 0
        parts = []  # images to add up; each is 0 where another one is visible
        # A compiled graph cannot ask for values; what it adds is 0 where no face is plain.
        if not self.images or torch.compiler.is_compiling() or read_once(self.image_index, has_negative):
            parts.append(fragments.interpolate((self.colors * plain[:, None, None]).reshape(-1, 3), corners))
        if self.images:
            uv = fragments.interpolate(self.uv.reshape(-1, 2), corners)
            shown = None
            if len(self.images) > 1 or parts:
                # Face −1 (background) reads the extra entry at the end.
                shown = torch.cat((self.image_index, self.image_index.new_full((1,), -1)))[fragments.face_index.long()]
            for number, (image, wrap) in enumerate(zip(self.images, self.wraps, strict=True)):
                own = fragments.face_index if shown is None else torch.where(shown == number, fragments.face_index, -1)
                parts.append(sampled(image[None].float(), uv, own, wrap))
        return parts[0] if len(parts) == 1 else torch.stack(parts).sum(0)

    def _shade_each(self, fragments: Fragments) -> Tensor:
        """Apply `shade` to a batch of meshes: each with its own images."""
        colors = []
        for row, numbers in enumerate(read_once(self.image_index, _numbers_of_rows)):
            places = torch.full((len(self.images) + 1,), -1, device=self.uv.device)  # −1 stays −1
            places[numbers] = torch.arange(len(numbers), device=self.uv.device)
            mesh = UVMesh(
                self.vertices[row] if self.vertices.dim() == 3 else self.vertices,
                self.faces[row] if self.faces.dim() == 3 else self.faces,
                self.uv[row],
                places[self.image_index[row]],
                tuple(self.images[number] for number in numbers),
                self.colors[row],
                tuple(self.wraps[number] for number in numbers),
            )
            own = slice(None) if len(self.uv) == 1 else slice(row, row + 1)
            corners, index = fragments.corners[own], fragments.face_index[own]
            colors.append(mesh._sampled(replace(fragments, corners=corners, face_index=index, rings=None)))
        return torch.cat(colors)

    def normalize(self) -> UVMesh:
        """Copy the mesh, with its bounding box centred at the origin and the box's longest side from −1 to 1.

        Returns:
            The copy. Its vertices are detached; the other tensors are shared.

        Raises:
            ValueError: All vertices coincide, or one is not finite.

        Example:
            >>> nr.Mesh.icosphere(2, radius=3.0).save("sphere.obj")
            >>> nr.UVMesh.load("sphere.obj").normalize().vertices.max().item()
            1.0
        """
        return replace(self, vertices=centered(self.vertices).float())

    def submesh(self, index: Any) -> UVMesh:
        """Take some of the faces, with their texture coordinates and the vertices that they use.

        Args:
            index: Numbers of faces [N], or a bool for each face [F]: tensor, array or list. Or a slice.

        Returns:
            The mesh, with the same images; differentiable in all tensors. Its vertices keep their order.

        Raises:
            TypeError, ValueError: A type or shape does not fit, a number is out of range, or there is none.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> nr.UVMesh.load("sphere.obj").submesh(range(10)).faces.shape
            torch.Size([10, 3])
        """
        kept = chosen_faces(index, self.faces)
        rows, faces = used_vertices(self.faces[kept])
        own = {name: value[kept] for name in FACE_ATTRIBUTES if (value := getattr(self, name)) is not None}
        return replace(self, vertices=self.vertices[rows], faces=faces, **own)

    def merge_vertices(self, tolerance: float = 0.0) -> UVMesh:
        """Merge vertices in the same place, so that adjacent faces share them; texture coordinates stay as they are.

        Args:
            tolerance: As in `Mesh.merge_vertices`.

        Returns:
            The mesh, with all faces; differentiable in all tensors. The first vertex of each place is kept, in order.

        Raises:
            TypeError, ValueError: ``tolerance`` is not a number ≥ 0.

        Example:
            >>> vertices, faces = nr.cube()
            >>> corners, uv, image = vertices[faces].reshape(-1, 3), torch.rand(36, 2), torch.rand(8, 8, 3)
            >>> soup = nr.UVMesh(corners, torch.arange(36).reshape(12, 3), uv, image)
            >>> soup.merge_vertices().vertices.shape
            torch.Size([8, 3])
        """
        rows, faces = merged_vertices(self.vertices, self.faces, tolerance)
        return replace(self, vertices=self.vertices[rows], faces=faces)

    def subdivide(self, levels: int = 1, scheme: str = "midpoint") -> UVMesh:
        """Split each face into four, with its texture coordinates, colours and materials.

        Args:
            levels: As in `Mesh.subdivide`.
            scheme: As in `Mesh.subdivide`. "loop" drops normals and tangents of the file, which no longer fit.

        Returns:
            The mesh, with the same images; differentiable in all tensors.

        Raises:
            TypeError, ValueError: As `Mesh.subdivide`.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> nr.UVMesh.load("sphere.obj").subdivide(scheme="loop").num_faces
            1280
        """
        levels, mesh = checked_levels(levels, scheme), self
        for _ in range(levels):
            vertices, faces = subdivided(mesh.vertices, mesh.faces, scheme)
            own = {name: getattr(mesh, name) for name in FACE_ATTRIBUTES if getattr(mesh, name) is not None}
            own = {name: v.repeat_interleave(4, 0) if v.dim() == 1 else split_corners(v) for name, v in own.items()}
            for name in {"normals", "tangents"} & set(own):
                unit = functional.normalize(own[name][..., :3], dim=-1)
                own[name] = None if scheme == "loop" else torch.cat((unit, own[name][..., 3:].sign()), -1)
            mesh = replace(mesh, vertices=vertices, faces=faces, **own)
        return mesh

    def resized(self, side: int) -> UVMesh:
        """Copy the mesh, with all images resized to ``side`` × ``side`` pixels by an antialiasing filter.

        Args:
            side: Side of the new images in pixels, ≥ 1.

        Returns:
            The copy, differentiable in the images.

        Raises:
            TypeError, ValueError: ``side`` is not a whole number ≥ 1.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> [image.shape for image in nr.UVMesh.load("sphere.obj").resized(128).images]
            [torch.Size([128, 128, 3])]
        """
        size = (validate.whole("side", side, 1),) * 2
        images = [image.movedim(2, 0)[None] for image in self.images]
        resized = [functional.interpolate(image, size, mode="bilinear", antialias=True) for image in images]
        return replace(self, images=tuple(image[0].movedim(0, 2).contiguous() for image in resized))


def _numbers_of_rows(index: Tensor) -> list[list[int]]:
    """Find the images that each mesh of a batch uses."""
    return [sorted({number for number in row if number >= 0}) for row in index.tolist()]
