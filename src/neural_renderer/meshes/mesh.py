"""`Mesh`: a mesh with texture cubes, or colours of vertices or faces, as a `torch.nn.Module`."""

from __future__ import annotations

import copy
import os
from typing import Any

import torch
from torch import Tensor, nn

from ..base import validate
from ..io.cubes import bake_corners, check_size, noise_cubes, white_cubes
from ..io.files import as_tensor
from ..io.formats import load_mesh
from ..io.mesh_writer import as_trimesh, save_mesh
from ..io.obj import load_obj
from ..io.trimesh_meshes import read_trimesh
from ..raster.ops.corners import gather_corners
from . import primitives
from .pieces import EditableMesh
from .subdivision import split_cubes, subdivided

_COLORS = ("textures", "vertex_colors", "face_colors")  # a mesh has one of them


class Mesh(EditableMesh, nn.Module):
    """Triangle mesh with texture cubes, or with colours of vertices or faces.

    A mesh keeps the tensors that it is given, with their gradients. To optimise it, call `trainable`: the copy has new
    parameters. The same holds for `UVMesh`.

    `load`, `fromobj` and `icosphere` make a mesh, `save` writes it, `normalize` centres and scales it, `submesh`,
    `merge_vertices` and `subdivide` change its faces. `get_batch` and `set_lr` are methods of the first packages. All
    other methods are those of `torch.nn.Module`, such as `to`; `parameters` and `state_dict` contain only parameters.

    ``Mesh(vertices, faces)`` is white; ``vertex_colors``, ``face_colors`` or ``textures`` colour it.
    ``Mesh("teapot.obj", texture_size, normalization)`` reads the shape from an OBJ file and ignores its colours, as in
    the first packages: its vertices and textures are parameters, and the textures are normal noise of standard
    deviation 0.05, to be optimised through the sigmoid of `get_batch`.

    Args:
        vertices: [V, 3] floating tensor or array, or the path of an OBJ file.
        faces: [F, 3] tensor or array of whole numbers, on the device of the vertices.
        textures: [F, T, T, T, 3] floating, or None.
        texture_size: T of the textures that are made if there are none, ≥ 1.
        normalization: For an OBJ file: centre its bounding box at the origin and scale its longest side to [−1, 1].
        vertex_colors: [V, 3] floating, RGB in [0, 1], in place of textures; drawn by linear interpolation.
        face_colors: [F, 3] floating, RGB in [0, 1], in place of textures.

    Attributes:
        vertices: [V, 3] float32.
        faces: [F, 3] int32, indices into the vertices.
        textures: [F, T, T, T, 3] float32. Texel (i, j, k) of a face's cube lies at barycentric weights
            (i, j, k) / (T − 1) of its corners 0, 1, 2. With T = 1 the face has one colour. Colours of vertices or
            faces are baked at the first access of ``textures``. From then on the mesh has textures only, which blend
            vertices' colours up to 3 % (T = 4) of the corners' difference off a linear interpolation.
        vertex_colors: [V, 3] float32; None if the mesh has others.
        face_colors: [F, 3] float32; None if the mesh has others.

    Raises:
        TypeError, ValueError: A type, shape or device does not fit, a number is not finite, an index is out of range,
            or there are no faces, or more than one kind of colours.

    Example:
        >>> vertices, faces = nr.cube()
        >>> nr.Mesh(vertices, faces, torch.ones(12, 1, 1, 1, 3))
        Mesh(8 vertices, 12 faces, textures of 1³, cpu)
        >>> cube = nr.Mesh(vertices, faces, vertex_colors=vertices.abs())
        >>> cube.colors_of_faces().shape, cube.cubes().shape
        (torch.Size([12, 3, 3]), torch.Size([12, 4, 4, 4, 3]))
        >>> cube.normalize().save("cube.ply")
        >>> nr.Mesh.load("cube.ply").to_trimesh()
        <trimesh.Trimesh(vertices.shape=(8, 3), faces.shape=(12, 3))>
        >>> sphere = nr.Mesh.icosphere(2).trainable()
        >>> sphere.set_lr(0.1, 1.0)
        >>> optimizer = nr.Adam(sphere.parameters(), lr=0.01)  # 0.001 for the vertices
        >>> vertices, faces, textures = sphere.get_batch(5)
        >>> vertices.shape
        torch.Size([5, 162, 3])
    """

    vertices: Tensor
    faces: Tensor
    textures: Tensor
    vertex_colors: Tensor | None
    face_colors: Tensor | None

    def __init__(
        self,
        vertices: Any,
        faces: Any = None,
        textures: Any = None,
        texture_size: int = 4,
        normalization: bool = True,
        *,
        vertex_colors: Any = None,
        face_colors: Any = None,
    ) -> None:
        super().__init__()
        plain = white_cubes
        chainer = isinstance(vertices, (str, os.PathLike))
        if chainer:  # `Mesh(path, texture_size, normalization)`, as in the first packages
            texture_size = texture_size if faces is None else faces
            vertices, faces, *_ = load_obj(vertices, normalization if textures is None else textures)
            textures, plain = None, noise_cubes
        vertices, faces = as_tensor(vertices), as_tensor(faces)
        validate.floating("vertices", vertices, ["V", 3])
        faces = validate.indices("faces", faces, ["F", 3])
        if not len(faces):
            raise ValueError("faces: expected at least one, got none")
        self._texture_size = validate.whole("texture_size", texture_size, 1)
        colors = {"textures": textures, "vertex_colors": vertex_colors, "face_colors": face_colors}
        colors = {name: as_tensor(part) for name, part in colors.items() if part is not None}
        if len(colors) > 1:
            raise ValueError("textures: expected at most one of textures, vertex_colors and face_colors, got several")
        [(colored, values)] = colors.items() or [("textures", plain(faces, texture_size))]
        if colored == "textures":
            validate.cubes(colored, values, len(faces))
        else:
            validate.floating(colored, values, (len(vertices if colored == "vertex_colors" else faces), 3))
        validate.same_device(vertices=vertices, faces=faces, **{colored: values})
        validate.distinct("vertices", vertices.float(), validate.finite("vertices", vertices))
        validate.finite(colored, values)
        validate.in_range("faces", faces, len(vertices))
        parts = {"vertices": vertices.float(), "faces": faces.int(), colored: values.float().contiguous()}
        for name in ("vertices", "faces", *_COLORS):
            self.register_buffer(name, parts.get(name), persistent=False)
        for name, part in parts.items():
            if chainer and name != "faces":
                part = nn.Parameter(part)
            setattr(self, name, part)  # a parameter replaces the buffer

    def __getattr__(self, name: str) -> Any:
        found = super().__getattr__(name)
        if found is None and name == "textures" and self._colored != name:
            found, before = self.cubes(), self._colored
            self.__dict__["_colored"] = name
            super().__setattr__(name, found)
            super().__setattr__(before, None)
        return found

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        if name in _COLORS and value is not None:
            before = self.__dict__.get("_colored", name)
            self.__dict__["_colored"] = name
            if before != name:
                super().__setattr__(before, None)  # type: ignore[arg-type]  # a buffer may be None

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], texture_size: int = 4, normalize: bool = False, allow_outside: bool = False
    ) -> Mesh:
        """Read a mesh file with its colours, or white if it has none.

        Args:
            path, texture_size, allow_outside: As in `load_mesh`.
            normalize: Centre and scale the mesh; see `Mesh.normalize`.

        Returns:
            The mesh, on the CPU.

        Raises:
            OSError, TypeError, ValueError: As `load_mesh`.
        """
        vertices, faces, textures = load_mesh(path, texture_size, allow_outside)
        mesh = cls(vertices, faces, white_cubes(faces, texture_size) if textures is None else textures)
        return mesh.normalize() if normalize else mesh

    @classmethod
    def from_trimesh(cls, mesh: Any, texture_size: int = 4) -> Mesh:
        """Convert a mesh of trimesh with its colours, or white if it has none. `UVMesh.from_trimesh` keeps images.

        Args:
            mesh: ``trimesh.Trimesh``, or a ``Scene``, whose meshes are transformed and joined.
            texture_size: T, texels along a cube's edge, ≥ 1, into which colours and images are baked.

        Returns:
            The mesh, on the CPU, with all vertices in order.

        Raises:
            TypeError, ValueError: The mesh has another type, no faces, or values that are NaN or out of range.

        Example:
            >>> import trimesh
            >>> nr.Mesh.from_trimesh(trimesh.creation.box(), texture_size=1)
            Mesh(8 vertices, 12 faces, textures of 1³, cpu)
        """
        vertices, faces, surface = read_trimesh(mesh)
        check_size(len(faces), texture_size)
        textures = None if surface is None else torch.from_numpy(surface.bake(texture_size, pixel_centers=True))
        return cls(vertices, faces, textures, texture_size)

    def to_trimesh(self) -> Any:
        """Convert the mesh to a ``trimesh.Trimesh`` with the same vertices and faces, and a colour for each vertex.

        Returns:
            The mesh of trimesh. A vertex's colour is the mean of its faces' textures at that corner.
        """
        return as_trimesh(self.vertices, self.faces, self.cubes())

    @classmethod
    def fromobj(
        cls,
        filename_obj: str | os.PathLike[str],
        normalization: bool = True,
        load_texture: bool = False,
        texture_size: int = 4,
        allow_outside: bool = False,
    ) -> Mesh:
        """Read an OBJ file.

        Args:
            filename_obj, normalization, texture_size, allow_outside: As in `load_obj`.
            load_texture: Read the colours; otherwise the texture is noise that receives gradients.

        Returns:
            The mesh, on the device of `load_obj`. It has no parameters, as in the first packages.

        Raises:
            OSError, TypeError, ValueError: As `load_obj`.

        Example:
            >>> nr.save_obj("cube.obj", *nr.cube())
            >>> nr.Mesh.fromobj("cube.obj", texture_size=2)
            Mesh(8 vertices, 12 faces, textures of 2³, cpu)
        """
        loaded = load_obj(filename_obj, normalization, texture_size, load_texture, allow_outside=allow_outside)
        textures = loaded[2] if len(loaded) == 3 else noise_cubes(loaded[1], texture_size).requires_grad_()
        return cls(loaded[0], loaded[1], textures, texture_size)

    @classmethod
    def icosphere(cls, level: int = 3, radius: float = 1.0, texture_size: int = 4) -> Mesh:
        """Make a white sphere of 10·4ˡᵉᵛᵉˡ + 2 vertices.

        Args:
            level, radius: As in the function `icosphere`.
            texture_size: T, texels along a cube's edge, ≥ 1.

        Returns:
            The mesh, on the CPU.

        Raises:
            TypeError, ValueError: A number is out of range.
        """
        vertices, faces = primitives.icosphere(level, radius)
        return cls(vertices, faces, white_cubes(faces, texture_size))

    @property
    def texture_size(self) -> int:
        """Number of texels T along a cube's edge."""
        return self.textures.shape[1] if self._colored == "textures" else self._texture_size

    def cubes(self) -> Tensor:
        """Return the textures, or bake colours of vertices or faces; the mesh is not changed.

        Returns:
            [F, T, T, T, 3] float32.
        """
        colors, size = self.colors_of_faces(), self._texture_size
        if self._colored == "textures":
            return colors
        if self._colored == "vertex_colors":
            return bake_corners(colors, size)
        return colors.expand(-1, size, size, size, 3).contiguous()

    def colors_of_faces(self) -> Tensor:
        """Return the colours in the form that `render` takes in a tuple.

        Returns:
            Texture cubes [F, T, T, T, 3], with T = 1 for colours of faces; or corners' colours
            [F, 3, 3] for colours of vertices. float32.
        """
        colors = getattr(self, self._colored)
        if self._colored == "vertex_colors":
            return gather_corners(colors[None], self.faces[None]).squeeze(0)
        return colors[:, None, None, None] if self._colored == "face_colors" else colors

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the mesh as OBJ, PLY or GLB, with textures, or baked colours, clamped to [0, 1].

        Args:
            path, overwrite: As in `save_mesh`.

        Raises:
            OSError, TypeError, ValueError: As `save_mesh`.
        """
        save_mesh(path, self.vertices, self.faces, self.cubes(), overwrite=overwrite)

    def replace(self, **tensors: Any) -> Mesh:
        """Copy the mesh with some tensors replaced, for example moved vertices; gradients flow through the copy.

        Args:
            **tensors: "vertices", "faces", and "textures", "vertex_colors" or "face_colors", as for the class.

        Returns:
            The copy. It shares the other tensors, including parameters.

        Raises:
            TypeError, ValueError: A name is unknown, or the tensors do not fit together.

        Example:
            >>> mesh, offset = nr.Mesh.icosphere(2), torch.zeros(162, 3, requires_grad=True)
            >>> moved = mesh.replace(vertices=mesh.vertices + offset)
            >>> nr.render(moved, camera, 32).alpha.sum().backward()
            >>> offset.grad.shape
            torch.Size([162, 3])
        """
        names = ("vertices", "faces", *_COLORS)
        for name in tensors:
            if name not in names:
                raise TypeError(f"{name}: expected some of {', '.join(names)}")
        current: dict[str, Any] = {"vertices": self.vertices, "faces": self.faces}
        if not any(name in tensors for name in _COLORS):
            current[self._colored] = getattr(self, self._colored)
        return Mesh(**{**current, **tensors}, texture_size=self.texture_size)

    __replace__ = replace  # `copy.replace` of Python 3.13 and later

    def trainable(self, *names: str) -> Mesh:
        """Copy the mesh with new parameters, for an optimiser.

        Args:
            *names: "vertices", and "textures", "vertex_colors" or "face_colors"; without names the vertices and the
                colours that the mesh has.

        Returns:
            The copy. It shares the other tensors.

        Raises:
            ValueError: A name is unknown.
        """
        result = self._like(self.vertices, self.faces, getattr(self, self._colored))
        for name in names or ("vertices", self._colored):
            if name not in ("vertices", *_COLORS):
                raise ValueError(f"names: expected some of vertices, {', '.join(_COLORS)}, got {name!r}")
            part = result.cubes() if name == "textures" else getattr(result, name)
            if part is None:
                raise ValueError(f"names: expected an attribute that the mesh has, got {name!r}")
            setattr(result, name, _parameter(part, part))
        return result

    def get_batch(self, batch_size: int) -> tuple[Tensor, Tensor, Tensor]:
        """Repeat the mesh ``batch_size`` times, without a copy.

        Args:
            batch_size: B, ≥ 0.

        Returns:
            Vertices [B, V, 3], faces [B, F, 3] and textures [B, F, T, T, T, 3]. The textures are the sigmoid of the
            parameter, so that they stay in [0, 1] during optimisation.

        Raises:
            TypeError, ValueError: ``batch_size`` is not a whole number ≥ 0.
        """
        batch_size = validate.whole("batch_size", batch_size, 0)
        parts = self.vertices, self.faces, torch.sigmoid(self.cubes())
        vertices, faces, textures = (part.expand(batch_size, *part.shape) for part in parts)
        return vertices, faces, textures

    def set_lr(self, lr_vertices: float, lr_textures: float) -> None:
        """Set factors of the learning rate of `neural_renderer.Adam` for vertices and textures.

        Copies and pickles of the mesh keep the factors; its `state_dict` does not.

        Args:
            lr_vertices, lr_textures: The factors; 0 keeps the vertices or the textures.
        """
        self.vertices.lr = lr_vertices  # type: ignore[attr-defined]
        getattr(self, self._colored).lr = lr_textures

    def __deepcopy__(self, memo: dict[int, Any]) -> Mesh:
        result = memo[id(self)] = type(self).__new__(type(self))
        result.__dict__ = copy.deepcopy(self.__dict__, memo)
        for mine, theirs in zip(self.parameters(), result.parameters(), strict=True):
            theirs.__dict__.update(mine.__dict__)  # the factors of `set_lr`; torch does not copy them
        return result

    def _reshaped(self, vertices: Tensor, faces: Tensor, rows: Any = None, kept: Any = None) -> Mesh:
        old_colors = getattr(self, self._colored)
        of_vertices = self._colored == "vertex_colors"
        chosen = rows if of_vertices else kept
        colors = old_colors if chosen is None else old_colors[chosen]
        are_merged = of_vertices and rows is not None and kept is None
        if are_merged and not torch.equal(colors[faces.long()], old_colors[self.faces.long()]):
            return self._like(vertices, faces, self.cubes(), "textures")
        return self._like(vertices, faces, colors)

    def _split(self, vertices: Tensor, faces: Tensor, scheme: str) -> Mesh:
        colors = getattr(self, self._colored)
        if self._colored == "vertex_colors":
            colors, _ = subdivided(colors, self.faces, "midpoint")
        else:
            colors = colors.repeat_interleave(4, 0) if self._colored == "face_colors" else split_cubes(colors)
        return self._like(vertices, faces, colors)

    def _like(self, vertices: Tensor, faces: Tensor, colors: Tensor, colored: str | None = None) -> Mesh:
        """Copy the mesh with other tensors. A tensor that replaces a parameter becomes one, with its ``requires_grad``.

        ``colored`` is the attribute with the colours, if it differs from that of this mesh.
        """
        result = type(self).__new__(type(self))
        result.__dict__ = {key: copy.copy(part) for key, part in vars(self).items()}
        for name, part in (("vertices", vertices), ("faces", faces), (self._colored, colors)):
            mine = getattr(self, name)
            if isinstance(mine, nn.Parameter):
                part = _parameter(part, mine).requires_grad_(mine.requires_grad)
            setattr(result, colored or name if name == self._colored else name, part)
        return result

    def __repr__(self) -> str:
        colors = f"textures of {self.texture_size}³" if self._colored == "textures" else self._colored.replace("_", " ")
        return f"Mesh({self.num_vertices} vertices, {self.num_faces} faces, {colors}, {self.vertices.device})"


def _parameter(tensor: Tensor, like: Tensor) -> nn.Parameter:
    """Copy a tensor as a parameter, with another one's factor of `set_lr`."""
    result = nn.Parameter(tensor.detach().clone())
    vars(result).update(vars(like))
    return result
