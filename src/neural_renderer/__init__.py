"""Draw meshes in PyTorch, and send gradients from the images back to the scene. CPU and CUDA.

    mesh = nr.Mesh.load("bunny.obj")                                    # vertices, faces, textures
    camera = nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)      # one camera, or a batch of them
    images = nr.render(mesh, camera, 256)                               # images.rgb, images.alpha, images.depth
    nr.losses.silhouette_iou(images.alpha, target).backward()           # fills mesh.vertices.grad

Where to look; `help(nr.render)` and so on explain each name:

    a scene      Mesh, UVMesh, Camera, Light, SphericalHarmonicLight; icosphere, cube, torus, batch, join
    its images   render, which returns Images
    your shader  fragments, which returns Fragments; sample_texture, vertex_normals, fill_gutters
    losses       the modules losses and metrics
    files        load_mesh, save_mesh, load_image, save_image, save_animation
    old code     Renderer, rasterize, look_at, load_obj, Adam, …: the names of the first `neural_renderer` packages

`neural_renderer.tasks` holds what the command line does: fit, editing and reconstruction. The method is that of
"Neural 3D Mesh Renderer" (Kato, Ushiku and Harada, CVPR 2018).
"""

from . import losses, metrics
from .camera import Camera, get_points_from_angles, look, look_at, orthographic, perspective, projection
from .compat.adam import Adam
from .compat.lighting import lighting
from .compat.rasterize import Rasterize, rasterize, rasterize_depth, rasterize_rgbad, rasterize_silhouettes
from .compat.renderer import Renderer
from .fragments import Fragments, fragments
from .io import load_image, load_mesh, load_obj, save_animation, save_image, save_mesh, save_obj
from .meshes.batch import batch, join
from .meshes.mesh import Mesh
from .meshes.normals import vertex_normals
from .meshes.primitives import cube, icosphere, torus
from .meshes.uv_mesh import UVMesh
from .pictures.notebook import show_in_notebooks as _show_in_notebooks
from .raster import Images, rasterize_images, vertices_to_faces
from .render import render
from .shading.lights import Light
from .shading.spherical_harmonics import SphericalHarmonicLight
from .textures.gutters import fill_gutters
from .textures.sample_texture import sample_texture
from .validate import check_values
from .version import __version__

__all__ = [
    "Adam",
    "Camera",
    "Fragments",
    "Images",
    "Light",
    "Mesh",
    "Rasterize",
    "Renderer",
    "SphericalHarmonicLight",
    "UVMesh",
    "__version__",
    "batch",
    "check_values",
    "cube",
    "fill_gutters",
    "fragments",
    "get_points_from_angles",
    "icosphere",
    "join",
    "lighting",
    "load_image",
    "load_mesh",
    "load_obj",
    "look",
    "look_at",
    "losses",
    "metrics",
    "orthographic",
    "perspective",
    "projection",
    "rasterize",
    "rasterize_depth",
    "rasterize_images",
    "rasterize_rgbad",
    "rasterize_silhouettes",
    "render",
    "sample_texture",
    "save_animation",
    "save_image",
    "save_mesh",
    "save_obj",
    "torus",
    "vertex_normals",
    "vertices_to_faces",
]

_show_in_notebooks()
