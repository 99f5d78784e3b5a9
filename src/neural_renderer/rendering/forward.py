"""Rendering of a scene: a mesh, a batch of cameras, lights and a background."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..base import validate
from ..camera import Camera
from ..camera.screen import causes, scene_camera, screen_corners
from ..meshes.batch import as_mesh, kind_of_colors, mesh_parts
from ..meshes.mesh import Mesh
from ..meshes.uv_mesh import UVMesh
from ..raster.ahead import CUBES, IMAGES, SCENE, load_kernels
from ..raster.background import background_image
from ..raster.colors.composite import composite
from ..raster.colors.downsample import in_blocks, whole
from ..raster.colors.light_pixels import light_pixels
from ..raster.colors.texture_cubes import CornerColors
from ..raster.cube_colors import PackedCubes, checked_textures, cube_colors
from ..raster.depth_limits import tell_what_is_cut
from ..raster.fragments import Fragments, visible_fragments, visible_layers
from ..raster.outputs import OUTPUTS, SURFACE, Images, checked_outputs
from ..raster.settings import Settings
from ..raster.visibility.estimators import Estimator
from ..raster.warp.elementwise import apart
from ..shading.lights import AnyLight, CameraLight, checked_lights, light_factors, seen_by, without_unlit
from ..shading.pixels.models import Shading, checked_shading, flat_edge_hashes, shade_pixels, surface_edge_hashes
from . import strips
from .replayed import replayed
from .surface_images import surface_images, surface_outputs
from .transparency import layered_images

Colors = tuple[Tensor, Callable[[], Tensor] | None, CornerColors | None]  # as from `cube_colors`

# Options of `render` that `_prepared` takes, in this order.
_OPTIONS = (
    "light", "shading", "outputs", "near", "far", "anti_aliasing", "two_sided", "gradient", "eps", "layers"
)  # fmt: skip


@validate.checked_together
def render(
    mesh: Mesh | UVMesh | list[Mesh] | list[UVMesh] | tuple[Tensor, ...],
    camera: Camera | None,
    size: int | tuple[int, int] = 256,
    *,
    light: AnyLight | CameraLight | Sequence[AnyLight | CameraLight] | None = CameraLight(),  # noqa: B008 (immutable)
    shading: str | Shading = "flat",
    background: Any = (0.0, 0.0, 0.0),
    outputs: Collection[str] = OUTPUTS,
    near: float | None = None,
    far: float | None = None,
    anti_aliasing: bool = True,
    two_sided: bool = True,
    gradient: str | Estimator = "edge",
    eps: float = 1e-3,
    layers: int | None = None,
    tile: int | None = None,
) -> Images:
    """Render a mesh from every camera of a batch, differentiably.

    One mesh is drawn from all cameras, and one camera sees all meshes. Gradients reach vertices, textures or images,
    the parameters of cameras and lights, and the background.

    Args:
        mesh: `Mesh` or `UVMesh`; a list of either, of any sizes, one per image (see `batch`); a ``trimesh.Trimesh`` or
            ``Scene`` (see `UVMesh.from_trimesh`, once for many calls); or (vertices, faces), which is white, or
            (vertices, faces, textures) with vertices [V, 3] or [B, V, 3] floating, faces [F, 3] or [B, F, 3] integer,
            textures [F, T, T, T, 3] or [B, F, T, T, T, 3] floating, or colours of the faces' corners [F, 3, 3] or
            [B, F, 3, 3]; tensors or arrays.
        camera: One camera or B of them; None for vertices in clip space, [V, 4] or [B, V, 4], whose "rgb" needs
            ``light=None``.
        size: Side of the images, or (height, width), in pixels, for all images. Pixels are square. Images of different
            sizes take a call each: ``[nr.render(mesh, one, size) for one, size in zip(camera, sizes)]``.
        light: `CameraLight`, `Light`, `PointLight`, `SpotLight`, `SphericalHarmonicLight`, `EnvironmentLight`; another
            object with the method `two_sided`, for flat shading, or with `beam` or `ambience`, for the others; or a
            list of lights, which add up. None draws textures without lighting.
        shading: ``"flat"`` lights each face as a whole. The others light each pixel, with smooth normals and the normal
            maps of materials: ``"smooth"`` a matt surface, ``"phong"`` also highlights, ``"pbr"`` metals and
            dielectrics; with the mesh's materials, or `Phong` or `PBR` for a mesh without. Or an object with their
            method `shade`.
        background: Number; colour [3] or [B, 3]; or image of the returned size, [3, H, W] or [H, W, 3] (as `load_image`
            reads it), or a batch of them. A shape that fits both has its channels first.
        outputs: Some of "rgb", "alpha", "depth", "normal", "position", "uv", "face_index", "barycentric"; `Images`
            explains them. Only these are computed.
        near, far: Depth range in world units, 0 <= near < far; a point is visible if near < depth < far. None, the
            default, draws all that is in front of the camera, at any scale. "depth" is ``far`` where no face is
            visible; without ``far``, it is 100, or 1.05 times the depth of the mesh's farthest corner if that is more.
        anti_aliasing: Supersample: render at twice the size and average 2 x 2 pixels.
        two_sided: Render also back faces.
        gradient: Estimator of the gradient through visibility: ``"edge"``, unbiased, ``"nmr"``, the paper's, or
            ``"opendr"``, a comparator (see `rasterize_images`).
        eps: Added to distances in the denominators of ``"nmr"``, in screen units; cube coordinates end at T - 1 - eps.
        layers: Number of faces that are blended at each pixel, for a `UVMesh` whose materials are transparent, cut out
            or not double-sided. None draws the visible faces, all opaque. Depth is that of the nearest face.
        tile: For images larger than the memory: render strips of about tile² pixels, one after the other. The images
            are bitwise equal. Backward renders each strip again, so that gradients take the memory of one strip, too;
            not with ``"nmr"`` and ``"opendr"``, whose gradients act over the whole image. `torch.func` takes the memory
            of all strips. ≥ 16; None draws all at once.

    Returns:
        Images with rgb [B, 3, H, W], alpha [B, H, W] and depth [B, H, W] float32, and the other ``outputs``.
        Row 0 is at the top.

    Raises:
        TypeError: An argument of another type.
        ValueError: An argument of another shape, device or range, or values that are NaN or infinite.

    Warns:
        UserWarning: ``near`` and ``far`` cut a part of the mesh away, or all of it is behind every camera; once for
            each line that calls, while values are checked.

    Example:
        >>> mesh = nr.Mesh.icosphere()
        >>> eye = nr.get_points_from_angles(2.7, 30.0, torch.linspace(0, 315, 8))
        >>> images = nr.render(mesh, nr.Camera.look_at(eye, viewing_angle=30), (120, 160))
        >>> images.rgb.shape
        torch.Size([8, 3, 120, 160])
    """
    options = (light, shading, outputs, near, far, anti_aliasing, two_sided, gradient, eps, layers)  # _OPTIONS
    if tile is None and (images := replayed(_drawn, mesh, camera, size, background, *options)):
        return images
    draw, settings, corners = _prepared(mesh, camera, size, *options)
    if tile is None:
        return draw(settings, background)
    if layers is not None:
        raise ValueError(f"tile: expected None with layers, got {tile}")
    return strips.drawn_whole(draw, settings, background, corners, validate.whole("tile", tile, 16))


def _drawn(mesh: Any, camera: Camera | None, size: Any, background: Any, *options: Any) -> Images:
    draw, settings, _ = _prepared(mesh, camera, size, *options)
    return draw(settings, background)


def render_strips(mesh: Any, camera: Camera, size: tuple[int, int], tile: int, **options: Any) -> Iterator[Images]:
    """Render an image like `render`, and yield it in strips of about tile² pixels, from the top; without gradients."""
    draw, settings, corners = _prepared(mesh, camera, size, *_given(options))
    background = options.get("background", _DEFAULTS["background"].default)
    yield from strips.drawn_strips(draw, settings, background, len(corners), corners.device, tile)


@torch.no_grad()
def render_rows(mesh: Any, camera: Camera, size: int | tuple[int, int], **options: Any) -> tuple[Images, slice]:
    """Render the rows of an image that show the mesh, like `render` over black; return also their range."""
    draw, settings, corners = _prepared(mesh, camera, size, *_given(options))
    rows = strips.rows_with(corners, settings)
    return draw(settings.strip(rows.start, rows.stop), 0.0), rows


def _given(options: dict[str, Any]) -> list[Any]:
    """Return the options that `_prepared` takes, with the defaults of `render`."""
    return [options.get(name, _DEFAULTS[name].default) for name in _OPTIONS]


_DEFAULTS = inspect.signature(render).parameters


def _prepared(
    mesh: Any, camera: Camera | None, size: int | tuple[int, int], *options: Any
) -> tuple[strips.Draw, Settings, Tensor]:
    """Check the arguments of `render`; return the drawing function, the settings, and corners [B, F, 3, 3]."""
    light, shading, outputs, near, far, anti_aliasing, two_sided, gradient, eps, layers = options  # _OPTIONS
    scene = as_mesh(mesh)
    vertices, faces, textures = mesh_parts(scene)
    model = checked_shading(shading)
    lights = checked_lights(light, flat=model is None)
    outputs = checked_outputs(outputs, OUTPUTS + SURFACE)
    if camera is None and (lights or model is not None) and "rgb" in outputs:
        raise ValueError('light: expected None, and shading "flat", to draw "rgb" of vertices in clip space')
    has_camera = camera is not None
    vertices, camera = scene_camera(vertices, camera)
    if "rgb" in outputs:
        lights = [seen_by(camera, light) if isinstance(light, CameraLight) else light for light in lights]
    surface = surface_outputs(outputs, scene, has_camera)
    settings = Settings.checked(size, near, far, eps, anti_aliasing, two_sided, camera.perspective, gradient)
    aspect = settings.width / settings.height
    load_kernels(
        settings, outputs, IMAGES if isinstance(scene, UVMesh) else CUBES, *causes(vertices, camera), scene=SCENE
    )
    vertices, lit_vertices = apart(vertices, 2) if model is None else (vertices, vertices)
    corners, faces = screen_corners(camera, vertices, faces, aspect)
    tell_what_is_cut(corners, near, far)
    if layers is not None:
        if not isinstance(scene, UVMesh):
            raise TypeError(f"mesh: expected a UVMesh to draw layers, got {type(mesh).__name__}")
        if surface:
            raise ValueError(f"outputs: expected some of {', '.join(OUTPUTS)} with layers, got {surface[0]}")
        layers = validate.whole("layers", layers, 1)
    factors = None  # light on both sides of faces, [B, 2, F, 3]
    if "rgb" in outputs and model is None and lights:
        factors = without_unlit(light_factors(lights, lit_vertices, faces, len(corners), camera.mirrored), scene)

    def draw(settings: Settings, background: Any) -> Images:
        if layers is not None:
            found = visible_layers(corners, faces, vertices.shape[-2], settings, layers)
            return layered_images(found, scene, camera, lights, model, factors, background, outputs)
        visible = visible_fragments(corners, faces, vertices.shape[-2], settings, 1 + 3 * ("rgb" in outputs))
        colors: tuple[Any, ...] = ()
        if "rgb" in outputs and model is not None:
            colors = _shaded(visible, scene, textures, camera, lights, model, background)
        elif "rgb" in outputs:
            colors = flat_colors(visible, scene, textures, factors, background)
        images = visible.images(outputs, *colors)
        if not surface:
            return images
        return images.replace(**surface_images(surface, visible, scene, camera, model is not None))

    return draw, settings, corners


def _checked_cubes(textures: Tensor | PackedCubes | None, faces: Tensor) -> Tensor | PackedCubes:
    """Return texture cubes [B or 1, F, T, T, T, 3], colours of corners [B or 1, F, 3, 3], or packed cubes.

    Without textures faces are white. Raises TypeError or ValueError.
    """
    if isinstance(textures, PackedCubes):
        return textures
    if textures is None:
        return torch.ones((1, faces.shape[-2], 1, 1, 1, 3), device=faces.device)
    shared = getattr(textures, "ndim", 6) in (3, 5)
    textures = checked_textures(textures, *(("F",) if shared else ("B", "F")))
    return textures[None] if shared else textures


def flat_colors(
    visible: Fragments, mesh: Any, textures: Tensor | PackedCubes | None, light: Tensor | None, background: Any
) -> Colors:
    """Compute an image's colours from texture images or ``textures``; arguments and results as in `cube_colors`."""
    if isinstance(mesh, UVMesh):
        return _image_colors(visible, mesh, light, background)
    return _cube_colors(visible, mesh, textures, light, background)


