"""Attributes of a `UVMesh`: their forms, their checks, and those that an optimiser changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from .. import validate
from ..constants import read_once
from ..textures.material import Material
from ..textures.sample_texture import Wrap, checked_wrap
from .mesh import as_tensor

if TYPE_CHECKING:
    from typing_extensions import Self

FACE_ATTRIBUTES = ("uv", "image_index", "colors", "material_index", "normals", "tangents", "uv1")
"""Attributes of `UVMesh` with one entry for each face; those from `material_index` on may be None."""
_FLOATING = ("vertices", "uv", "images", "colors", "normals", "tangents", "uv1")


@dataclass(frozen=True, eq=False, init=False)
class UVMeshData:
    """Attributes of `UVMesh`, which explains them."""

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
    ) -> None:
        values: tuple[Any, ...] = (vertices, faces, uv, image_index, images, colors, wraps)
        rest = (images, colors, wraps)
        if image is not None or all(part is None for part in rest):
            if image is not None and any(part is not None for part in (image_index, *rest)):
                raise ValueError(
                    "image: expected only one of image and image_index, images, colors, wraps, got several"
                )
            values = one_image(vertices, faces, uv, image_index if image is None else image, wrap)
        if not isinstance(materials, (tuple, list)):
            raise TypeError(f"materials: expected a tuple of Material, got {type(materials).__name__}")
        values = (*values, materials, material_index, normals, tangents, uv1)
        for part, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, part.name, value)  # the class is frozen

    @property
    def num_vertices(self) -> int:
        """Number of vertices V."""
        return self.vertices.shape[-2]

    @property
    def num_faces(self) -> int:
        """Number of faces F."""
        return self.faces.shape[-2]

    def trainable(self, *names: str) -> Self:
        """Copy the mesh, with tensors of its own that receive gradients, for an optimiser.

        Args:
            *names: Attributes of floating numbers: "vertices", "uv", "images", "colors", "normals", "tangents", "uv1".
                Without names: vertices and images, and colours if there is a face without an image.

        Returns:
            The copy. `parameters` iterates over its new tensors; all others are shared.

        Raises:
            ValueError: A name is not one of these, or the mesh lacks the attribute.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> sphere = nr.UVMesh.load("sphere.obj").trainable()
            >>> optimizer = torch.optim.Adam(sphere.parameters(), lr=0.01)
            >>> nr.render(sphere, camera, 32).rgb.mean().backward()
            >>> optimizer.step()
        """
        if not names:
            plain = not self.images or read_once(self.image_index, has_negative)
            names = ("vertices", "images", *(("colors",) if plain else ()))
        own: dict[str, Any] = {}
        for name in names:
            value = getattr(self, name, None) if name in _FLOATING else None
            if value is None:
                found = [one for one in _FLOATING if getattr(self, one) is not None]
                raise ValueError(f"names: expected some of {', '.join(found)}, got {name!r}")
            own[name] = tuple(map(_leaf, value)) if isinstance(value, (tuple, list)) else _leaf(value)
        return replace(self, **own)

    def parameters(self) -> Iterator[Tensor]:
        """Iterate over the tensors that receive gradients, as `torch.nn.Module.parameters` does; see `trainable`.

        Returns:
            The leaf tensors that require gradients, of the mesh and its materials, each once.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> [part.shape for part in nr.UVMesh.load("sphere.obj").trainable("vertices").parameters()]
            [torch.Size([162, 3])]
        """
        found = {id(part): part for part in _tensors(self) if part.requires_grad and part.is_leaf}
        return iter(found.values())

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
        own = self._owners()
        for name, value, shape in (("uv", self.uv, (*own, 3, 2)), ("colors", self.colors, (*own, 3, 3))):
            validate.finite(name, validate.floating(name, value, shape).float(), always)
        validate.indices("image_index", self.image_index, own)
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
        self._check_materials(always)
        _check_index("image_index", self.image_index, "images", len(self.images), always)

    def _owners(self) -> tuple[int, ...]:
        """Return the leading dimensions of the attributes of faces: (F,), or (B, F) in a batch."""
        return tuple(self.uv.shape[:2]) if getattr(self.uv, "ndim", 3) == 4 else (self.num_faces,)

    def _check_materials(self, always: bool) -> None:
        """Check the optional attributes, as `_check`."""
        own = self._owners()
        for name, width in (("normals", 3), ("tangents", 4), ("uv1", 2)):
            value = getattr(self, name)
            if value is not None:
                validate.finite(name, validate.floating(name, value, (*own, 3, width)).float(), always)
        for material in self.materials:
            if not isinstance(material, Material):
                raise TypeError(f"materials: expected a Material each, got {type(material).__name__}")
        if self.material_index is not None:
            validate.indices("material_index", self.material_index, own, always=always)
            _check_index("material_index", self.material_index, "materials", len(self.materials), always)
        elif len(self.materials) > 1:
            raise ValueError(f"material_index: expected {list(own)} for {len(self.materials)} materials, got None")

    def to(self, device: torch.device | str) -> Self:
        """Copy the mesh to another device.

        Args:
            device: Device of the copy.

        Returns:
            The copy. Gradients flow back to the original.

        Example:
            >>> nr.Mesh.icosphere(2).save("sphere.obj")
            >>> sphere = nr.UVMesh.load("sphere.obj").to("cuda" if torch.cuda.is_available() else "cpu")
        """

        def moved(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(moved, value))
            return value.to(device) if isinstance(value, (Tensor, Material)) else value

        return replace(self, **{part.name: moved(getattr(self, part.name)) for part in fields(self)})


def one_image(vertices: Any, faces: Any, uv: Any, image: Any, wrap: Wrap) -> tuple[Any, ...]:
    """Check the short form of `UVMesh`; return its attributes in order.

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, or an index is out of range.
    """
    vertices = validate.floating("vertices", as_tensor(vertices), ("V", 3)).float()
    faces = validate.indices("faces", as_tensor(faces), ("F", 3)).int()
    if str(getattr(image, "dtype", "")).endswith("uint8"):  # as from a file
        raise TypeError(
            f"image: expected floating numbers in [0, 1], got {list(image.shape)} uint8; image / 255 has them"
        )
    image = as_tensor(image)
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
    own = faces
    if isinstance(uv, (tuple, list)) and len(uv) == 2 and hasattr(uv[1], "shape"):
        uv, own = as_tensor(uv[0]), validate.indices("uv", as_tensor(uv[1]), (len(faces), 3))
        validate.floating("uv", uv, ("U", 2))
        validate.same_device(uv=uv, **{"indices of uv": own})
        validate.in_range("uv", own, len(uv))
        return uv.float()[own.long()]
    uv = as_tensor(uv)
    if getattr(uv, "ndim", 3) == 2:
        validate.floating("uv", uv, (vertices, 2))
        validate.in_range("faces", faces, vertices)
        return uv.float()[faces.long()]
    return validate.floating("uv", uv, (len(faces), 3, 2)).float()


def _leaf(tensor: Tensor) -> Tensor:
    return tensor.detach().clone().requires_grad_()


def _tensors(value: Any) -> Iterator[Tensor]:
    """Iterate over the tensors in tuples and dataclasses."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from _tensors(part)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _tensors(getattr(value, field.name))


def has_negative(index: Tensor) -> bool:
    return bool((index < 0).any())


def _check_index(name: str, index: Tensor, what: str, count: int, always: bool) -> None:
    """Raise ValueError unless an index for each face is in [−1, count); ``always`` as in `validate.finite`."""
    if not len(index) or not (always or validate.values_are_checked(index)):
        return

    def check() -> None:
        low, high = (int(value) for value in torch.aminmax(index))
        if low < -1 or high >= count:
            raise ValueError(f"{name}: expected one of {count} {what} or -1, got {low if low < -1 else high}")

    if always or not validate.postponed(index, lambda: ((index < -1) | (index >= count)).any(), check):
        check()
