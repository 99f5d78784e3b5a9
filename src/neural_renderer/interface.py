"""Public names of the package. `__init__` loads this module at the first use of one of them."""

import torch

from . import optim
from .base.color_space import linear_to_srgb, srgb_to_linear
from .base.validate import check_values
from .camera import Camera, get_points_from_angles, look, look_at, orthographic, perspective, projection, rotations
from .compat.first_packages.adam import Adam
from .compat.first_packages.lighting import lighting
from .compat.first_packages.old_functions import cross
from .compat.first_packages.rasterize import (
    Rasterize,
    rasterize,
    rasterize_depth,
    rasterize_rgbad,
    rasterize_silhouettes,
)
from .compat.first_packages.renderer import Renderer
from .io import load_image, load_mesh, load_obj, save_image, save_mesh, save_obj
from .meshes.batch import batch, join
from .meshes.mesh import Mesh
from .meshes.normals import vertex_normals
from .meshes.primitives import cube, icosphere, torus
from .meshes.rigs import Rig
from .meshes.uv_mesh import UVMesh
from .optim import losses, metrics
from .raster import Images, rasterize_images, vertices_to_faces
from .raster.fragments import Fragments, Layers
from .raster.warp.elsewhere import fall_back_to_cpu
from .rendering.deferred import fragments
from .rendering.forward import render
from .rendering.shadows import ShadowedLight
from .rendering.transparency import surface_opacity
from .shading.environments.light import EnvironmentLight
from .shading.lights import CameraLight, Light
from .shading.pbr import PBR, shade_pbr
from .shading.phong import Phong, shade_diffuse, shade_phong
from .shading.pixels.normal_maps import corner_tangents
from .shading.pixels.visible_surface import VisibleSurface
from .shading.point_lights import PointLight, SpotLight
from .shading.spherical_harmonics import SphericalHarmonicLight
from .textures.gutters import fill_gutters
from .textures.material import Material, Texture
from .textures.sample_texture import sample_texture
from .version import __version__

__all__ = [
    "PBR",
    "Adam",
    "Camera",
    "CameraLight",
    "EnvironmentLight",
    "Fragments",
    "Images",
    "Layers",
    "Light",
    "Material",
    "Mesh",
    "Phong",
    "PointLight",
    "Rasterize",
    "Renderer",
    "Rig",
    "ShadowedLight",
    "SphericalHarmonicLight",
    "SpotLight",
    "Texture",
    "UVMesh",
    "VisibleSurface",
    "__version__",
    "batch",
    "check_values",
    "corner_tangents",
    "cross",
    "cube",
    "fall_back_to_cpu",
    "fill_gutters",
    "fragments",
    "get_points_from_angles",
    "icosphere",
    "join",
    "lighting",
    "linear_to_srgb",
    "load_image",
    "load_mesh",
    "load_obj",
    "look",
    "look_at",
    "losses",
    "metrics",
    "optim",
    "orthographic",
    "perspective",
    "projection",
    "rasterize",
    "rasterize_depth",
    "rasterize_images",
    "rasterize_rgbad",
    "rasterize_silhouettes",
    "render",
    "rotations",
    "sample_texture",
    "save_image",
    "save_mesh",
    "save_obj",
    "shade_diffuse",
    "shade_pbr",
    "shade_phong",
    "srgb_to_linear",
    "surface_opacity",
    "torus",
    "vertex_normals",
    "vertices_to_faces",
]


# torch.load reads these by default: they hold only tensors and plain values.
torch.serialization.add_safe_globals(
    [
        *(Camera, CameraLight, EnvironmentLight, Images, Light, Material, Mesh, PBR, Phong, PointLight, ShadowedLight),
        *(SphericalHarmonicLight, SpotLight, Texture, UVMesh),
    ]
)
