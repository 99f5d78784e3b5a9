"""The rasteriser against the first published implementation's inputs and outputs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neural_renderer.raster.colors.texture_cubes import sample_textures
from neural_renderer.raster.ops.barycentrics import barycentrics
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.visibility.nmr import nmr_gradient
from tests.paths import GOLDEN

CASES = ("offscreen", "soup_all", "soup_alpha", "soup_depth", "soup_rgb", "tiny_faces")


def relative(found: torch.Tensor, expected: torch.Tensor) -> float:
    return float((found - expected).norm() / expected.norm())


@pytest.mark.parametrize("case", CASES)
def test_case(device, case):
    data = np.load(GOLDEN / f"raster_{case}.npz")

    def get(name: str) -> torch.Tensor:
        """A map, turned so that its row 0 is at the top; or another array."""
        tensor = torch.from_numpy(data[name]).to(device)
        is_map = name.removeprefix("grad_") in ("face_index", "weights", "zmap", "rgb", "alpha", "depth")
        return tensor.flip(1) if is_map else tensor

    faces = get("faces").requires_grad_()
    side, near, far, eps = int(data["size"]), float(data["near"]), float(data["far"]), float(data["eps"])
    index = coverage(faces.detach(), side, side, near, far, False, True)
    same = index == get("face_index")
    assert same.float().mean() >= 0.9999
    visible = same & (index >= 0)
    weights, depth = barycentrics(faces, index, near, far, True)
    z = faces.detach()[torch.arange(len(index))[:, None, None], index.clamp(min=0), :, 2]
    on_screen = weights * z / depth[..., None]
    # Accuracy of the vectors: that of another implementation in float32; gradients 1e-3.
    torch.testing.assert_close(on_screen[visible], get("weights")[visible], rtol=0, atol=1e-4)
    torch.testing.assert_close(depth[visible], get("zmap")[visible], rtol=1e-4, atol=1e-4)

    images, grads, loss = [], [], torch.zeros((), device=device)
    if "alpha" in data:
        images, grads = [(index >= 0).float()[:, None]], [get("grad_alpha")[:, None]]
        assert torch.equal(images[0][:, 0][same], get("alpha")[same])
    if "rgb" in data:
        textures = get("textures").requires_grad_()
        light = torch.ones(1, 2, faces.shape[1], 3, device=device)
        background = get("background").reshape(-1, 3, 1, 1).expand(len(index), 3, side, side)
        rgb = sample_textures(textures, light, background, faces.detach(), index, eps, True)
        torch.testing.assert_close(rgb.permute(0, 2, 3, 1)[same], get("rgb")[same], rtol=0, atol=1e-4)
        images, grads = [*images, rgb], [*grads, get("grad_rgb").permute(0, 3, 1, 2)]
    if images:
        image = torch.cat(images, 1)
        shown = None if len(images) == 1 and "alpha" in data else image
        loss = loss + (nmr_gradient(shown, faces, index, eps, False) * torch.cat(grads, 1)).sum()
    if "depth" in data:
        torch.testing.assert_close(depth[same], get("depth")[same], rtol=1e-4, atol=1e-4)
        loss = loss + (depth * get("grad_depth")).sum()
    loss.backward()
    assert relative(faces.grad, get("grad_faces")) <= 1e-3
    if "rgb" in data:
        assert relative(textures.grad, get("grad_textures")) <= 1e-3
