"""`neural-renderer render`: a mesh file as a picture or a turntable."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor

from .. import deferred
from ..camera import Camera, get_points_from_angles
from ..io import load_mesh, save_animation, save_image
from ..meshes.mesh import Mesh
from ..meshes.normals import vertex_normals
from ..meshes.uv_mesh import UVMesh
from ..pictures.lamp import lamp_direction
from ..raster.settings import image_size
from ..rendering import render
from ..shading.lights import Light
from .common import check_counts, check_outputs, choose_device, say
from .options.render import RenderOptions

_LAMP = (-0.4, 0.6, 0.7)  # right, up, backward; more frontal than `pictures.lamp.LAMP`: no visible face is dark
_AMBIENT, _DIRECTIONAL = 0.4, 0.65
_COLORS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0), "transparent": (0.0, 0.0, 0.0)}
_GREY = 0.82  # colour of meshes without colours
_MARGIN = 1.05  # factor on the least distance at which the whole mesh is in the picture
_PLANES = 1.1  # distance of the near and far planes from the origin, in radii of the mesh
_FRAMES = 60  # of a turntable by default
_DEPTH_CONTRAST = 0.8  # difference of grey between the nearest and the farthest point
_PICTURES, _ANIMATIONS = (".png", ".jpg", ".jpeg"), (".gif", ".mp4")


def run(options: RenderOptions) -> int:
    """Draw a mesh file; return the exit code."""
    _check(options)
    check_outputs([options.output], [options.mesh])
    device = choose_device(options.device)
    mesh = _load(options).to(device)
    mesh = mesh.normalize() if options.normalize else mesh
    animated = options.output.suffix.lower() in _ANIMATIONS
    count = (options.turntable or _FRAMES) if animated else 1
    angles = [options.azimuth + 360 * index / count for index in range(count)]
    pictures: Iterator[Tensor] = (draw(options, mesh, angle).cpu() for angle in angles)
    if animated:
        console = Console(stderr=True)
        tracked = track(pictures, "Turntable", total=count, console=console, transient=True)
        save_animation(options.output, tracked, options.fps)
    else:
        save_image(options.output, next(pictures))
    say(str(options.output))
    return 0


def _load(options: RenderOptions) -> Mesh | UVMesh:
    """Load the mesh, with images or, if --texture-size is given, with texture cubes."""
    if options.texture_size is None:
        return UVMesh.load(options.mesh, _GREY, options.allow_outside)
    vertices, faces, textures = load_mesh(options.mesh, options.texture_size, options.allow_outside)
    if textures is None:
        textures = torch.full((len(faces), 1, 1, 1, 3), _GREY)
    return Mesh(vertices, faces, textures)


def _check(options: RenderOptions) -> None:
    """Raise ValueError for options that are out of range or do not fit each other."""
    suffix = options.output.suffix.lower()
    if suffix not in _PICTURES + _ANIMATIONS:
        expected = ", ".join(_PICTURES + _ANIMATIONS)
        raise ValueError(f"--output: expected a name that ends in {expected}, got {options.output.name!r}")
    check_counts(options, turntable=1, texture_size=1)
    if options.turntable is not None and suffix in _PICTURES:
        raise ValueError(f"--output: expected a .gif or .mp4 for a turntable, got {options.output.name!r}")
    image_size("size", options.size)
    _check_between("fps", options.fps, 0, math.inf)
    _check_between("viewing-angle", options.viewing_angle, 0, 90)
    _check_between("elevation", options.elevation, -90, 90)
    if not math.isfinite(options.azimuth):
        raise ValueError(f"--azimuth: expected a finite number of degrees, got {options.azimuth}")
    if options.distance is not None:
        _check_between("distance", options.distance, 0, math.inf)
    if options.background is not None and options.mode in ("silhouettes", "depth"):
        raise ValueError(f"--background: expected --mode rgb or normals, got {options.mode} (always on black)")
    if options.background == "transparent" and suffix != ".png":
        raise ValueError(f"--background transparent: expected a .png, got {options.output.name!r}")
    if isinstance(options.background, tuple) and not all(0 <= value <= 1 for value in options.background):
        raise ValueError(f"--background: expected three numbers from 0 to 1, got {options.background}")


def _check_between(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError if an option is not above ``low`` and below ``high``."""
    if not low < value < high:
        limit = f" and below {high}" if math.isfinite(high) else ""
        raise ValueError(f"--{name}: expected a number above {low}{limit}, got {value}")