def _cube_colors(
    visible: Fragments, mesh: Any, textures: Tensor | PackedCubes | None, light: Tensor | None, background: Any
) -> Colors:
    """Compute an image's colours from textures, or colours of vertices or faces; results as in `cube_colors`."""
    kind = kind_of_colors(mesh)
    with validate.called(textures=kind):
        cubes = _checked_cubes(textures, visible.triangles)
        return cube_colors(visible, cubes, light, background, of_vertices=kind == "vertex_colors")


def _shaded(
    visible: Fragments,
    mesh: Any,
    textures: Tensor | PackedCubes | None,
    camera: Camera,
    lights: list[AnyLight],
    model: Shading | str,
    background: Any,
) -> tuple[Tensor, Callable[[], Tensor] | None]:
    """Compute an image's colours by per-pixel lighting; the first two results as in `cube_colors`."""
    inside = visible.for_shading
    if isinstance(mesh, UVMesh):
        albedo = mesh.shade(inside)
    else:
        rgb, edge_hashes, _ = _cube_colors(inside, mesh, textures, None, 0.0)
        albedo = whole(rgb).movedim(1, -1)
    colors = shade_pixels(model, inside, mesh, albedo, camera, lights)
    behind = background_image(background, len(colors), 3, visible.settings, colors.device)
    hashes = partial(surface_edge_hashes, mesh) if isinstance(mesh, UVMesh) else edge_hashes
    return in_blocks(visible.in_blocks, composite, colors, behind, visible.face_index), hashes


def _image_colors(visible: Fragments, mesh: UVMesh, light: Tensor | None, background: Any) -> Colors:
    """Compute an image's colours from texture images; arguments and results as in `cube_colors`."""
    color = mesh.shade(visible.for_shading)
    behind = background_image(background, len(color), 3, visible.settings, color.device)
    if light is None:
        rgb = in_blocks(visible.in_blocks, composite, color, behind, visible.face_index)
    else:
        scene = (visible.corners.detach(), visible.face_index, visible.settings.perspective)
        rgb = in_blocks(visible.in_blocks, light_pixels, color, behind, light, *scene)
    interpolates = not mesh.images and mesh.tints is None and not any(material.is_tinted for material in mesh.materials)
    colors = mesh.colors if mesh.colors.dim() == 4 else mesh.colors[None]
    return rgb, partial(flat_edge_hashes, mesh, light), CornerColors(colors, light) if interpolates else None
