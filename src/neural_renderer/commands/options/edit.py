"""Options shared by `neural-renderer style` and `neural-renderer dream`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from .watch import WatchOptions


@dataclass(frozen=True, kw_only=True)
class EditOptions:
    """Options of both commands. The preset replaces None."""

    mesh: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the results; it is made if missing."""
    preset: Literal["paper", "published"] = "paper"
    """Default settings. paper: the paper's, with losses that suit any network and mesh; published: the settings of the
    published code, for the paper's network only."""
    weights: Path | None = None
    """File with the weights of the network, .safetensors or .pth. By default they are downloaded once."""
    iterations: int | None = None
    """Number of steps (at least 1); by default the preset's."""
    batch: int = 4
    """Views per step (at least 1)."""
    size: int = 224
    """Side in pixels of the images for the network (at least 32). Smaller is faster and gives larger patterns."""
    vertex_rate: float | None = None
    """Learning rate of the vertices (0: fixed); by default the preset's."""
    texture_rate: float | None = None
    """Learning rate of the colours (0: fixed); by default the preset's."""
    settle: float | None = None
    """Both learning rates decay to 0 in this last fraction of the steps (0 to 1); by default the preset's."""
    elevation: tuple[float, float] | None = None
    """Least and greatest elevation of the camera in degrees (between -90 and 90); by default the preset's."""
    distance: float | None = None
    """Distance of the camera from the centre of the mesh, whose longest side is 2; by default the preset's."""
    init: Literal["mesh", "random"] | None = None
    """Initial colours. mesh: the mesh's own, or, for a mesh without colours, the painting's mean colour (style) or grey
    (dream); random: grey with noise. By default the preset's."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3, or 1 if not seamless). Meshes with few faces need more."""
    uv: int | None = None
    """Keep the texture coordinates of the file and paint its images, each with this many pixels a side (at least 16).
    For meshes with few, large faces and an image. --texture-size and --seamless are ignored. By default faces get new
    texels and texture coordinates."""
    seamless: bool | None = None
    """Share texels on edges between adjacent faces, so that there are no seams; by default the preset's."""
    bend: float | None = None
    """Weight of the bending loss. It makes adjacent vertices move alike. By default the preset's."""
    variation: float | None = None
    """Weight of the total variation of the images; by default the preset's."""
    gradient: Literal["nmr", "edge"] = "nmr"
    """Gradient estimator of the renderer; nmr is the paper's."""
    preview: int = 50
    """Steps between two previews and checkpoints (at least 1)."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
    """Seed of the views and of random colours."""
    allow_outside: bool = False
    """Allow the mesh file to name materials and images outside of its folder. For trusted files only."""
    resume: bool = False
    """Resume from the checkpoint in the output folder, if there is one. Files and settings must be the same."""
    force: bool = False
    """Replace mesh.mtl and mesh_texture.png in the output folder even if another program wrote them."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Device to compute on; auto is CUDA if available."""
    watch: Annotated[WatchOptions, tyro.conf.arg(name="")] = field(default_factory=WatchOptions)
    """Follow the run."""
