"""`Rig`: linear blend skinning of a mesh by a tree of joints, and morph targets."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ...base import validate
from ...base.movable import Replaceable
from ...camera import rotations as rotation_formulas
from ...io.atomic_write import write_file
from ...io.files import as_tensor, short
from ...io.gltf.rig_reader import Track
from ..uv_mesh import UVMesh
from .animation import alike, sampled
from .files import encoded_rig, read_rig
from .tree import JointTree

_ROUNDING = 0.02  # tolerance of the sum of a vertex's weights; eight weights in bytes deviate by up to 0.016
_MOST_DENSE = 128  # up to so many bones, one matrix product blends motions, several times faster than gathering


class Pose(NamedTuple):
    """The transforms of J joints relative to their parents, and the weights of M morph targets; any batch dimensions.

    Attributes:
        translations: [..., J, 3], in units of the mesh.
        rotations: [..., J, 3, 3], matrices.
        scales: [..., J, 3], along the axes before the rotation.
        weights: [..., M].
    """

    translations: Tensor
    rotations: Tensor
    scales: Tensor
    weights: Tensor


@dataclass(frozen=True, eq=False, repr=False)
class Rig(Replaceable):
    """Mesh that is deformed by joints and morph targets.

    Vertices are Σₖ wₖ · Gₖ · Bₖ · (p + Σₘ aₘ dₘ): p is the vertex of the mesh, dₘ and aₘ are targets and their weights,
    wₖ skinning weights, Bₖ inverse bind matrices, and Gₖ the joints' world transforms, products along the tree (glTF
    2.0, section 3.7.3). Gradients and forward mode reach poses, vertices, targets and weights; a pose may have batch
    dimensions. Joints are rotated by
    vectors: axis times angle in radians, about the joint's axes at rest; 0 is the rest pose.

    `load` reads glTF and GLB files, `save` writes GLB. A rig keeps the tensors that it is given.

    Args:
        mesh: `UVMesh` with vertices [V, 3]; or `Mesh`, which `save` does not take.
        parents: [J] index of each joint's parent, −1 for roots; no cycles.
        translations: [J, 3] positions of joints at rest, relative to their parents.
        weights: [V, K] floating, skinning weights: at least 0, with sum 1.
        indices: [V, K] indices of the weights' bones. None: K = B, all bones in order.
        rotations: [J, 3, 3] at rest; None: no rotation.
        scales: [J, 3] at rest, not 0 without ``inverse_bind``; None: 1.
        bones: [B] whole numbers, the joint of each bone; None: each joint is one.
        inverse_bind: [B, 4, 4] from the space of the mesh to that of the joint. None: the mesh is bound to the joints
            at rest, with their ``joint_targets``.
        targets: [M, V, 3] displacements of vertices; None: no targets.
        target_weights: [M] at rest; None: 0.
        joint_targets: [M, J, 3] displacements of the joints' translations, for bodies with varying bone lengths; None:
            0.
        names: Name of each joint; None: "joint 0", ….
        animations: Tracks by the name of the animation.

    Raises:
        TypeError, ValueError: A type, shape, index or weight does not fit, a number is not finite, or parents form a
            cycle.

    Example:
        >>> vertices, faces = nr.cube()
        >>> upper = (vertices[:, 1:] > 0).float()[:, :1]
        >>> weights = torch.cat((1 - upper, upper), 1)
        >>> rig = nr.Rig(nr.Mesh(vertices, faces), [-1, 0], torch.zeros(2, 3), weights)
        >>> angles = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]], requires_grad=True)
        >>> rig.vertices(rig.pose(angles)).square().sum().backward()
    """

    mesh: Any
    parents: tuple[int, ...]
    translations: Tensor
    weights: Tensor
    indices: Tensor = None  # type: ignore[assignment]
    rotations: Tensor = None  # type: ignore[assignment]
    scales: Tensor = None  # type: ignore[assignment]
    bones: Tensor = None  # type: ignore[assignment]
    inverse_bind: Tensor | None = None
    targets: Tensor = None  # type: ignore[assignment]
    target_weights: Tensor = None  # type: ignore[assignment]
    joint_targets: Tensor | None = None
    names: tuple[str, ...] = ()
    animations: Mapping[str, Sequence[Track]] | None = None

    def __post_init__(self) -> None:
        vertices = self.mesh.vertices
        parents = tuple(validate.whole(f"parents[{n}]", parent, -1) for n, parent in enumerate(self.parents))
        joints, points = len(parents), len(vertices)
        device = vertices.device
        weights = validate.floating("weights", as_tensor(self.weights), (points, "K"))
        bones = torch.arange(joints) if self.bones is None else as_tensor(self.bones)
        bones = validate.indices("bones", bones, ["B"]).long().to(device)
        validate.in_range("bones", bones, joints)
        indices = torch.arange(weights.shape[1]).expand(points, -1) if self.indices is None else as_tensor(self.indices)
        indices = validate.indices("indices", indices, tuple(weights.shape)).long().to(device)
        validate.in_range("indices", indices, len(bones))
        count = 0 if self.targets is None else len(self.targets)
        found: dict[str, Any] = {"weights": weights}
        plain = {
            "translations": ((joints, 3), None),
            "rotations": ((joints, 3, 3), torch.eye(3).expand(joints, 3, 3)),
            "scales": ((joints, 3), torch.ones(joints, 3)),
            "targets": ((count, points, 3), torch.zeros(0, points, 3)),
            "target_weights": ((count,), torch.zeros(count)),
            "inverse_bind": ((len(bones), 4, 4), None),
            "joint_targets": ((count, joints, 3), None),
        }
        for name, (shape, default) in plain.items():
            value = as_tensor(getattr(self, name))
            value = default if value is None else validate.floating(name, value, shape)
            found[name] = None if value is None else value.to(vertices)
        if found["translations"] is None:
            raise TypeError("translations: expected a tensor, got NoneType")
        for name, value in found.items():
            if value is not None:
                validate.finite(name, value)
        if validate.values_are_checked(weights):
            sums = weights.detach().sum(1)
            if bool((weights < 0).any() | ((sums - 1).abs() > _ROUNDING).any()):
                got = f"{float(weights.min()):.3g} and sums from {float(sums.min()):.3g} to {float(sums.max()):.3g}"
                raise ValueError(f"weights: expected non-negative rows that sum to 1, got a minimum of {got}")
        scales = found["scales"]
        if self.inverse_bind is None and validate.values_are_checked(scales) and not bool(scales.all()):
            raise ValueError("scales: expected numbers other than 0 without inverse_bind, got 0")
        names = tuple(self.names) or tuple(f"joint {n}" for n in range(joints))
        if len(names) != joints:
            raise ValueError(f"names: expected {joints}, one for each joint, got {len(names)}")
        found |= {"parents": parents, "bones": bones, "indices": indices, "names": names}
        found["animations"] = dict(self.animations or {})
        for name, value in found.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_tree", JointTree(parents, device))

    def __repr__(self) -> str:
        """Return the numbers of parts."""
        return (
            f"Rig({len(self.mesh.vertices)} vertices, {len(self.parents)} joints, {len(self.targets)} morph targets, "
            f"{len(self.animations or ())} animations)"
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str], grey: float = 0.5, allow_outside: bool = False) -> Rig:
        """Read a glTF or GLB file. All nodes become joints, and meshes without skin follow their node.

        Normals and tangents of morph targets are not read; meshes with such targets lose the file's normals.

        Args:
            path: GLB or glTF file.
            grey: Colour of a mesh without colours, in [0, 1].
            allow_outside: Read buffers and images outside the file's folder, too. Use it for trusted files only.

        Returns:
            The rig, on the CPU.

        Raises:
            FileNotFoundError: The file does not exist.
            ValueError: The file is damaged, nodes form a cycle or have several parents, a matrix of a node has shear,
                or as `UVMesh.load`. The sentence names the file and the entry.

        Example:
            >>> nr.Mesh.icosphere(1).save("ball.glb")
            >>> rig = nr.Rig.load("ball.glb")
            >>> len(rig.mesh.vertices), rig.animations
            (42, {})
        """
        parts = read_rig(path, validate.number("grey", grey), allow_outside)
        try:
            rig = cls(**parts)
            validate.finite("vertices at rest", rig.vertices(), always=True)  # products of huge numbers overflow
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        return rig

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a GLB file: mesh with materials, joints, skin, morph targets and animations.

        Args:
            path: Name that ends in .glb. A file of this name is replaced, missing folders are made.

        Raises:
            TypeError: The mesh is not a `UVMesh`.
            ValueError: The suffix is not .glb, or the rig has ``joint_targets``, which glTF does not have.
            OSError: The file cannot be written. An existing file stays as it was.

        Example:
            >>> nr.Mesh.icosphere(1).save("ball.obj")
            >>> mesh = nr.UVMesh.load("ball.obj")
            >>> nr.Rig(mesh, [-1], torch.zeros(1, 3), torch.ones(42, 1)).save("ball.glb")
            >>> nr.Rig.load("ball.glb")
            Rig(42 vertices, 1 joints, 0 morph targets, 0 animations)
        """
        path = Path(path)
        if path.suffix.lower() != ".glb":
            raise ValueError(f"path: expected a name that ends in .glb, got {path.name!r}")
        if self.joint_targets is not None:
            raise ValueError("joint_targets: expected None, since glTF has no morph targets of joints, got some")
        if not isinstance(self.mesh, UVMesh):
            raise TypeError(f"mesh: expected a UVMesh, got {type(self.mesh).__name__}")
        write_file(path, encoded_rig(self, self._inverse_bind(self.target_weights)))

    @property
    def rest(self) -> Pose:
        """The pose at rest."""
        return Pose(self.translations, self.rotations, self.scales, self.target_weights)

    def pose(self, angles: Any = None, weights: Any = None, *, rotation: Any = None, translation: Any = None) -> Pose:
        """Make a pose that differs from rest.

        Args:
            angles: [..., J, 3] rotation vectors in radians, about the axes of the joints; None: at rest.
            weights: [..., M] of the morph targets; None: those at rest.
            rotation: [..., 3] rotation vector of the whole mesh about the world's origin, applied after the joints.
            translation: [..., 3] translation of the whole mesh, applied last, in units of the mesh.

        Returns:
            The pose, with broadcast batch dimensions.

        Raises:
            TypeError, ValueError: A type or shape does not fit, or a number is not finite.

        Example:
            >>> ball = nr.Mesh.icosphere(1)
            >>> rig = nr.Rig(ball, [-1], torch.zeros(1, 3), torch.ones(42, 1))
            >>> moved = rig.vertices(rig.pose(translation=torch.tensor([1.0, 0.0, 0.0])))
            >>> bool((moved - ball.vertices - torch.tensor([1.0, 0.0, 0.0])).abs().max() < 1e-6)
            True
        """
        translations, rotations, scales, target_weights = self.rest
        if angles is not None:
            self._checked("angles", angles, len(self.parents), 3)
            rotations = rotations @ rotation_formulas.from_axis_angle(angles)
        if weights is not None:
            target_weights = self._checked("weights", weights, len(self.targets))
        roots = torch.tensor([parent < 0 for parent in self.parents], device=translations.device)[:, None]
        if rotation is not None:
            matrix = rotation_formulas.from_axis_angle(self._checked("rotation", rotation, 3))[..., None, :, :]
            rotations = torch.where(roots[..., None], matrix @ rotations, rotations)
            translations = torch.where(roots, (matrix @ translations[..., None])[..., 0], translations)
        if translation is not None:
            translations = translations + roots * self._checked("translation", translation, 3)[..., None, :]
        return Pose(translations, rotations, scales, target_weights)

    def animated(self, time: Any, animation: int | str = 0) -> Pose:
        """Sample an animation. Properties without a track are at rest.

        Args:
            time: Seconds from its start, or an array or tensor of them, [N]; constant before the first and after the
                last key.
            animation: Number or name.

        Returns:
            The pose; with a batch dimension [N] for several times.

        Raises:
            ValueError: There is no such animation, or a time is not finite.

        Example:
            >>> import numpy as np
            >>> from neural_renderer.io.gltf.rig_reader import Track
            >>> track = Track(0, "translation", np.array([0.0, 2.0]), np.array([[0.0, 0, 0], [4.0, 0, 0]]))
            >>> ball = nr.Mesh.icosphere(1)
            >>> rig = nr.Rig(ball, [-1], torch.zeros(1, 3), torch.ones(42, 1), animations={"go": [track]})
            >>> rig.animated(0.5, "go").translations
            tensor([[1., 0., 0.]])
        """
        times = np.atleast_1d(np.asarray(time, dtype=np.float64))
        if not np.isfinite(times).all():
            raise ValueError(f"time: expected finite seconds, got {short(time)}")
        count = len(times)
        translations, rotations, scales, weights = (part.expand(count, *part.shape).clone() for part in self.rest)
        for tracks in alike(self._tracks(animation)):
            values = torch.from_numpy(sampled(tracks, times)).to(translations)
            joints, path = [track.joint for track in tracks], tracks[0].path
            if path == "translation":
                translations[:, joints] = values
            elif path == "rotation":
                rotations[:, joints] = rotation_formulas.from_quaternion(values[..., [3, 0, 1, 2]])
            elif path == "scale":
                scales[:, joints] = values
            else:
                for first, row in zip(joints, values.unbind(1), strict=True):
                    weights[:, first : first + row.shape[1]] = row
        pose = Pose(translations, rotations, scales, weights)
        return pose if np.ndim(time) else Pose(*(part[0] for part in pose))

    def duration(self, animation: int | str = 0) -> float:
        """Return the time of an animation's last key, in seconds.

        Args:
            animation: Number or name.

        Returns:
            The time; 0 without tracks.

        Raises:
            ValueError: There is no such animation.

        Example:
            >>> rig = nr.Rig(nr.Mesh.icosphere(1), [-1], torch.zeros(1, 3), torch.ones(42, 1), animations={"none": []})
            >>> rig.duration("none")
            0.0
        """
        return max((float(track.times[-1]) for track in self._tracks(animation)), default=0.0)

    def vertices(self, pose: Pose | None = None) -> Tensor:
        """Deform the mesh.

        Args:
            pose: The pose; None: at rest.

        Returns:
            [..., V, 3] in the world, with the batch dimensions of the pose.

        Raises:
            RuntimeError: Tensors of the pose do not fit the rig.

        Example:
            >>> rig = nr.Rig(nr.Mesh.icosphere(1), [-1], torch.zeros(1, 3), torch.ones(42, 1))
            >>> rig.vertices().shape
            torch.Size([42, 3])
        """
        pose = pose or self.rest
        linear, offset = self._blended(pose)
        points = self.mesh.vertices
        if len(self.targets):
            points = points + (pose.weights @ self.targets.flatten(1)).unflatten(-1, points.shape)
        return (linear @ points[..., None])[..., 0] + offset

    def joints(self, pose: Pose | None = None) -> Tensor:
        """Compute the positions of the joints.

        Args:
            pose: The pose; None: at rest.

        Returns:
            [..., J, 3] in the world.

        Raises:
            RuntimeError: Tensors of the pose do not fit the rig.

        Example:
            >>> rig = nr.Rig(nr.Mesh.icosphere(1), [-1], torch.zeros(1, 3), torch.ones(42, 1))
            >>> rig.joints()
            tensor([[0., 0., 0.]])
        """
        return self._frames(pose or self.rest)[1]

    def posed(self, pose: Pose | None = None) -> Any:
        """Deform the mesh, with its normals and tangents.

        Args:
            pose: A pose without batch dimensions; None: at rest.

        Returns:
            The mesh, for `render`.

        Raises:
            RuntimeError: Tensors of the pose do not fit the rig.

        Example:
            >>> rig = nr.Rig(nr.Mesh.icosphere(1), [-1], torch.zeros(1, 3), torch.ones(42, 1))
            >>> rig.posed()
            Mesh(42 vertices, 80 faces, textures of 4³, cpu)
        """
        pose = pose or self.rest
        parts: dict[str, Any] = {"vertices": self.vertices(pose)}
        if getattr(self.mesh, "normals", None) is not None:
            linear = self._blended(pose)[0][self.mesh.faces.long()]  # of corners, [F, 3, 3, 3]
            # Normals are transformed by the cofactor matrix, whose rows are cross products.
            a, b, c = linear.unbind(-2)
            cofactors = torch.stack([torch.linalg.cross(*rows) for rows in ((b, c), (c, a), (a, b))], -2)
            sign = torch.where((a * cofactors[..., 0, :]).sum(-1, keepdim=True) < 0, -1.0, 1.0)
            normals = sign * (cofactors @ self.mesh.normals[..., None])[..., 0]
            parts["normals"] = functional.normalize(normals, dim=-1)
            if self.mesh.tangents is not None:
                along, hand = self.mesh.tangents.split((3, 1), -1)
                along = functional.normalize((linear @ along[..., None])[..., 0], dim=-1)
                parts["tangents"] = torch.cat((along, hand * sign), -1)
        return self.mesh.replace(**parts)

    def at(self, time: float, animation: int | str = 0) -> Any:
        """Deform the mesh by an animation at a time.

        Args:
            time: Seconds from its start.
            animation: Number or name.

        Returns:
            The mesh, for `render`.

        Raises:
            ValueError: As `animated`.

        Example:
            >>> rig = nr.Rig(nr.Mesh.icosphere(1), [-1], torch.zeros(1, 3), torch.ones(42, 1), animations={"none": []})
            >>> rig.at(0.5, "none").num_vertices
            42
        """
        return self.posed(self.animated(time, animation))

    def _tracks(self, animation: int | str) -> Sequence[Track]:
        known = self.animations or {}
        name = list(known)[animation] if isinstance(animation, int) and 0 <= animation < len(known) else animation
        if not known:
            raise ValueError("animation: expected a rig with animations, got one without")
        if name not in known:
            expected = ", ".join(map(short, known))
            raise ValueError(f"animation: expected {expected} or a number below {len(known)}, got {short(animation)}")
        return known[name]  # type: ignore[index]

    def _checked(self, name: str, value: Any, *shape: int) -> Tensor:
        value = as_tensor(value)
        validate.floating(name, value, (*["..."] * (getattr(value, "ndim", 0) - len(shape)), *shape))
        validate.finite(name, value)
        return value.to(self.translations)

    def _frames(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Compute the joints' world transforms, [..., J, 3, 3] and [..., J, 3]."""
        translations = pose.translations
        if self.joint_targets is not None:
            grown = pose.weights @ self.joint_targets.flatten(1)
            translations = translations + grown.unflatten(-1, self.translations.shape)
        linear = pose.rotations * pose.scales[..., None, :]
        return self._tree.frames(linear, translations)  # type: ignore[attr-defined]

    def _inverse_bind(self, weights: Tensor) -> Any:
        """Return the matrices [B, 4, 4]; if not given, those of the joints at rest with these target weights."""
        if self.inverse_bind is not None:
            return self.inverse_bind
        linear, offset = self._frames(self.rest._replace(weights=weights))
        inverse = torch.linalg.inv(linear[..., self.bones, :, :])
        return inverse, -(inverse @ offset[..., self.bones, :, None])[..., 0]

    def _blended(self, pose: Pose) -> tuple[Tensor, Tensor]:
        """Compute the motion of each vertex, [..., V, 3, 3] and [..., V, 3]."""
        linear, offset = self._frames(pose)
        bind = self._inverse_bind(pose.weights)
        if isinstance(bind, Tensor):
            bind = bind[:, :3, :3], bind[:, :3, 3]
        linear, offset = linear[..., self.bones, :, :], offset[..., self.bones, :]
        offset = (linear @ bind[1][..., None])[..., 0] + offset
        motions = torch.cat(torch.broadcast_tensors(*(linear @ bind[0]).unbind(-1), offset), -1)  # [..., B, 12]
        if len(self.bones) <= _MOST_DENSE:
            table = self.weights.new_zeros(len(self.weights), len(self.bones))
            blended = table.scatter_add(1, self.indices, self.weights) @ motions
        else:
            blended = sum(  # type: ignore[assignment]
                motions[..., index, :] * weight[:, None]
                for index, weight in zip(self.indices.unbind(1), self.weights.unbind(1), strict=True)
            )
        columns = blended.unflatten(-1, (4, 3)).transpose(-1, -2)
        return columns[..., :3], columns[..., 3]
