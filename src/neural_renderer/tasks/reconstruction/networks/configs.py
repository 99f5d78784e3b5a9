"""Recipes of training: the paper's, a small one, and the best one known for a short time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from ...settings import ConfigName
from .encoders import EncoderName


@dataclass(frozen=True)
class Config:
    """How a network is built and trained; the defaults are the paper's (sections 4.1 and 5.1, and the published code).

    encoder, width: see `encoders.make_encoder`.
    hidden: widths of the mesh decoder's hidden layers.
    symmetric: make meshes mirror images of themselves at z = 0, the plane that most things are symmetric about.
    blur: λ of (1 + λL)⁻¹, by which the local biases of vertices are blurred over the sphere (see `mesh_network`).
    objects: in a batch, over all processes; classes are drawn uniformly, then objects.
    views: of each object in a batch; every prediction is compared with all of them.
    inputs: how many of these views are looked at by the network, each for a prediction.
    augment: mirror objects, and vary colours (see `sampling`).
    gradient, anti_aliasing: of the renderer.
    smoothness, laplacian: weights of these losses on the meshes.
    optimiser: "adam" is the published `neural_renderer.Adam`, "adamw" torch's.
    rate, decay: the learning rate, and the weight decay of "adamw".
    schedule: "step" divides the rate by ten after 95 % of the training; "cosine" lets it rise over the first 2 % and
        then fall to 0.
    average: of the weights over the last steps, by which it is multiplied at each (0: none); predictions use it.
    low_precision: compute the networks in bfloat16 where the hardware is made for it.
    refine: steps by which a prediction is fitted to the silhouette that went in (see `refine`).
    steps: of the whole training.
    """

    encoder: EncoderName = "paper"
    width: int = 32
    hidden: tuple[int, ...] = (1024, 2048)
    symmetric: bool = False
    blur: float = 0.0
    objects: int = 64
    views: int = 2
    inputs: int = 2
    augment: bool = False
    gradient: Literal["nmr", "edge"] = "nmr"
    anti_aliasing: bool = True
    smoothness: float = 0.0
    laplacian: float = 0.0
    optimiser: Literal["adam", "adamw"] = "adam"
    rate: float = 1e-4
    decay: float = 0.0
    schedule: Literal["step", "cosine"] = "step"
    average: float = 0.0
    low_precision: bool = False
    refine: int = 0
    steps: int = 1_000_000

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Config:
        """What `to_dict` returned; ValueError for names that are none of a recipe."""
        unknown = set(values) - {field.name for field in fields(cls)}
        if unknown:
            raise ValueError(f"config: expected the fields of a recipe, got {', '.join(sorted(unknown))} as well")
        return cls(**{**values, "hidden": tuple(values.get("hidden", cls.hidden))})

    def to_dict(self) -> dict[str, Any]:
        """Plain values under the fields' names."""
        return {**asdict(self), "hidden": list(self.hidden)}


_BEST = Config(
    encoder="light",
    width=48,
    hidden=(512, 1024),
    symmetric=True,
    blur=3.0,
    objects=32,
    inputs=1,
    augment=True,
    gradient="edge",
    anti_aliasing=False,
    laplacian=3.0,
    optimiser="adamw",
    rate=1e-3,
    decay=0.05,
    schedule="cosine",
    average=0.995,
    low_precision=True,
    refine=20,
    steps=20_000,
)

_CONFIGS = {"paper": Config(), "best": _BEST, "small": replace(_BEST, steps=4_000)}

# The published numbers of steps for networks of one class, by its name and by its number in ShapeNet; networks of all
# classes take a million.
_STEPS = {
    "airplane": 200_000,
    "bench": 100_000,
    "cabinet": 40_000,
    "car": 50_000,
    "chair": 250_000,
    "display": 20_000,
    "lamp": 20_000,
    "loudspeaker": 40_000,
    "rifle": 130_000,
    "sofa": 40_000,
    "table": 90_000,
    "telephone": 30_000,
    "watercraft": 90_000,
    "02691156": 200_000,
    "02828884": 100_000,
    "02933112": 40_000,
    "02958343": 50_000,
    "03001627": 250_000,
    "03211117": 20_000,
    "03636649": 20_000,
    "03691459": 40_000,
    "04090263": 130_000,
    "04256520": 40_000,
    "04379243": 90_000,
    "04401088": 30_000,
    "04530566": 90_000,
}


def make_config(name: ConfigName, classes: Sequence[str]) -> Config:
    """The recipe of this name for ``classes``.

    The paper trains a network of a single class with the smoothness loss (weight 0.001) and for fewer steps.
    """
    config = _CONFIGS[name]
    if name == "paper" and len(classes) == 1:
        config = replace(config, smoothness=1e-3, steps=_STEPS.get(classes[0], 100_000))
    return config
