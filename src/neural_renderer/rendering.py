"""The modern form: a mesh, a batch of cameras, a light; out come images."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import torch
from torch import Tensor

from . import validate
from .camera import Camera
from .deferred import Fragments, seen_on
from .meshes.batch import mesh_parts
from .meshes.mesh import Mesh
from .meshes.uv_mesh import UVMesh
from .raster.ops.texture_cubes import sample_textures
from .raster.rasterize import (
    OUTPUTS,
    Images,
    behind_image,
    checked_faces,
    checked_outputs,
    finish_images,
    rasterize_images,
    vertices_to_faces,
    world_corners,
)
from .raster.settings import Settings, image_size
from .raster.visibility.continuity import image_marks
from .shading.lights import Light
from .shading.spherical_harmonics import SphericalHarmonicLight

AnyLight: TypeAlias = Light | SphericalHarmonicLight


def render(
    mesh: Mesh | UVMesh | list[Mesh] | tuple[Tensor, ...],
    camera: Camera,
    size: int | tuple[int, int] = 256,
    *,
    light: AnyLight | Sequence[AnyLight] | None = Light(),  # noqa: B008 (immutable)
    background: Any = (0.0, 0.0, 0.0),
    outputs: Collection[str] = OUTPUTS,
    near: float = 0.1,
    far: float = 100.0,
    anti_aliasing: bool = True,
    two_sided: bool = True,
    gradient: str = "nmr",
    eps: float = 1e-3,
) -> Images:
    """Render a mesh from every camera of a batch, differentiably.

    mesh: a `Mesh`; a list of them, of any sizes, one for each image (see `batch`); a `UVMesh`, whose images are sampled
        at every pixel drawn; or (vertices, faces) or (vertices, faces, textures) with vertices [V, 3] or [B, V, 3]
        floating, faces [F, 3] or [B, F, 3] integer, textures [F, T, T, T, 3] or [B, F, T, T, T, 3] floating.
    camera: one camera, or B of them. One mesh is drawn from all cameras, and one camera sees all meshes.
    size: the images' side or (height, width), in pixels; they need not be square, and pixels stay square.
    light: a `Light`, a `SphericalHarmonicLight`, or a list of them, which add up; None draws the textures as they are.
    background, outputs, near, far, anti_aliasing, two_sided, gradient, eps: as in `rasterize_images`.

    Returns Images(rgb [B, 3, H, W], alpha [B, H, W], depth [B, H, W]) float32, row 0 at the top; None for what was not
    asked for. Gradients reach vertices, textures or images, the camera's and the light's parameters and the background.
    Raises TypeError or ValueError with a sentence for anything that does not fit.

    >>> mesh = Mesh.icosphere()
    >>> eye = get_points_from_angles(2.7, 30.0, torch.linspace(0, 315, 8))
    >>> images = render(mesh, Camera.look_at(eye, viewing_angle=30), (120, 160))
    >>> images.rgb.shape
    torch.Size([8, 3, 120, 160])
    """
    vertices, faces, textures = mesh_parts(mesh)
    if not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a Camera, got {type(camera).__name__}")
    lights = _checked_lights(light)
    outputs = checked_outputs(outputs)
    height, width = image_size("size", size)
    screen = validate.in_float32("vertices on the screen", camera(vertices, aspect=width / height))
    faces = checked_faces(faces)
    factors = None
    if lights and "rgb" in outputs:
        corners = world_corners(vertices, faces, len(screen))
        factors = torch.stack([one.two_sided(corners, camera.mirrored) for one in lights]).sum(0)
    if isinstance(mesh, UVMesh) and "rgb" in outputs:
        settings = Settings.checked(
            size, near, far, eps, anti_aliasing, two_sided, camera.perspective, gradient, name="size"
        )
        return _sampled(mesh, seen_on(screen, faces, settings), factors, background, outputs)
    if "rgb" not in outputs:
        textures = None
    elif textures is None:
        raise ValueError('mesh: expected textures to draw "rgb", got (vertices, faces) alone')
    else:
        owners = ("F",) if getattr(textures, "ndim", 6) == 5 else ("B", "F")
        textures = validate.cubes("textures", textures, *owners)
        textures = textures if textures.dim() == 6 else textures[None]
    return rasterize_images(
        vertices_to_faces(screen, faces),
        (height, width),
        outputs=outputs,
        textures=textures,
        light=factors,
        background=background,
        near=near,
        far=far,
        eps=eps,
        anti_aliasing=anti_aliasing,
        two_sided=two_sided,
        perspective=camera.perspective,
        gradient=gradient,
        triangles=faces,
    )


def _sampled(
    mesh: UVMesh, seen: Fragments, factors: Tensor | None, background: Any, outputs: Collection[str]
) -> Images:
    """Images of a mesh whose colours are images; factors: of the light, as `rasterize_images` takes them."""
    settings, corners, face_index = seen.settings, seen.corners, seen.face_index
    still = replace(seen, corners=corners.detach())
    behind = behind_image(background, len(face_index), 3, settings, face_index.device)
    # "nmr" knows nothing of what moves inside of faces.
    color = mesh.shade(still if settings.gradient == "nmr" else seen).movedim(3, 1)
    if factors is not None:
        white = torch.ones((1, len(mesh.faces), 1, 1, 1, 3), device=face_index.device)
        color = color * sample_textures(
            white, factors, torch.zeros_like(color), still.corners, face_index, settings.eps, settings.perspective
        )
    layers = {"rgb": torch.where(seen.mask[:, None], color, behind)}
    return finish_images(
        layers,
        seen.depth if "depth" in outputs else None,
        corners,
        face_index,
        settings,
        outputs,
        lambda: image_marks(mesh.uv, mesh.image_index, factors),
        seen.rings,
    )


def _checked_lights(light: Any) -> list[AnyLight]:
    lights = list(light) if isinstance(light, (list, tuple)) else [] if light is None else [light]
    for one in lights:
        if not isinstance(one, (Light, SphericalHarmonicLight)):
            raise TypeError(f"light: expected a Light, a SphericalHarmonicLight or None, got {type(one).__name__}")
    if light is not None and not lights:
        raise ValueError("light: expected at least one, got an empty list; None draws the textures as they are")
    return lights