@torch.no_grad()
def draw(options: RenderOptions, mesh: Mesh | UVMesh, azimuth: float) -> Tensor:
    """Draw one view.

    Args:
        options: The options of the command.
        mesh: The mesh.
        azimuth: Azimuth of the camera in degrees.

    Returns:
        [3, H, W] in [0, 1]; [4, H, W] with a transparent background; [H, W] for silhouettes and depth.
    """
    height, width = (options.size, options.size) if isinstance(options.size, int) else options.size
    size, aspect = (height, width), min(1.0, width / max(height, 1))
    radius = max(mesh.vertices.norm(dim=1).max().item(), 1e-6)
    distance = options.distance
    if distance is None:
        distance = _MARGIN * radius / (math.sin(math.radians(options.viewing_angle)) * max(aspect, 1e-6))
    eye = get_points_from_angles(distance, options.elevation, azimuth).to(mesh.vertices.device)
    scale = aspect / (_MARGIN * radius)
    camera = Camera.look_at(eye, viewing_angle=options.viewing_angle, orthographic=options.orthographic, scale=scale)
    near, far = max(distance - _PLANES * radius, 1e-3 * distance), distance + _PLANES * radius

    if options.mode in ("silhouettes", "depth"):
        shape = mesh.vertices, mesh.faces
        images = render(shape, camera, size, outputs=("alpha", "depth"), near=near, far=far)
        alpha, depth = images.alpha[0], images.depth[0]
        return alpha if options.mode == "silhouettes" else _shade_depth(depth, alpha, far)
    color = options.background if isinstance(options.background, tuple) else _COLORS[options.background or "white"]
    if options.mode == "normals":
        rgb, alpha = _draw_normals(mesh, camera, size, color, near, far)
    else:
        light = Light(_AMBIENT, _DIRECTIONAL, direction=lamp_direction(camera, _LAMP)) if options.light else None
        images = render(mesh, camera, size, light=light, background=color, outputs=("rgb", "alpha"), near=near, far=far)
        rgb, alpha = images.rgb[0], images.alpha[0]
    if options.background != "transparent":
        return rgb
    # Colours over black are multiplied by alpha at the outline; PNG stores them without.
    return torch.cat((rgb / alpha.clamp(min=1e-6), alpha[None]))


def _draw_normals(
    mesh: Mesh | UVMesh,
    camera: Camera,
    size: tuple[int, int],
    background: tuple[float, float, float],
    near: float,
    far: float,
) -> tuple[Tensor, Tensor]:
    """Draw normals in camera space as colours [3, H, W], and the silhouette [H, W]."""
    fragments = deferred.fragments((mesh.vertices, mesh.faces), camera, size, near=near, far=far)
    axes = camera.rotation[0] * camera.rotation.new_tensor([1.0, 1.0, -1.0])[:, None]  # right, up, backward
    normals = fragments.interpolate(vertex_normals(mesh.vertices, mesh.faces)[0] @ axes.T)
    alpha = fragments.composite(torch.ones_like(normals[..., :1]))[0, 0]
    return fragments.composite((normals + 1) / 2, background)[0], alpha


def _shade_depth(depth: Tensor, alpha: Tensor, far: float) -> Tensor:
    """Convert depth to grey [H, W]: the nearest point is white, the farthest dark, the background black."""
    covered = alpha > 0
    if not covered.any():
        return torch.zeros_like(depth)
    # Anti-aliasing mixes the far plane into the depth at the outline; remove its share.
    own = (depth - (1 - alpha) * far) / alpha.clamp(min=1e-6)
    low, high = own[covered].min(), own[covered].max()
    grey = 1 - _DEPTH_CONTRAST * (own - low) / (high - low).clamp(min=1e-6)
    return torch.where(covered, grey * alpha, 0.0)
