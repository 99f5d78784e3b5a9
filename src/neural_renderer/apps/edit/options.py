"""Options of `neural-renderer style` and `neural-renderer dream`. This module does not import torch."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ...base.requirements import require_library
from ..common.checks import REPORT, check_counts, check_earlier, check_folder, check_inputs, check_outputs
from ..common.options import AllowOutside, Device, Output, Steps, Watch, WatchOptions

STYLE_LAYERS = ("conv1_2", "conv2_2", "conv3_3", "conv4_3")
"""Layers of VGG for style transfer: the paper's, with conv2_2 in place of conv2_3, which does not exist."""
DREAM_LAYER = "inception_4c"
"""Layer of GoogLeNet for DeepDream: the paper's."""
PICTURES, TURNTABLES = ("preview.png", "views.png", "loss.png"), ("turntable.mp4", "turntable.gif")
RESULTS = ("mesh.obj", "mesh.glb", *PICTURES, *TURNTABLES, REPORT)
"""Files that a run writes."""


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Default values of options."""

    steps: int
    vertex_rate: float
    texture_rate: float
    settle: float
    elevation: tuple[float, float]
    distance: float
    light: tuple[float, float] | None = None
    init: Literal["mesh", "random"]
    seamless: bool

    def fill(self, options: EditOptions) -> dict[str, Any]:
        """Return a value for each field: the option if it is given, else the preset."""
        given = {name: getattr(options, name, None) for name in asdict(self)}
        return {name: value if given[name] is None else given[name] for name, value in asdict(self).items()}


PAPER_STYLE = Preset(
    steps=5000,
    vertex_rate=2.5e-4,
    texture_rate=5e-2,
    settle=0.3,
    elevation=(20.0, 40.0),
    distance=2.732,
    light=(0.75, 0.5),
    init="mesh",
    seamless=True,
)
STYLE_PRESETS = {
    "paper": PAPER_STYLE,
    "published": replace(
        PAPER_STYLE, steps=1000, vertex_rate=5e-4, settle=0.0, light=(0.5, 0.5), init="random", seamless=False
    ),
}
_PAPER_DREAM = Preset(
    steps=1000,
    vertex_rate=5e-5,
    texture_rate=1e-2,
    settle=0.0,
    elevation=(-10.0, 30.0),
    distance=2.5,
    init="mesh",
    seamless=True,
)
DREAM_PRESETS = {
    "paper": _PAPER_DREAM,
    "published": replace(_PAPER_DREAM, vertex_rate=1e-4, init="random", seamless=False),
}


@dataclass(frozen=True, kw_only=True)
class EditOptions:
    """Options of both commands. The preset replaces None."""

    mesh: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MESH")]
    """Mesh file: .obj, .ply, .stl, .off, .glb or .gltf."""
    output: Output
    """Folder for the results; it is made if missing."""
    preset: Literal["paper", "published"] = "paper"
    """Default settings. paper: the paper's, with losses that suit any network and mesh; published: the settings of the
    published code, for the paper's network only."""
    weights: Path | None = None
    """File with the weights of the network, .safetensors or .pth. By default they are downloaded once."""
    steps: Annotated[int | None, Steps] = None
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
    """Initial colours. mesh: those of the mesh or, without any, the painting's mean colour (style) or grey (dream);
    random: grey with noise. By default the preset's."""
    texture_size: int = 4
    """Texels along the edge of a face's texture (at least 3, or 1 if not seamless). Meshes with few faces need more."""
    uv: int | None = None
    """Keep the texture coordinates of the file and paint its images, each with this many pixels a side (at least 16).
    For meshes with few, large faces and an image. --texture-size and --seamless are ignored. By default faces get new
    texels and texture coordinates."""
    seamless: bool | None = None
    """Share texels on edges between adjacent faces, so that there are no seams; by default the preset's."""
    bend: float | None = None
    """Weight of the bending loss, for different displacements of adjacent vertices. By default the preset's."""
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
    allow_outside: AllowOutside = False
    resume: bool = False
    """Resume from the checkpoint in the output folder, if there is one. Files and settings must be the same."""
    force: bool = False
    """Replace what is in the output folder: the results of an earlier run, and mesh.mtl and mesh_texture.png even if
    another program wrote them."""
    device: Device = "auto"
    watch: Watch = field(default_factory=WatchOptions)

    def validate(self, *inputs: Path) -> None:
        """Raise an error for options that are out of range, missing files and libraries, and an unwritable output.

        ``inputs`` are files besides the mesh and the weights.
        """
        check_counts(self, batch=1, size=32, texture_size=1, preview=1, turntable=0, seed=0, steps=1, uv=16)
        check_inputs(*inputs, self.mesh, self.weights)
        if self.weights is not None and self.weights.suffix == ".safetensors":
            require_library("safetensors", f"to read {self.weights}")
        self.watch.validate()
        check_earlier(self.output, self.resume, self.force)
        check_folder("--output", self.output)
        check_outputs([self.output / name for name in RESULTS], [self.mesh, self.weights, *inputs])


@dataclass(frozen=True, kw_only=True)
class StyleOptions(EditOptions):
    """Transfer the style of a painting to the texture and the shape of a mesh.

    Images of the mesh from all sides are optimised to have the painting's feature statistics in layers of a VGG. The
    weights of VGG-16 are downloaded once (528 MB); --weights reads others.

    Example: neural-renderer style bunny.obj starry_night.jpg -o out

    Example: neural-renderer style teapot.obj wave.jpg -o out --steps 400 --size 160 --weights vgg19.safetensors

    Preset paper: 5000 steps, learning rates 2.5e-4 and 0.05, elevations 20 to 40, distance 2.732, light 0.75 and 0.5,
    the mesh's colours. Preset published: 1000 steps, learning rates 5e-4 and 0.05, light 0.5 and 0.5, random colours,
    not seamless.

    Ctrl-C ends the run and writes the current result; --resume continues it.
    """

    painting: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PAINTING")]
    """Picture with the style: PNG, JPEG or any other format that Pillow reads."""
    content: float | None = None
    """Weight of the content loss. It keeps vertices near their initial positions. By default the preset's."""
    palette: float | None = None
    """Weight of the palette loss. It penalises colours outside the painting's palette. By default the preset's."""
    light: tuple[float, float] | None = None
    """Ambient and directional intensity of the light; by default the preset's."""
    painting_scale: float = 1.0
    """Size of the painting relative to the images of the mesh (above 0). 2 makes its strokes twice as large."""
    layers: tuple[str, ...] = STYLE_LAYERS
    """Layers of the network for the comparison of feature statistics."""

    def validate(self, *inputs: Path) -> None:
        """See `EditOptions.validate`."""
        super().validate(self.painting, *inputs)


@dataclass(frozen=True, kw_only=True)
class DreamOptions(EditOptions):
    """Apply DeepDream to the texture and the shape of a mesh.

    Images of the mesh from all sides are optimised for large activations in a layer of GoogLeNet. torchvision's weights
    are downloaded once (50 MB); --weights reads others.

    Example: neural-renderer dream bunny.obj -o out

    Example: neural-renderer dream teapot.obj -o out --layer inception_4d --channel 3 --weights googlenet.safetensors

    Preset paper: 1000 steps, learning rates 5e-5 and 0.01, elevations -10 to 30, distance 2.5, the mesh's colours.
    Preset published: learning rates 1e-4 and 0.01, random colours, not seamless.

    Ctrl-C ends the run and writes the current result; --resume continues it.
    """

    layer: str = DREAM_LAYER
    """Layer of the network; its activations are maximised."""
    channel: int | None = None
    """Channel of the layer, from 0; by default all."""
