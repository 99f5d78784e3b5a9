"""`UVMesh`: a mesh with images and texture coordinates."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..base import validate
from ..base.constants import read_once
from ..base.movable import Replaceable
from ..io.files import as_tensor
from ..io.formats import read_mesh
from ..io.images import as_image
from ..io.mesh_writer import save_uv_mesh
from ..io.surface_colors import SurfaceColors
from ..io.trimesh_meshes import read_trimesh
from ..raster.visible import VisibleFaces
from ..textures.albedo import corner_values, has_negative, sampled_albedo, tinted_by_materials
from ..textures.color_space import tinted
from ..textures.gutters import fill_gutters
from ..textures.material import Material, arrays_of_materials, materials_of_file
from ..textures.sample_texture import Wrap, checked_wrap
from .pieces import EditableMesh
from .subdivision import split_corners

_CORNER_ATTRIBUTES = ("normals", "tangents", "uv1", "tints")
_FACE_ATTRIBUTES = ("uv", "image_index", "colors", "material_index", *_CORNER_ATTRIBUTES)
_FLOATING = ("vertices", "uv", "images", "colors", *_CORNER_ATTRIBUTES)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class UVMesh(EditableMesh, Replaceable):
    """Triangle mesh with texture images as albedo, sampled at every pixel.

    A mesh keeps the tensors that it is given, with their gradients. To optimise it, call `trainable`: the copy has new
    tensors that receive gradients. The same holds for `Mesh`.

    Functions that take a `Mesh` take it, too; `replace` replaces tensors.
    `batch` makes a UVMesh whose vertices, faces and attributes of faces have a leading dimension [B, …]; it is for
    rendering only.

    ``UVMesh(vertices, faces, uv, image)`` is a mesh with one image. The long form ``UVMesh(vertices, faces, uv,
    image_index, images, colors, wraps)`` takes the attributes.

    Args:
        vertices: [V, 3] floating tensor or array.
        faces: [F, 3] whole numbers.
        uv: [V, 2] for vertices, [F, 3, 2] for the faces' corners, or a pair: texture coordinates [U, 2] and indices
            into them [F, 3].
        image_index: The image [H, W, 3] floating, RGB in [0, 1], row 0 at the top; in the long form, the attribute.
        images, colors, wraps: The attributes; not in the short form.
        image: The image of the short form, as a keyword.
        wrap: As in `sample_texture`, in the short form.
        materials, material_index, normals, tangents, uv1, tints: The attributes, in both forms.

    Attributes:
        vertices: [V, 3] float32.
        faces: [F, 3] int32, indices into the vertices.
        uv: [F, 3, 2] float32, texture coordinates of the faces' corners: u to the right, v up, the image over [0, 1]².
        image_index: [F] int64, index into ``images``; −1 for a face without an image.
        images: [H, W, 3] float32 each, RGB, row 0 at the top. Sizes may differ.
        colors: [F, 3, 3] float32, RGB at the corners of faces without an image.
        wraps: "repeat", "clamp" or "mirror" for each image, or a pair of them, as in `sample_texture`.
        materials: `Material` each, for ``shading`` and ``layers`` of `render` and for base colours. Empty for a matt,
            opaque mesh.
        material_index: [F] int64, index into ``materials``; −1 for a face without a material, which is shaded as in a
            mesh without materials. None: all faces have the only material.
        normals: [F, 3, 3] float32, normals of the faces' corners, as in the file; or None.
        tangents: [F, 3, 4] float32, tangents of the corners, towards larger u, and the sign (1 or −1) of the bitangent
            sign · normal × tangent, towards larger v; or None.
        uv1: [F, 3, 2] float32, second texture coordinates of the corners, for textures with ``uv_set=1``; [F, 3, 2 K]
            for textures with ``uv_set`` 1 to K; or None.
        tints: [F, 3, 4] float32 in [0, 1], RGB and alpha at the corners; or None. They are interpolated, and multiply
            images and colours in linear light, and the opacity of materials (``COLOR_0`` of glTF).

    Raises:
        TypeError, ValueError: In the short form, an argument that does not fit. In drawing or saving, attributes that
            do not fit together or are not finite.

    Example:
        >>> vertices, faces = nr.cube()
        >>> uv = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]).expand(12, 3, 2)
        >>> image = torch.rand(64, 64, 3, requires_grad=True)
        >>> cube = nr.UVMesh(vertices, faces, uv, image)
        >>> nr.render(cube, camera, 64).rgb.mean().backward()
        >>> optimizer = torch.optim.Adam(cube.trainable().parameters(), lr=0.01)
        >>> offset = torch.zeros(8, 3, requires_grad=True)
        >>> moved = cube.replace(vertices=vertices + offset)
        >>> fragments = nr.fragments(moved, camera, 64)
        >>> fragments.composite(moved.shade(fragments)).shape
        torch.Size([1, 3, 64, 64])
        >>> cube.normalize().subdivide().submesh(range(10)).resized(128).to("cpu").save("part.obj")
        >>> part = nr.UVMesh.load("part.obj").merge_vertices()
        >>> part
        UVMesh(14 vertices, 10 faces, 1 image of 128 × 128, 1 material, cpu)
        >>> part.to_trimesh().faces.shape
        (10, 3)
    """

    vertices: Tensor
    faces: Tensor
    uv: Tensor
    image_index: Tensor
    images: tuple[Tensor, ...]
    colors: Tensor
    wraps: tuple[Wrap, ...]
    materials: tuple[Material, ...] = ()
    material_index: Tensor | None = None
    normals: Tensor | None = None
    tangents: Tensor | None = None
    uv1: Tensor | None = None
    tints: Tensor | None = None

    def __init__(
        self,
        vertices: Any,
        faces: Any,
        uv: Any,
        image_index: Any = None,
        images: Any = None,
        colors: Any = None,
        wraps: Any = None,
        *,
        image: Any = None,
        wrap: Wrap = "repeat",
        materials: tuple[Material, ...] = (),
        material_index: Any = None,
        normals: Any = None,
        tangents: Any = None,
        uv1: Any = None,
        tints: Any = None,
    ) -> None:
        values: tuple[Any, ...] = (vertices, faces, uv, image_index, images, colors, wraps)
        long_form = (images, colors, wraps)
        if image is not None or all(part is None for part in long_form):
            if image is not None and any(part is not None for part in (image_index, *long_form)):
                raise ValueError(
                    "image: expected only one of image and image_index, images, colors, wraps, got several"
                )
            values = _one_image(vertices, faces, uv, image_index if image is None else image, wrap)
        if not isinstance(materials, (tuple, list)):
            raise TypeError(f"materials: expected a tuple of Material, got {type(materials).__name__}")
        values = (*values, materials, material_index, normals, tangents, uv1, tints)
        for part, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, part.name, value)  # the class is frozen

    @classmethod
    def load(cls, path: str | os.PathLike[str], grey: float = 0.5, allow_outside: bool = False) -> UVMesh:
        """Read a mesh file with its materials and images, to the CPU.

        The gutters between an image's charts are filled (`fill_gutters`). An image that several materials share appears
        once in ``images``. Materials of OBJ, GLB and glTF files, and the normals of the files, are read, too. Texture
        coordinates have the transform of the base colour's texture (``KHR_texture_transform``).

        Args:
            path, allow_outside: As in `load_mesh`.
            grey: Colour of a mesh without colours, in [0, 1].

        Returns:
            The mesh, on the CPU.

        Raises:
            OSError, TypeError, ValueError: As `load_mesh`.
        """
        vertices, faces, surface, _ = read_mesh(path, allow_outside, materials=True)
        return cls._of_surface(vertices, faces, surface, validate.number("grey", grey))

    @classmethod
    def from_trimesh(cls, mesh: Any, grey: float = 1.0) -> UVMesh:
        """Convert a mesh of trimesh with its colours, or its image and texture coordinates.

        Args:
            mesh: As in `Mesh.from_trimesh`.
            grey: Colour of a mesh without colours, in [0, 1].

        Returns:
            The mesh, on the CPU, with all vertices in order. Only the base colour of materials is kept.

        Raises:
            TypeError, ValueError: As `Mesh.from_trimesh`.

        Example:
            >>> import trimesh
            >>> nr.UVMesh.from_trimesh(trimesh.creation.box())
            UVMesh(8 vertices, 12 faces, 0 images, cpu)
        """
        return cls._of_surface(*read_trimesh(mesh), validate.number("grey", grey))

    def to_trimesh(self) -> Any:
        """Convert the mesh to trimesh with its images, through an OBJ file as `save` writes it.

        Returns:
            A ``trimesh.Trimesh``, or a ``Scene`` with one for each image and material; vertices at seams are split.

        Raises:
            TypeError, ValueError, OSError: As `save`.
        """
        import trimesh  # imported here because it is slow

        with tempfile.TemporaryDirectory() as folder:
            self.save(f"{folder}/mesh.obj")
            return trimesh.load(f"{folder}/mesh.obj", process=False)

    @classmethod
    def _of_surface(cls, vertices: np.ndarray, faces: np.ndarray, surface: SurfaceColors | None, grey: float) -> UVMesh:
        """Make a mesh from the results of `read_mesh`; ``grey`` is the colour of a mesh without colours."""
        surface = surface or SurfaceColors.plain(len(faces), grey)
        if not surface.has_colors:
            surface.colors[:] = grey
        uv = torch.from_numpy(surface.uv).float()
        index = torch.from_numpy(surface.image).long()
        images = [
            fill_gutters(torch.from_numpy(image).float(), uv[index == number], wrap=wrap)
            for number, (image, wrap) in enumerate(zip(surface.images, surface.wraps, strict=True))
        ]
        corners: dict[str, Any] = {name: _tensor(getattr(surface, name)) for name in _CORNER_ATTRIBUTES}
        return cls(
            vertices=torch.from_numpy(vertices).float(),
            faces=torch.from_numpy(faces).int(),
            uv=uv,
            image_index=index,
            images=tuple(images),
            colors=torch.from_numpy(surface.colors),
            wraps=tuple(surface.wraps),
            materials=materials_of_file(surface.materials),
            material_index=None if surface.material is None else torch.from_numpy(surface.material).long(),
            **corners,
        )

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the mesh as OBJ or GLB, with colours clamped to [0, 1].

        With ``spot.obj`` this writes ``spot.mtl`` and ``spot_texture.png``, or ``spot_texture_1.png`` and so on. Faces
        are grouped by image and material; in OBJ files, faces without an image share one more image, with a tile for
        each. GLB files have no Phong highlights. MTL files store transforms and wraps of the first texture only, and no
        occlusion, tangents, ``uv1``,
        ``double_sided`` or ``alpha_cutoff``: "MASK" is read as "BLEND".

        Args:
            path: Name that ends in ``.obj`` or ``.glb``. A file of this name is replaced, missing folders are made.
            overwrite: As in `save_mesh`.

        Raises:
            TypeError, ValueError, FileExistsError, OSError: As `save_mesh`.
        """
        save_uv_mesh(path, self.vertices, self.faces, self._surface(), overwrite=overwrite)

    def _surface(self) -> SurfaceColors:
        """Convert everything except the geometry to arrays for the writers of files."""
        self._check(always=True)
        corners: dict[str, Any] = {name: _array(getattr(self, name)) for name in _CORNER_ATTRIBUTES}
        index = self.material_index
        if index is None and self.materials:
            index = torch.zeros(len(self.faces), dtype=torch.int64)
        return SurfaceColors(
            self.colors.detach().float().cpu().numpy(),
            self.image_index.long().cpu().numpy(),
            self.uv.detach().double().cpu().numpy(),
            [image.detach().float().cpu().numpy() for image in self.images],
            list(self.wraps),
            materials=arrays_of_materials(self.materials),
            material=None if index is None else index.long().cpu().numpy(),
            **corners,
        )

    def trainable(self, *names: str) -> UVMesh:
        """Copy the mesh with new tensors that receive gradients, for an optimiser.

        Args:
            *names: Attributes of floating numbers: "vertices", "uv", "images", "colors", "normals", "tangents", "uv1",
                "tints".
                Without names: vertices and images, and colours if there is a face without an image.

        Returns:
            The copy. `parameters` iterates over its new tensors; all others are shared.

        Raises:
            ValueError: A name is unknown, or the mesh does not have the attribute.
        """
        if not names:
            plain = not self.images or read_once(self.image_index, has_negative)
            names = ("vertices", "images", *(("colors",) if plain else ()))
        copies: dict[str, Any] = {}
        for name in names:
            value = getattr(self, name, None) if name in _FLOATING else None
            if value is None:
                found = [one for one in _FLOATING if getattr(self, one) is not None]
                raise ValueError(f"names: expected some of {', '.join(found)}, got {name!r}")
            copies[name] = tuple(map(_leaf, value)) if isinstance(value, (tuple, list)) else _leaf(value)
        return self.replace(**copies)

    def parameters(self) -> Iterator[Tensor]:
        """Iterate over the tensors that receive gradients, as `torch.nn.Module.parameters` does; see `trainable`.

        Returns:
            The leaf tensors that require gradients, of the mesh and its materials, each once.
        """
        found = {id(part): part for part in tensors_of(self) if part.requires_grad and part.is_leaf}
        return iter(found.values())

    @validate.checked_together
    def shade(self, fragments: VisibleFaces) -> Tensor:
        """Sample the albedo of each pixel, with mipmaps, tints and the base colours of materials.

        Gradients flow to ``images``, ``colors``, ``tints`` and base colours, and with ``gradient="edge"`` to
        ``vertices``. If adjacent charts differ in colour at their border, pass ``seams`` to `Fragments.composite`.

        Args:
            fragments: Fragments of this mesh; see `fragments`.

        Returns:
            [B, H, W, 3] float32, RGB.

        Raises:
            ValueError: ``fragments`` belongs to a mesh with another number of faces.
        """
        self._check()
        validate.same_device(uv=self.uv, fragments=fragments.corners)
        batch, count = fragments.corners.shape[:2]
        meshes = len(self.uv) if self.uv.dim() == 4 else batch
        if self.num_faces != count or meshes not in (1, batch):
            got = f"{batch} images of {count} faces"
            raise ValueError(f"fragments: expected those of a mesh of shape {list(self.faces.shape)}, got {got}")
        albedo = sampled_albedo(fragments, self.uv, self.image_index, self.colors, self.images, self.wraps)
        if self.tints is not None:
            albedo = tinted(albedo, corner_values(fragments, self.tints[..., :3]))
        return tinted_by_materials(albedo, self.materials, self.material_index, fragments.face_index)

    def _reshaped(self, vertices: Tensor, faces: Tensor, rows: Any = None, kept: Any = None) -> UVMesh:
        attributes = {} if kept is None else {name: value[kept] for name, value in self._of_faces().items()}
        return self.replace(vertices=vertices, faces=faces, **attributes)

    def _split(self, vertices: Tensor, faces: Tensor, scheme: str) -> UVMesh:
        attributes: dict[str, Any] = {
            name: value.repeat_interleave(4, 0) if value.dim() == 1 else split_corners(value)
            for name, value in self._of_faces().items()
        }
        for name in {"normals", "tangents"} & set(attributes):
            unit = functional.normalize(attributes[name][..., :3], dim=-1)
            attributes[name] = None if scheme == "loop" else torch.cat((unit, attributes[name][..., 3:].sign()), -1)
        return self.replace(vertices=vertices, faces=faces, **attributes)

    def _of_faces(self) -> dict[str, Tensor]:
        return {name: value for name in _FACE_ATTRIBUTES if (value := getattr(self, name)) is not None}

    def resized(self, side: int) -> UVMesh:
        """Copy the mesh with all images resized to ``side`` × ``side`` pixels by an antialiasing filter.

        Args:
            side: Side of the new images in pixels, ≥ 1.

        Returns:
            The copy, differentiable in the images.

        Raises:
            TypeError, ValueError: ``side`` is not a whole number ≥ 1.
        """
        size = (validate.whole("side", side, 1),) * 2
        images = [image.movedim(2, 0)[None] for image in self.images]
        resized = [functional.interpolate(image, size, mode="bilinear", antialias=True) for image in images]
        return self.replace(images=tuple(image[0].movedim(0, 2).contiguous() for image in resized))

    def __repr__(self) -> str:
        sizes = {f"{image.shape[0]} × {image.shape[1]}" for image in self.images if hasattr(image, "shape")}
        images = f"{len(self.images)} image{'s' * (len(self.images) != 1)}"
        of = f" of {sizes.pop()}" if len(sizes) == 1 else ""
        batch = f"batch of {len(self.uv)}, " if self.uv.ndim == 4 else ""
        count = len(self.materials)
        rest = f", {count} material{'s' * (count != 1)}" if count else ""
        shape = f"{self.num_vertices} vertices, {self.num_faces} faces"
        return f"UVMesh({batch}{shape}, {images}{of}{rest}, {self.vertices.device})"

    def _check(self, always: bool = False) -> None:
        """Raise TypeError or ValueError unless all attributes fit together; ``always`` as in `validate.finite`."""
        leading = (
            tuple(self.uv.shape[:2]) if getattr(self.uv, "ndim", 3) == 4 else (self.num_faces,)
        )  # (B, F) in a batch
        for material in self.materials:
            if not isinstance(material, Material):
                raise TypeError(f"materials: expected a Material each, got {type(material).__name__}")
        last = max([1, *(texture.uv_set for one in self.materials for texture in one.textures().values())])
        further = 2 * max(last, getattr(self.uv1, "shape", (2,))[-1] // 2, 1)
        widths = {"uv": 2, "colors": 3, "normals": 3, "tangents": 4, "uv1": further, "tints": 4}
        for name, width in widths.items():
            value = getattr(self, name)
            if value is not None or name in ("uv", "colors"):
                validate.finite(name, validate.floating(name, value, (*leading, 3, width)).float(), always)
        validate.indices("image_index", self.image_index, leading)
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
        _check_index("image_index", self.image_index, "images", len(self.images), always)
        if self.material_index is not None:
            validate.indices("material_index", self.material_index, leading, always=always)
            _check_index("material_index", self.material_index, "materials", len(self.materials), always)
        elif len(self.materials) > 1:
            raise ValueError(f"material_index: expected {list(leading)} for {len(self.materials)} materials, got None")


def _one_image(vertices: Any, faces: Any, uv: Any, image: Any, wrap: Wrap) -> tuple[Any, ...]:
    """Check the short form of `UVMesh`; return its attributes in order."""
    vertices = validate.floating("vertices", as_tensor(vertices), ("V", 3)).float()
    faces = validate.indices("faces", as_tensor(faces), ("F", 3)).int()
    image = as_image("image", image)
    if isinstance(image, Tensor) and image.ndim == 3 and image.shape[2] == 4:
        raise ValueError(
            f"image: expected [H, W, 3], got {validate.shape_of(image)}; image[..., :3] is without transparency, which "
            f"the opacity_texture of a Material has"
        )
    if isinstance(image, Tensor) and image.ndim == 3 and image.shape[0] == 3 != image.shape[2]:
        got = validate.shape_of(image)
        raise ValueError(f"image: expected [H, W, 3], got {got}, channels first; image.movedim(0, 2) converts it")
    image = validate.floating("image", image, ("H", "W", 3)).float()
    uv = _of_corners(uv, faces, len(vertices))
    validate.same_device(vertices=vertices, faces=faces, uv=uv, image=image)
    validate.in_range("faces", faces, len(vertices))
    checked_wrap(wrap)
    count = len(faces)
    index = torch.zeros(count, dtype=torch.int64, device=faces.device)
    return vertices, faces, uv, index, (image,), torch.ones(count, 3, 3, device=faces.device), (wrap,)


def _of_corners(uv: Any, faces: Tensor, vertices: int) -> Tensor:
    """Convert one of the three forms of texture coordinates to [F, 3, 2] float32."""
    indices = faces
    if isinstance(uv, (tuple, list)) and len(uv) == 2 and hasattr(uv[1], "shape"):
        uv, indices = as_tensor(uv[0]), validate.indices("uv", as_tensor(uv[1]), (len(faces), 3))
        validate.floating("uv", uv, ("U", 2))
        validate.same_device(uv=uv, **{"indices of uv": indices})
        validate.in_range("uv", indices, len(uv))
        return uv.float()[indices.long()]
    uv = as_tensor(uv)
    if getattr(uv, "ndim", 3) == 2:
        validate.floating("uv", uv, (vertices, 2))
        validate.in_range("faces", faces, vertices)
        return uv.float()[faces.long()]
    return validate.floating("uv", uv, (len(faces), 3, 2)).float()


def _check_index(name: str, index: Tensor, what: str, count: int, always: bool) -> None:
    """Raise ValueError unless an index for each face is in [−1, count); ``always`` as in `validate.finite`."""
    if not len(index) or not (always or validate.values_are_checked(index)):
        return

    def check() -> None:
        low, high = validate.least_and_greatest(index)
        if low < -1 or high >= count:
            raise ValueError(f"{name}: expected one of {count} {what} or -1, got {low if low < -1 else high}")

    if always or not validate.postponed(index, lambda: ((index < -1) | (index >= count)).any(), check):
        check()


def _tensor(array: np.ndarray | None) -> Tensor | None:
    return None if array is None else torch.from_numpy(array).float()


def _array(tensor: Tensor | None) -> np.ndarray | None:
    return None if tensor is None else tensor.detach().double().cpu().numpy()


def _leaf(tensor: Tensor) -> Tensor:
    return tensor.detach().clone().requires_grad_()


def tensors_of(value: Any) -> Iterator[Tensor]:
    """Iterate over the tensors in tuples and dataclasses."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from tensors_of(part)
    elif is_dataclass(value):
        for field in fields(value):
            yield from tensors_of(getattr(value, field.name))
