"""Public names of the package. `__init__` loads this module at the first use of one of them."""

import torch

from . import data, losses, metrics, optim, rotations
from .camera import Camera, get_points_from_angles, look, look_at, orthographic, perspective, projection
from .comparators.reinforce import reinforce
from .comparators.soft_silhouettes import soft_silhouettes
from .compat.adam import Adam
from .compat.lighting import lighting
from .compat.old_functions import cross
from .compat.rasterize import Rasterize, rasterize, rasterize_depth, rasterize_rgbad, rasterize_silhouettes
from .compat.renderer import Renderer
from .deferred import Fragments, Layers, fragments
from .io import load_image, load_mesh, load_obj, save_animation, save_image, save_mesh, save_obj
from .meshes.batch import batch, join
from .meshes.mesh import Mesh
from .meshes.normals import vertex_normals
from .meshes.primitives import cube, icosphere, torus
from .meshes.remeshing.closest_points import closest_points
from .meshes.remeshing.remesh import Remeshed, remesh
from .meshes.sample_points import SurfacePoints, sample_points
from .meshes.unwrap import unwrap
from .meshes.uv_mesh import UVMesh
from .pictures.notebook import show_in_notebooks as _show_in_notebooks
from .raster import Images, rasterize_images, vertices_to_faces
from .rendering import render
from .rigs import Rig
from .shading.environments.light import EnvironmentLight
from .shading.lights import CameraLight, Light
from .shading.pbr import PBR, shade_pbr
from .shading.phong import Phong, shade_diffuse, shade_phong
from .shading.pixels.normal_maps import corner_tangents
from .shading.pixels.visible_surface import VisibleSurface
from .shading.point_lights import PointLight, SpotLight
from .shading.shadows import ShadowedLight
from .shading.spherical_harmonics import SphericalHarmonicLight
from .tasks.pose.find import ObjectPose, find_pose
from .tasks.reconstruction.evaluation.picture import Reconstruction, reconstruct
from .tasks.rig_fit import fit_rig, load_keypoints
from .textures.color_space import linear_to_srgb, srgb_to_linear
from .textures.gutters import fill_gutters
from .textures.material import Material, Texture
from .textures.sample_texture import sample_texture
from .transparency import surface_opacity
from .validate import check_values
from .version import __version__
from .viewer.viewer import Viewer, view

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
    "ObjectPose",
    "Phong",
    "PointLight",
    "Rasterize",
    "Reconstruction",
    "Remeshed",
    "Renderer",
    "Rig",
    "ShadowedLight",
    "SphericalHarmonicLight",
    "SpotLight",
    "SurfacePoints",
    "Texture",
    "UVMesh",
    "Viewer",
    "VisibleSurface",
    "__version__",
    "batch",
    "check_values",
    "closest_points",
    "corner_tangents",
    "cross",
    "cube",
    "data",
    "fill_gutters",
    "find_pose",
    "fit_rig",
    "fragments",
    "get_points_from_angles",
    "icosphere",
    "join",
    "lighting",
    "linear_to_srgb",
    "load_image",
    "load_keypoints",
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
    "reconstruct",
    "reinforce",
    "remesh",
    "render",
    "rotations",
    "sample_points",
    "sample_texture",
    "save_animation",
    "save_image",
    "save_mesh",
    "save_obj",
    "shade_diffuse",
    "shade_pbr",
    "shade_phong",
    "soft_silhouettes",
    "srgb_to_linear",
    "surface_opacity",
    "torus",
    "unwrap",
    "vertex_normals",
    "vertices_to_faces",
    "view",
]

_show_in_notebooks()

# torch.load reads these by default: they hold tensors and plain values alone.
torch.serialization.add_safe_globals(
    [
        *(Camera, CameraLight, EnvironmentLight, Images, Light, Material, Mesh, PBR, Phong, PointLight, ShadowedLight),
        *(SphericalHarmonicLight, SpotLight, Texture, UVMesh),
    ]
)
