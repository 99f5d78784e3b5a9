"""Draw meshes in PyTorch, and send gradients from the images back to the scene. CPU and CUDA.

    mesh = nr.Mesh.load("bunny.obj").trainable()                        # vertices, faces, textures
    camera = nr.Camera.look_at((0.0, 1.0, -2.5), viewing_angle=30)      # one camera, or a batch of them
    images = nr.render(mesh, camera, 256)                               # images.rgb, images.alpha, images.depth
    nr.losses.silhouette_iou_loss(images.alpha, target).backward()      # fills mesh.vertices.grad

Where to look; `help(nr.render)` and so on explain each name:

    a scene      Mesh, UVMesh, Camera; icosphere, cube, torus, batch, join
    light        CameraLight, Light, PointLight, SpotLight, SphericalHarmonicLight, EnvironmentLight, ShadowedLight
    materials    Material, Texture; Phong, PBR
    its images   render, which returns Images
    your shader  fragments, which returns Fragments or Layers; sample_texture, VisibleSurface, shade_pbr, …
    losses       the modules losses and metrics
    rotations    the module rotations: axis and angle, quaternions, six numbers
    solvers      the module optim; find_pose
    a picture    reconstruct: one picture to a mesh
    files        load_mesh, save_mesh, load_image, save_image, save_animation
    old code     Renderer, look_at, look, load_obj, Adam, …: the names of the first `neural_renderer` packages

`neural_renderer.apps` contains the applications of the command line: fit, pose, edit, reconstruct and others. The
method is described in "Neural 3D Mesh Renderer" (Kato, Ushiku and Harada, CVPR 2018).
"""

import os
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from .compat.first_packages.old_modules import OLD_MODULES, register_old_modules
from .compat.moved_modules import register_moved_modules
from .version import __version__ as __version__

name = "neural_renderer_pytorch"  # as in the first package for PyTorch

register_old_modules()
register_moved_modules()

# Threads of torch that wait for each other spin, and so take the cores from kernels and from other programs. OpenMP
# (GNU's, LLVM's and Intel's) reads this once, when torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

if TYPE_CHECKING:
    from .apps.interface import *
    from .interface import *
else:
    # Modules with public names: the core's, then those of the applications.
    _INTERFACES = ("interface", "apps.interface")

    def _public(interface: str) -> dict[str, Any]:
        public = vars(import_module(f"{__name__}.{interface}"))
        return {name: public[name] for name in public["__all__"]}

    def _picture_of(shown: Any) -> bytes | None:
        """Draw the picture of an object that a notebook shows. This loads modules of the applications."""
        return import_module(f"{__name__}.apps.common.pictures.notebook").png_of(shown)

    def __getattr__(name: str) -> Any:
        """Load modules and public names at first use, so that `neural-renderer --help` answers without torch."""
        if name == "__all__":
            globals()["__all__"] = sorted(name for interface in _INTERFACES for name in _public(interface))
        elif not name.startswith("_"):
            if name not in OLD_MODULES and find_spec(f"{__name__}.{name}"):
                return import_module(f"{__name__}.{name}")
            for interface in _INTERFACES:
                globals().update(_public(interface))
                if name in globals():
                    break
            for shown in ("Images", "Fragments", "Mesh", "UVMesh"):
                globals()[shown]._repr_png_ = _picture_of
        if name in globals():
            return globals()[name]
        if name in OLD_MODULES:
            return import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*(name for name in globals() if name.startswith("__")), *__getattr__("__all__")})
