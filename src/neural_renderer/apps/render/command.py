"""`neural-renderer render`: mesh files as pictures or animations, and files of what the pixels show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ...camera import Camera, get_points_from_angles
from ...camera.files.load import load_cameras
from ...io import load_image, load_mesh, save_image
from ...io.image_formats.png import save_png_strips
from ...io.images import as_pixels
from ...meshes.batch import join
from ...meshes.mesh import Mesh
from ...meshes.normals import vertex_normals
from ...meshes.uv_mesh import UVMesh
from ...raster.outputs import Images
from ...raster.settings import image_size
from ...rendering import deferred
from ...rendering.forward import render, render_strips
from ...shading.environments.light import EnvironmentLight
from ...shading.lights import CameraLight
from ..common.checks import check_outputs
from ..common.command import choose_device, say
from ..common.pictures.animation import save_animation
from ..common.pictures.outputs import (
    GREY,
    depth_range,
    distance_to_see,
    draw_outputs,
    looks_smooth,
    radius_of,
    scale_to_see,
)
from ..common.values import save_output
from .animate import Animated
from .names import numbered, scenes
from .options import RenderOptions, check_drawing, has_number, is_animation, is_posed
from .view_sheet import load_for_sheet, view_sheet

_WHITE, _BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
_VIEW = 256  # side of a view of a sheet by default
_SIZE = 512  # side of pictures by default
_FRAMES = 60  # pictures of a turntable by default
_LARGE = 2048  # pictures of more than 2048² pixels are drawn in strips
_TILE = 1448  # of about 1448² pixels: per-pixel shading takes some 350 bytes a pixel
_DEPTH_CONTRAST = 0.8  # difference of grey between the nearest and the farthest point


def run(options: RenderOptions) -> int:
    """Draw mesh files; return the exit code: 0, or 1 if one of several models cannot be drawn."""
    drawings = scenes(options)
    check_drawing(drawings[0])  # they differ in names
    failed = False
    for one in drawings:
        try:
            _draw_scene(one)
        except (OSError, ValueError) as error:
            if len(drawings) == 1:
                raise
            failed = True
            say(" ".join(f"{one.meshes[0]} is not drawn: {error}".split()), "red")
    return int(failed)


def _draw_scene(options: RenderOptions) -> None:
    """Draw mesh files as one scene."""
    outputs = [path for path in (options.output, *(path for _, path in options.save)) if path is not None]
    photo = options.background if isinstance(options.background, Path) else None
    inputs = [*options.meshes, options.camera, options.environment, photo]
    check_outputs(outputs, inputs)
    device = choose_device(options.device)
    frames = Animated(options, GREY, device) if is_posed(options) else None
    mesh = _load(options).to(device) if frames is None else frames.whole()
    if options.shading is None:
        options = replace(options, shading="smooth" if looks_smooth(mesh) else "flat")
    if options.sheet and options.output is not None:
        _draw_sheet(options, mesh, options.output)
        return
    if frames is None and options.normalize and options.camera is None:
        mesh = mesh.normalize()
    cameras, sizes = _cameras(options, mesh)
    surroundings = None if options.environment is None else EnvironmentLight.load(options.environment)

    @cache
    def scenery_of(size: tuple[int, int]) -> _Scenery:
        return _Scenery(options, size, _background(options, size, device), surroundings)

    size, scenery = sizes[0], scenery_of(sizes[0])
    if options.output is not None and is_animation(options.output):
        moving = frames is not None and options.animate is not None
        views: Any = ((one, cameras) for one in frames or ()) if moving else ((mesh, one) for one in cameras)
        count = len(frames or ()) if moving else len(cameras)
        shown = zip(views, sizes * count if moving else sizes, strict=True)
        pictures: Iterator[Tensor] = (scenery_of(area).draw(*view).cpu() for view, area in shown)
        from rich.console import Console  # takes time, which a single picture saves
        from rich.progress import track

        what = "Animation" if moving else "Turntable"
        tracked = track(pictures, what, total=count, console=Console(stderr=True), transient=True)
        if has_number(options.output):
            outputs = [numbered(options.output, number) for number in range(count)]
            check_outputs(outputs, inputs)
            for path, picture in zip(outputs, tracked, strict=True):
                save_image(path, picture)
        else:
            save_animation(options.output, tracked, options.fps)
    elif options.output is not None:
        if scenery.is_streamed:
            pixels = (as_pixels("image", strip) for strip in scenery.strips(mesh, cameras))
            save_png_strips(options.output, pixels, *size)
        else:
            save_image(options.output, scenery.draw(mesh, cameras))
    if options.save:
        near, far = depth_range(mesh, cameras)
        look = scenery.look(cameras)
        images = draw_outputs(mesh, cameras, size, dict(options.save), **look, near=near, far=far, tile=scenery.tile)
        for name, path in options.save:
            save_output(path, images[name], name, options.depth_scale)
    for path in outputs:
        say(str(path))


def _draw_sheet(options: RenderOptions, mesh: Mesh | UVMesh, output: Path) -> None:
    """Draw the views of a mesh with its sizes, and write them."""
    light: Any = CameraLight() if options.light else None
    if options.environment is not None:
        light = EnvironmentLight.load(options.environment)
    counts = [f"faces  {len(mesh.faces):,}", f"vertices  {len(mesh.vertices):,}"]
    lines = [f"file  {', '.join(path.name for path in options.meshes)}", *counts]
    size = _sheet_size(options)
    look = {"light": light, "shading": options.shading, "layers": options.layers, "background": _WHITE}
    save_image(output, view_sheet(mesh, size, lines, **look))
    say(str(output))


def _sheet_size(options: RenderOptions) -> int:
    """Return the side of the pictures of a sheet."""
    return image_size("size", options.size or _VIEW)[0]


def _load(options: RenderOptions) -> Mesh | UVMesh:
    """Load the meshes as one, with images or, if --texture-size is given, with texture cubes."""
    if options.texture_size is None:
        if options.sheet:
            meshes = [load_for_sheet(path, _sheet_size(options), options.allow_outside) for path in options.meshes]
        else:
            meshes = [UVMesh.load(path, GREY, options.allow_outside) for path in options.meshes]
        return meshes[0] if len(meshes) == 1 else join(meshes)
    baked = []
    for path in options.meshes:
        vertices, faces, textures = load_mesh(path, options.texture_size, options.allow_outside)
        if textures is None:
            textures = torch.full((len(faces), *(options.texture_size,) * 3, 3), GREY)
        baked.append(Mesh(vertices, faces, textures))
    return baked[0] if len(baked) == 1 else Mesh(*join(baked))


def _cameras(options: RenderOptions, mesh: Mesh | UVMesh) -> tuple[Camera, list[tuple[int, int]]]:
    """Make the camera of a picture, or those of an animation, and the height and width of the picture of each."""
    animated = is_animation(options.output) and options.animate is None
    given = None if options.size is None else image_size("size", options.size)
    if options.camera is not None:
        cameras, sizes_given = load_cameras(options.camera, given)
        if not animated and options.frame >= len(cameras):
            raise ValueError(f"--frame: expected less than {len(cameras)}, the number of cameras, got {options.frame}")
        photo = _photo_size(options)
        sizes = [image_size("size", given or one or sizes_given[0] or photo or _SIZE) for one in sizes_given]
        if animated and len(set(sizes)) > 1 and not has_number(options.output):
            found = " and ".join(sorted({f"{width} x {height}" for height, width in sizes}))
            raise ValueError(f"--camera: expected one size, --size or numbers such as %03d.png, got {found}")
        cameras, sizes = (cameras, sizes) if animated else (cameras[options.frame], [sizes[options.frame]])
        return cameras.to(mesh.vertices.device), sizes
    size = image_size("size", given or _photo_size(options) or _SIZE)
    count = (options.turntable or _FRAMES) if animated else 1
    azimuth = options.azimuth + 360 * torch.arange(count, dtype=torch.float64) / count
    aspect, radius = size[1] / size[0], radius_of(mesh.vertices)
    distance = options.distance or distance_to_see(radius, options.viewing_angle, aspect)
    eyes = get_points_from_angles(distance, options.elevation, azimuth.to(mesh.vertices))
    lens: dict[str, Any] = {"viewing_angle": options.viewing_angle}
    if options.orthographic:
        lens = {"orthographic": True, "scale": scale_to_see(radius, aspect)}
    return Camera.look_at(eyes, **lens), [size] * count


def _photo_size(options: RenderOptions) -> tuple[int, int] | None:
    if not isinstance(options.background, Path):
        return None
    height, width = load_image(options.background).shape[:2]
    return height, width


def _background(options: RenderOptions, size: tuple[int, int], device: torch.device) -> Any:
    if isinstance(options.background, Path):
        photo = load_image(options.background)[..., :3].movedim(2, 0)[None].to(device)
        return functional.interpolate(photo, size, mode="bilinear", antialias=True)[0]
    if isinstance(options.background, tuple):
        return options.background
    return _WHITE if options.background in (None, "white") else _BLACK


@dataclass(frozen=True)
class _Scenery:
    """Settings that all pictures of one run share; the background is as `render` takes it."""

    options: RenderOptions
    size: tuple[int, int]
    background: Any
    surroundings: EnvironmentLight | None

    @property
    def tile(self) -> int | None:
        """The `tile` of `render`: large pictures are drawn in strips, but not layers."""
        is_large = self.size[0] * self.size[1] > _LARGE**2
        return _TILE if is_large and self.options.layers is None else None

    @property
    def is_streamed(self) -> bool:
        """Return whether a picture is written strip by strip. The other modes need all pixels first."""
        is_png = self.options.output is not None and self.options.output.suffix.lower() == ".png"
        return is_png and self.options.mode in ("rgb", "silhouettes") and self.tile is not None

    def look(self, camera: Camera) -> dict[str, Any]:
        """Return the light, the shading, the background and the layers of a view, as `render` takes them."""
        light, background = self.surroundings or (CameraLight() if self.options.light else None), self.background
        if self.surroundings is not None and self.options.background == "environment":
            background = self.surroundings.background(camera, self.size).to(camera.rotation)
        return {
            "light": light,
            "shading": self.options.shading,
            "background": background,
            "layers": self.options.layers,
        }

    @torch.no_grad()
    def strips(self, mesh: Mesh | UVMesh, camera: Camera) -> Iterator[Tensor]:
        """Draw one view as `draw` does, strip by strip."""
        near, far = depth_range(mesh, camera)
        if self.options.mode == "silhouettes":
            shape = mesh.vertices, mesh.faces
            for images in render_strips(shape, camera, self.size, _TILE, outputs=("alpha",), near=near, far=far):
                yield images.alpha[0]
            return
        drawn = {"outputs": ("rgb", "alpha"), "near": near, "far": far, **self.look(camera)}
        for images in render_strips(mesh, camera, self.size, _TILE, **drawn):
            yield _on_background(self.options, images)

    @torch.no_grad()
    def draw(self, mesh: Mesh | UVMesh, camera: Camera) -> Tensor:
        """Draw a view: [3, H, W] in [0, 1]; [4, H, W] if the background is transparent; [H, W] silhouette or depth."""
        near, far = depth_range(mesh, camera)
        place: dict[str, Any] = {"near": near, "far": far, "tile": self.tile}
        if self.options.mode in ("silhouettes", "depth"):
            images = render((mesh.vertices, mesh.faces), camera, self.size, outputs=("alpha", "depth"), **place)
            alpha, depth = images.alpha[0], images.depth[0]
            return alpha if self.options.mode == "silhouettes" else _shade_depth(depth, alpha, far)
        look = self.look(camera)
        if self.options.mode == "normals":
            images = _draw_normals(mesh, camera, self.size, look["background"], near, far)
        else:
            images = render(mesh, camera, self.size, **look, outputs=("rgb", "alpha"), **place)
        return _on_background(self.options, images)


def _on_background(options: RenderOptions, images: Images) -> Tensor:
    """Return the colours, with alpha if the background is transparent: PNG stores colours without it."""
    rgb, alpha = images.rgb[0], images.alpha[0]
    if options.background != "transparent":
        return rgb
    # Colours over black are multiplied by alpha at the outline.
    return torch.cat((rgb / alpha.clamp(min=1e-6), alpha[None]))


def _draw_normals(
    mesh: Mesh | UVMesh, camera: Camera, size: tuple[int, int], background: Any, near: float, far: float
) -> Images:
    """Draw normals in camera space as colours, and the silhouette."""
    fragments = deferred.fragments((mesh.vertices, mesh.faces), camera, size, near=near, far=far)
    axes = camera.axes[0] * camera.rotation.new_tensor([1.0, 1.0, -1.0])[:, None]  # right, up, backward
    normals = fragments.interpolate(vertex_normals(mesh.vertices, mesh.faces)[0] @ axes.T)
    alpha = fragments.composite(torch.ones_like(normals[..., :1]))[:, 0]
    return Images(fragments.composite((normals + 1) / 2, background), alpha)


def _shade_depth(depth: Tensor, alpha: Tensor, far: float) -> Tensor:
    """Convert depth to grey [H, W]: the nearest point is white, the farthest dark, the background black."""
    covered = alpha > 0
    if not covered.any():
        return torch.zeros_like(depth)
    # Anti-aliasing mixes the far plane into the depth at the outline; remove its share.
    unmixed = (depth - (1 - alpha) * far) / alpha.clamp(min=1e-6)
    low, high = unmixed[covered].min(), unmixed[covered].max()
    grey = 1 - _DEPTH_CONTRAST * (unmixed - low) / (high - low).clamp(min=1e-6)
    return torch.where(covered, grey * alpha, 0.0)
