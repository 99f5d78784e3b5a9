"""`neural-renderer render`: a mesh file as a picture or as a turntable."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor

from ..camera import Camera, get_points_from_angles
from ..deferred import fragments
from ..io import load_mesh, save_animation, save_image
from ..meshes.mesh import Mesh
from ..meshes.normals import vertex_normals
from ..meshes.uv_mesh import UVMesh
from ..pictures.lamp import lamp_direction
from ..raster.settings import image_size
from ..rendering import render
from ..shading.lights import Light
from .common import check_outputs, checked_count, chosen_device
from .options.render import RenderOptions

_LAMP = (-0.4, 0.6, 0.7)  # right, up, backward; more frontal than `pictures.lamp.LAMP`: no visible face is dark
_COLORS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0), "transparent": (0.0, 0.0, 0.0)}
_GREY = 0.82  # of a mesh without colours
_PICTURES, _ANIMATIONS = (".png", ".jpg", ".jpeg"), (".gif", ".mp4")


@dataclass(frozen=True)
class Render(RenderOptions):
    """Draws a mesh file, as the options say."""

    def run(self) -> int:
        """Draw; returns the exit code 0. Raises ValueError, TypeError or OSError with a sentence."""
        self._check()
        check_outputs([self.output], [self.mesh])
        device = chosen_device(self.device)
        mesh = self._loaded().to(device)
        mesh = mesh.normalize() if self.normalize else mesh
        animated = self.output.suffix.lower() in _ANIMATIONS
        count = (60 if self.turntable is None else self.turntable) if animated else 1
        angles = [self.azimuth + 360 * index / count for index in range(count)]
        pictures: Iterator[Tensor] = (self.picture(mesh, angle).cpu() for angle in angles)
        console = Console(stderr=True)
        if animated:
            shown = track(pictures, "Turntable", total=count, console=console, transient=True)
            save_animation(self.output, shown, self.fps)
        else:
            save_image(self.output, next(pictures))
        Console().print(f"{self.output}", highlight=False, soft_wrap=True)
        return 0

    def _loaded(self) -> Mesh | UVMesh:
        if self.texture_size is None:
            return UVMesh.load(self.mesh, _GREY, self.allow_outside)
        vertices, faces, textures = load_mesh(self.mesh, self.texture_size, self.allow_outside)
        if textures is None:
            textures = torch.full((len(faces), 1, 1, 1, 3), _GREY)
        return Mesh(vertices, faces, textures)

    def _check(self) -> None:
        suffix = self.output.suffix.lower()
        if suffix not in _PICTURES + _ANIMATIONS:
            expected = ", ".join(_PICTURES + _ANIMATIONS)
            raise ValueError(f"--output: expected a name that ends in {expected}, got {self.output.name!r}")
        if self.turntable is not None:
            checked_count("turntable", self.turntable, 1)
            if suffix in _PICTURES:
                raise ValueError(f"--output: expected a .gif or .mp4 for a turntable, got {self.output.name!r}")
        image_size("size", self.size)
        if self.texture_size is not None:
            checked_count("texture_size", self.texture_size, 1)
        self._between("fps", self.fps, 0, math.inf)
        self._between("viewing-angle", self.viewing_angle, 0, 90)
        self._between("elevation", self.elevation, -90, 90)
        if not math.isfinite(self.azimuth):
            raise ValueError(f"--azimuth: expected a finite number of degrees, got {self.azimuth}")
        if self.distance is not None:
            self._between("distance", self.distance, 0, math.inf)
        if self.background is not None and self.mode in ("silhouettes", "depth"):
            raise ValueError(f"--background: expected --mode rgb or normals, got {self.mode}, which is on black")
        if self.background == "transparent" and suffix != ".png":
            raise ValueError(f"--background transparent: expected a .png, got {self.output.name!r}")
        if isinstance(self.background, tuple) and not all(0 <= value <= 1 for value in self.background):
            raise ValueError(f"--background: expected three numbers from 0 to 1, got {self.background}")

    @staticmethod
    def _between(name: str, value: float, low: float, high: float) -> None:
        if not low < value < high:
            limit = f" and below {high}" if math.isfinite(high) else ""
            raise ValueError(f"--{name}: expected a number above {low}{limit}, got {value}")

    @torch.no_grad()
    def picture(self, mesh: Mesh | UVMesh, azimuth: float) -> Tensor:
        """One view: [3, H, W] or, with transparency, [4, H, W]; [H, W] for silhouettes and depth."""
        height, width = (self.size, self.size) if isinstance(self.size, int) else self.size
        aspect = min(1.0, width / max(height, 1))
        radius = max(mesh.vertices.norm(dim=1).max().item(), 1e-6)
        fit = 1.05 * radius / (math.sin(math.radians(self.viewing_angle)) * max(aspect, 1e-6))
        distance = fit if self.distance is None else self.distance
        eye = torch.tensor(get_points_from_angles(distance, self.elevation, azimuth), device=mesh.vertices.device)
        scale = aspect / (1.05 * radius)
        camera = Camera.look_at(eye, viewing_angle=self.viewing_angle, orthographic=self.orthographic, scale=scale)
        size = (height, width)
        # Planes around the model, whatever its units are.
        near, far = max(distance - 1.1 * radius, 1e-3 * distance), distance + 1.1 * radius

        if self.mode in ("silhouettes", "depth"):
            shape = mesh.vertices, mesh.faces
            images = render(shape, camera, size, outputs=("alpha", "depth"), near=near, far=far)
            alpha, depth = images.alpha[0], images.depth[0]  # type: ignore[index]
            return alpha if self.mode == "silhouettes" else _grey_depth(depth, alpha, far)
        color = self.background if isinstance(self.background, tuple) else _COLORS[self.background or "white"]
        if self.mode == "normals":
            seen = fragments((mesh.vertices, mesh.faces), camera, size, near=near, far=far)
            axes = camera.rotation[0] * camera.rotation.new_tensor([1.0, 1.0, -1.0])[:, None]  # right, up, backward
            normals = seen.interpolate(vertex_normals(mesh.vertices, mesh.faces)[0] @ axes.T)
            rgb = seen.composite((normals + 1) / 2, color)[0]
            alpha = seen.composite(torch.ones_like(normals[..., :1]))[0, 0]
        else:
            light = (
                Light(ambient=0.4, directional=0.65, direction=lamp_direction(camera, _LAMP)) if self.light else None
            )
            images = render(
                mesh, camera, size, light=light, background=color, outputs=("rgb", "alpha"), near=near, far=far
            )
            rgb, alpha = images.rgb[0], images.alpha[0]  # type: ignore[index]
        if self.background != "transparent":
            return rgb
        # On black, colours at the outline are already multiplied by alpha; PNG wants them without.
        return torch.cat((rgb / alpha.clamp(min=1e-6), alpha[None]))


def _grey_depth(depth: Tensor, alpha: Tensor, far: float) -> Tensor:
    """Depth as grey [H, W]: the nearest point white, the farthest dark, what is no mesh black."""
    seen = alpha > 0
    if not seen.any():
        return torch.zeros_like(depth)
    # At the outline an anti-aliased depth is mixed with the far plane; this takes the plane's part out.
    own = (depth - (1 - alpha) * far) / alpha.clamp(min=1e-6)
    low, high = own[seen].min(), own[seen].max()
    grey = 1 - 0.8 * (own - low) / (high - low).clamp(min=1e-6)
    return torch.where(seen, grey * alpha, 0.0)
