"""Options that `neural-renderer style` and `neural-renderer dream` share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True, kw_only=True)
class EditOptions:
    """Options of both commands; those that are None are the preset's."""

    mesh: tyro.conf.Positional[Path]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the results; it is made if missing."""
    preset: Literal["paper", "published"] = "paper"
    """Settings of the paper, with losses that suit any network and mesh; or those of the code that was published with
    it, which are for its own network."""
    weights: Path | None = None
    """File with the network's weights: .safetensors, or .pth of torch; by default they are fetched once."""
    iterations: int | None = None
    """Steps (at least 1); by default the preset's."""
    batch: int = 4
    """Views that each step looks at (at least 1)."""
    size: int = 224
    """Side in pixels of what the network sees (at least 32); smaller is faster, and what it paints becomes larger. The
    object is drawn at twice that."""
    vertex_rate: float | None = None
    """How fast vertices move (Adam's alpha; 0: not at all); by default the preset's."""
    texture_rate: float | None = None
    """How fast colours change (Adam's alpha; 0: not at all); by default the preset's."""
    settle: float | None = None
    """The part of the steps (0 to 1), at the end, in which both rates fall to 0; by default the preset's."""
    elevation: tuple[float, float] | None = None
    """Lowest and highest camera, in degrees (between -90 and 90); by default the preset's."""
    distance: float | None = None
    """From the camera to the middle of the object, whose longest side is 2; by default the preset's."""
    init: Literal["mesh", "random"] | None = None
    """Begin with the mesh's own colours or, where it has none, with the picture's mean colour (style) or grey (dream),
    or with grey in any case (random). By default the preset's."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3, or 1 if not seamless); more for meshes of few faces."""
    uv: int | None = None
    """Paint where the file's own texture coordinates lead to, each of its images on so many pixels a side (at least
    16): for meshes of few, large faces, which must have an image. --texture-size and --seamless then have no part.
    By default faces get texels of their own, and the mesh new texture coordinates."""
    seamless: bool | None = None
    """Faces share the texels on their edges, so that no seam can appear; otherwise each face has its own. By
    default the preset's."""
    bend: float | None = None
    """Weight of smooth movement: how much each vertex is held to move as its neighbours do; by default the preset's."""
    variation: float | None = None
    """Weight of smooth colours, the total variation of the images; by default the preset's."""
    gradient: Literal["nmr", "edge"] = "nmr"
    """The renderer's gradient through visibility; nmr is the paper's."""
    preview: int = 50
    """Steps from one preview and checkpoint to the next (at least 1)."""
    turntable: int = 36
    """Pictures of the turntable (0: none)."""
    seed: int = 0
    """Seed of the views and of random colours."""
    allow_outside: bool = False
    """Read materials and images outside the mesh's folder too, if its file names such; for files that you trust."""
    resume: bool = False
    """Go on from the checkpoint in the output folder, if there is one, which must be of the same files and settings."""
    force: bool = False
    """Replace mesh.mtl and mesh_texture.png in the output folder even if something else wrote them."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to compute; auto is CUDA where there is one."""
