"""Configurations of networks and training: "paper", "best" and "small"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

from ..settings import ConfigName
from .encoders import EncoderName


@dataclass(frozen=True)
class Config:
    """Configuration of a network and its training. The defaults are the paper's (sections 4.1, 5.1, published code).

    Attributes:
        encoder: Name of the encoder (see `encoders.make_encoder`).
        width: Channels of the encoder "light" at its first layer.
        hidden: Widths of the hidden layers of the mesh decoder.
        symmetric: Whether meshes are symmetric about the plane z = 0, as most objects are.
        blur: λ of (1 + λL)⁻¹, which smooths the local biases over the sphere (see `mesh_network.smoothing_matrix`).
        objects: Objects per batch, over all processes. Classes are sampled uniformly, then objects.
        views: Views per object in a batch; each prediction is compared with all of them.
        inputs: Number of these views that are inputs of the network, with one prediction each.
        augment: Whether to mirror objects and vary colours (see `sampling`).
        gradient: Gradient estimator of the renderer.
        anti_aliasing: Whether the renderer uses anti-aliasing.
        smoothness: Weight of the smoothness loss on meshes.
        laplacian: Weight of the Laplacian loss on meshes.
        optimiser: "adam", the published `neural_renderer.Adam`, or "adamw", torch's.
        rate: Learning rate.
        decay: Weight decay of "adamw".
        schedule: "step" divides the learning rate by 10 after 95 % of the training; "cosine" warms up in the first 2 %
            and then decays to 0.
        average: Decay rate of the exponential moving average of weights; predictions use this average. 0 for none.
        low_precision: Whether to compute the networks in bfloat16 where the hardware is fast at it.
        refine: Steps of test-time refinement (see `refine.refine_meshes`).
        steps: Number of steps of the training.

    Example:
        >>> Config(steps=1000).hidden
        (1024, 2048)
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
        """Make a configuration from the values of `to_dict`. Raises ValueError for unknown names."""
        unknown = set(values) - {field.name for field in fields(cls)}
        if unknown:
            raise ValueError(f"config: expected the fields of a configuration, got also {', '.join(sorted(unknown))}")
        return cls(**{**values, "hidden": tuple(values.get("hidden", cls.hidden))})

    def to_dict(self) -> dict[str, Any]:
        """Return the values by field name, as plain numbers, strings and lists."""
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

# Published numbers of steps for networks of a single class, by the name and ShapeNet's id of the class.
_STEPS = {
    ("airplane", "02691156"): 200_000,
    ("bench", "02828884"): 100_000,
    ("cabinet", "02933112"): 40_000,
    ("car", "02958343"): 50_000,
    ("chair", "03001627"): 250_000,
    ("display", "03211117"): 20_000,
    ("lamp", "03636649"): 20_000,
    ("loudspeaker", "03691459"): 40_000,
    ("rifle", "04090263"): 130_000,
    ("sofa", "04256520"): 40_000,
    ("table", "04379243"): 90_000,
    ("telephone", "04401088"): 30_000,
    ("watercraft", "04530566"): 90_000,
}


def make_config(name: ConfigName, classes: Sequence[str]) -> Config:
    """Make a named configuration.

    The paper trains networks of a single class for fewer steps, with the smoothness loss at weight 0.001.

    Args:
        name: "paper"; "best", the best configuration known for a short training; or "small", with fewer steps.
        classes: Names of the classes to train on.

    Returns:
        The configuration.

    Raises:
        KeyError: The name is unknown.

    Example:
        >>> make_config("small", ["chair"]).steps
        4000
    """
    config = _CONFIGS[name]
    if name == "paper" and len(classes) == 1:
        steps = next((steps for names, steps in _STEPS.items() if classes[0] in names), 100_000)
        config = replace(config, smoothness=1e-3, steps=steps)
    return config
