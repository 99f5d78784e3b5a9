"""The whole pipeline against the first published implementation's inputs and outputs, cameras' gradients included."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import neural_renderer as nr
from tests.paths import GOLDEN

CASES = {
    "look_at_rgb": "look_at",
    "look_at_silhouette": "look_at",
    "look_at_silhouette_noaa": "look_at",
    "look_depth": "look",
    "projection_rgb": "projection",
}


def relative(found: torch.Tensor, expected: torch.Tensor) -> float:
    return float((found - expected).norm() / expected.norm())


@pytest.mark.parametrize("case", CASES)
def test_case(device, case):
    data = np.load(GOLDEN / f"render_{case}.npz")

    def get(name: str) -> torch.Tensor:
        return torch.from_numpy(data[name]).to(device)

    arguments = {key[4:]: data[key].tolist() for key in data if key.startswith("arg_")}
    cameras = {key[4:]: get(key).requires_grad_() for key in data if key.startswith("cam_")}
    renderer = nr.Renderer(
        image_size=int(data["size"]),
        anti_aliasing=bool(data["anti_aliasing"]),
        fill_back=bool(data["fill_back"]),
        camera_mode=CASES[case],
        **arguments,
    )
    for name, value in cameras.items():
        setattr(renderer, name, value)
    vertices, faces = get("vertices").requires_grad_(), get("faces")
    inputs = {"vertices": vertices}
    if "rgb" in data:
        inputs["textures"] = get("textures").requires_grad_()
        images = dict(zip(("rgb", "depth", "alpha"), renderer(vertices, faces, inputs["textures"]), strict=True))
    elif "alpha" in data:
        images = {"alpha": renderer(vertices, faces, mode="silhouettes")}
    else:
        images = {"depth": renderer(vertices, faces, mode="depth")}
    # Accuracy of the vectors: values 1e-4, except at pixels with a centre on an edge; gradients 1e-3.
    for name, image in images.items():
        wrong = (image - get(name)).abs() > 1e-4 * get(name).abs().clamp(min=1)
        assert wrong.float().mean() <= 1e-4, name
    sum((image * get(f"grad_{name}")).sum() for name, image in images.items()).backward()
    for name, tensor in {**inputs, **{f"cam_{name}": value for name, value in cameras.items()}}.items():
        assert relative(tensor.grad, get(f"grad_{name}")) <= 1e-3, name
