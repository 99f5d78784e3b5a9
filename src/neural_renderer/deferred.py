"""Shading of one's own: what each pixel shows, anything interpolated there, and the image made of the result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from . import validate
from .camera import Camera
from .meshes.batch import mesh_parts
from .meshes.mesh import Mesh
from .meshes.uv_mesh import UVMesh
from .raster.ops.barycentrics import barycentrics
from .raster.ops.composite import composite
from .raster.ops.corners import gather_corners
from .raster.ops.downsample import halve
from .raster.ops.interpolate import interpolate
from .raster.rasterize import behind_image, checked_faces, vertices_to_faces
from .raster.settings import Settings


@dataclass(frozen=True, eq=False)
class Fragments:
    """What is seen at each pixel of B images of H x W; twice the size asked for if they are anti-aliased.

    Attributes:
        corners: [B, F, 3, 3] float32, the faces' corners on the screen.
        triangles: [F, 3] or [B, F, 3], the faces' vertices.
        face_index: [B, H, W] int32, the face that is seen; -1 for none. Row 0 is at the top.
        settings: how it was drawn.
        rings: as `Settings.rings` gives them.
    """

    corners: Tensor
    triangles: Tensor
    face_index: Tensor
    settings: Settings
    rings: Tensor | None = None

    @property
    def weights(self) -> Tensor:
        """[B, H, W, 3], the shares of the face's corners in the point that is seen, perspective-correct, of sum 1."""
        return self._points[0]

    @property
    def depth(self) -> Tensor:
        """[B, H, W], along the viewing axis in world units, ``far`` where no face is seen."""
        return self._points[1]

    @property
    def _points(self) -> tuple[Tensor, Tensor]:
        # Made when they are first asked for, and kept, but not without a gradient for those who ask for it later.
        points = self.__dict__.get("_kept")
        if points is None:
            points = barycentrics(
                self.corners, self.face_index, self.settings.near, self.settings.far, self.settings.perspective
            )
            if torch.is_grad_enabled() or not (self.corners.requires_grad or torch.is_inference_mode_enabled()):
                self.__dict__["_kept"] = points
        return points

    @property
    def mask(self) -> Tensor:
        """[B, H, W] bool: whether a face is seen."""
        return self.face_index >= 0

    def interpolate(self, attributes: Tensor, triangles: Tensor | None = None) -> Tensor:
        """Attributes at every pixel, [B, H, W, C] float32, 0 where no face is seen.

        attributes: [V, C] or [B, V, C] floating, one for each vertex, any number of channels.
        triangles: [F, 3] or [B, F, 3] integer, which attributes belong to a face's corners, where they have an order of
            their own, as texture coordinates have; None: the mesh's own faces.

        Gradients reach the attributes and, through the weights, vertices and camera (``gradient="edge"``).
        Raises TypeError or ValueError for other types, shapes, devices or indices.
        """
        shape = ("V", "C") if getattr(attributes, "ndim", 3) == 2 else ("B", "V", "C")
        validate.floating("attributes", attributes, shape)
        triangles = self.triangles if triangles is None else checked_faces(triangles)
        validate.same_device(attributes=attributes, triangles=triangles, faces=self.corners)
        validate.finite("attributes", attributes)
        attributes = attributes if attributes.dim() == 3 else attributes[None]
        triangles = triangles if triangles.dim() == 3 else triangles[None]
        batch, count = self.corners.shape[:2]
        if attributes.shape[0] not in (1, batch) or triangles.shape[0] not in (1, batch):
            raise ValueError(
                f"attributes: expected a batch of 1 or {batch}, got {len(attributes)}, {len(triangles)} triangles"
            )
        if triangles.shape[1] != count:
            raise ValueError(f"triangles: expected {count} like the mesh's faces, got {triangles.shape[1]}")
        validate.in_range("triangles", triangles, attributes.shape[1])
        own = gather_corners(attributes.float().expand(max(len(attributes), len(triangles)), -1, -1), triangles.int())
        return interpolate(own, self.corners, self.face_index, self.settings.perspective)

    def composite(self, colors: Tensor, background: Any = 0.0, *, seams: bool = False) -> Tensor:
        """The images [B, C, height, width] float32 of colours, with the gradient through visibility.

        colors: [B, H, W, C] floating, of each pixel that shows a face; what others hold does not matter.
        background: a number; a colour [C] or [B, C]; or an image [C, height, width] or [B, C, height, width]. It gets
            gradients.
        seams: colours may jump where two faces of the surface meet, as with texture charts that do not match or light
            by the face: then ``"edge"`` looks for their motion there too. Without, which is quicker and less noisy,
            colours have to be continuous over the surface, or its gradient is wrong at the jumps.

        Raises TypeError or ValueError for other types, shapes or devices.
        """
        batch, rows, columns = self.face_index.shape
        validate.floating("colors", colors, (batch, rows, columns, "C"))
        validate.same_device(colors=colors, faces=self.corners)
        channels = colors.shape[3]
        behind = behind_image(background, batch, channels, self.settings, colors.device)
        image = composite(colors.float(), behind, self.face_index)
        validate.finite("colors", image)
        seams = validate.flag("seams", seams)
        image = self.settings.through_visibility(image, self.corners, self.face_index, seams, rings=self.rings)
        return halve(image) if self.settings.anti_aliasing else image.contiguous()


def fragments(
    mesh: Mesh | UVMesh | tuple[Tensor, Tensor],
    camera: Camera,
    size: int | tuple[int, int] = 256,
    *,
    near: float = 0.1,
    far: float = 100.0,
    anti_aliasing: bool = True,
    two_sided: bool = True,
    gradient: str = "edge",
    eps: float = 1e-3,
) -> Fragments:
    """What every camera of a batch sees of a mesh, to be shaded by any torch code.

    mesh: a `Mesh`, a `UVMesh`, or (vertices, faces) with vertices [V, 3] or [B, V, 3] floating and faces [F, 3] or
        [B, F, 3] integer.
    camera, size, near, far, anti_aliasing, two_sided, gradient, eps: as in `render`.

    Raises TypeError or ValueError with a sentence for anything that does not fit.

    >>> mesh = Mesh.icosphere()
    >>> seen = fragments(mesh, Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30), 64)
    >>> normals = torch.nn.functional.normalize(seen.interpolate(mesh.vertices), dim=-1)
    >>> seen.composite(normals.clamp(min=0), background=1.0).shape
    torch.Size([1, 3, 64, 64])
    """
    vertices, faces, _ = mesh_parts(mesh)
    if not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a Camera, got {type(camera).__name__}")
    settings = Settings.checked(
        size, near, far, eps, anti_aliasing, two_sided, camera.perspective, gradient, name="size"
    )
    return seen_on(camera(vertices, aspect=settings.width / settings.height), faces, settings)


def seen_on(screen: Tensor, faces: Tensor, settings: Settings) -> Fragments:
    """`fragments` of vertices [B, V, 3] that are on the screen already."""
    faces = checked_faces(faces)
    corners = settings.corners(vertices_to_faces(screen, faces), 8)
    face_index = settings.face_index(corners)
    return Fragments(corners, faces, face_index, settings, settings.rings(corners, faces))
