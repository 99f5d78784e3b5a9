"""Properties of every public function that draws, for random scenes."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from torch import Tensor

import neural_renderer as nr
from tests.property.scenes import Pick, Scene, scenes
from tests.raster.scenes import examples

pytestmark = pytest.mark.usefixtures("deterministic")

SENTENCE = re.compile(r"^[\w ,.*\[\]-]+: expected .+, got .+", re.DOTALL)
Leaves = dict[str, Tensor]


def images_of(images: nr.Images) -> dict[str, Tensor]:
    return vars(images)


def render(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    mesh = pick(leaves["vertices"]), s.triangles(leaves["eye"].device), pick(leaves["textures"])
    options = {"light": s.lights(leaves, pick), "background": pick(leaves["background"]), "two_sided": s.two_sided}
    return images_of(nr.render(mesh, s.view(leaves, pick), s.size, **options, **s.options))


def render_one_mesh(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    """Without a batch, seen by all cameras, in front of pictures."""
    mesh = leaves["vertices"][0], s.triangles(leaves["eye"].device), leaves["textures"][0]
    options = {"light": s.lights(leaves, pick), "background": pick(leaves["picture"]), "two_sided": s.two_sided}
    return images_of(nr.render(mesh, s.view(leaves, pick), s.size, **options, **s.options))


def render_list(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    """Meshes of different sizes; they are copies without gradients to their sources."""
    triangles = s.triangles(leaves["eye"].device)
    if not len(triangles):
        return {}
    parts = zip(leaves["vertices"], leaves["textures"], range(1, s.batch + 1), strict=True)
    meshes = [nr.Mesh(v, triangles[:count], t[:count]) for v, t, count in parts]
    meshes = [meshes[n] for n in pick(torch.arange(s.batch))]
    return images_of(nr.render(meshes, s.view(leaves, pick), s.size, light=None, two_sided=s.two_sided, **s.options))


def render_uv(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    triangles = s.triangles(leaves["eye"].device)
    index = torch.arange(s.faces, device=triangles.device) % 3 - 1
    images = (leaves["image"], leaves["image"].flip(0)[:3])
    parts = leaves["vertices"][0], triangles, leaves["uv"], index, images, leaves["colors"], ("repeat", "clamp")
    options = {"light": s.lights(leaves, pick), "background": pick(leaves["background"]), "two_sided": s.two_sided}
    return images_of(nr.render(nr.UVMesh(*parts), s.view(leaves, pick), s.size, **options, **s.options))


def fragments(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    """Shading in torch, of normals, attributes and a texture."""
    mesh = pick(leaves["vertices"]), s.triangles(leaves["eye"].device)
    fragments = nr.fragments(mesh, s.view(leaves, pick), s.size, two_sided=s.two_sided, **s.options)
    mixed = fragments.interpolate(pick(leaves["attributes"]))
    normals = fragments.interpolate(nr.vertex_normals(*mesh))
    texture = nr.sample_texture(leaves["image"], mixed[..., :2], fragments.face_index)
    plain = nr.sample_texture(leaves["image"], mixed[..., :2], wrap="clamp")
    colors = torch.cat((normals, mixed, texture, plain), 3)
    image = fragments.composite(colors, 0.5, seams=s.gradient == "edge")
    return {"weights": fragments.weights, "depth": fragments.depth, "image": image}


def rasterize_images(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    options = {"textures": pick(leaves["textures"]), "light": pick(leaves["light"]), "two_sided": s.two_sided}
    options |= {"background": pick(leaves["background"]), "perspective": s.camera != "orthographic"}
    return images_of(nr.rasterize_images(pick(leaves["corners"]), s.size, **options, **s.options))


def old_functions(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    corners, textures = pick(leaves["corners"]), pick(leaves["textures"])
    lit = nr.lighting(corners, textures, direction=pick(leaves["direction"]))
    return {
        "rgb": nr.rasterize(corners, lit, s.size, **s.options),
        "alpha": nr.rasterize_silhouettes(corners, s.size, **s.options),
        "depth": nr.rasterize_depth(corners, s.size, **s.options),
    }


def renderer(s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor]:
    mode = {"projection": "projection", "mirrored": "look", "weak_perspective": "none"}.get(s.camera, "look_at")
    camera = {}
    if mode == "projection":
        lens = torch.tensor([[9.0, 0.1, 5.0], [0.0, 8.0, 4.0], [0.0, 0.0, 1.0]])[None]
        camera = {"K": lens, "R": torch.eye(3)[None], "t": torch.tensor([[[0.0, 0.0, 2.7]]]), "orig_size": (8, 10)}
    one = nr.Renderer(s.size, s.anti_aliasing, camera_mode=mode, fill_back=s.two_sided, **camera)
    one.near, one.far = s.near_far
    one.gradient, one.perspective = s.gradient, s.camera != "orthographic"
    one.eye = one.camera_direction = pick(leaves["eye"])
    one.background_color, one.light_direction = pick(leaves["background"]), pick(leaves["direction"])
    faces = s.triangles(leaves["eye"].device).expand(len(one.eye), -1, -1)
    rgb, depth, alpha = one(pick(leaves["vertices"]), faces, pick(leaves["textures"]))
    return {"rgb": rgb, "depth": depth, "alpha": alpha}


FUNCTIONS = (
    render, render_one_mesh, render_list, render_uv, fragments, rasterize_images, old_functions, renderer,
)  # fmt: skip


def drawn(function: Any, s: Scene, leaves: Leaves, pick: Pick) -> dict[str, Tensor] | None:
    """The images, or None if a sentence says why there are none."""
    try:
        return function(s, leaves, pick)
    except (TypeError, ValueError) as error:
        assert SENTENCE.match(str(error)), error
        assert not s.moderate, error
        return None


def check(function: Any, s: Scene, device: str) -> None:
    leaves = s.leaves(device)
    before = {name: (leaf.detach().clone(), leaf._version) for name, leaf in leaves.items()}
    images = drawn(function, s, leaves, lambda t: t)
    if not images:
        return
    near, far = (torch.tensor(value, dtype=torch.float32).item() for value in s.near_far)
    for name, image in images.items():
        assert image.dtype == torch.float32 and image.isfinite().all(), name
        low, high = {"alpha": (0, 1), "weights": (0, 1), "depth": (near, far)}.get(name, (-torch.inf, torch.inf))
        assert not image.numel() or (image.min() >= low and image.max() <= high), name
    if s.strided:  # strides change no bit
        contiguous = drawn(function, s, replace(s, strided=False).leaves(device), lambda t: t)
        assert all(torch.equal(contiguous[name], image) for name, image in images.items())
    # Bitwise equal with and without the rest of the batch: nothing is summed over the batch.
    for n in range(s.batch):
        alone = drawn(function, s, leaves, lambda t, n=n: t[n : n + 1])
        for name, image in images.items():
            assert n >= len(image) or torch.equal(alone[name][0], image[n]), name
    gradients = []
    for again in (images, drawn(function, s, leaves, lambda t: t)):
        assert all(torch.equal(image, again[name]) for name, image in images.items())
        random = s.generator
        pulls = [torch.randn(image.shape, generator=random).to(device) for image in again.values()]
        loss = sum((image * pull).sum() for image, pull in zip(again.values(), pulls, strict=True))
        gradients.append(
            torch.autograd.grad(loss, list(leaves.values()), allow_unused=True) if loss.requires_grad else ()
        )
    for name, first, second in zip(leaves, *gradients, strict=bool(gradients[0])):
        if first is not None:
            assert torch.equal(first, second), name
            assert s.dtype == torch.float16 or first.isfinite().all(), name  # beyond 65504 float16 is infinite
    for name, (value, version) in before.items():
        assert torch.equal(leaves[name], value) and leaves[name]._version == version, name


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
@examples(12)
@given(scene=scenes())
def test_a_few_scenes(device, function, scene):
    check(function, scene, device)


@pytest.mark.slow
@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: function.__name__)
@settings(max_examples=500, deadline=None, suppress_health_check=list(HealthCheck))
@given(scene=scenes())
def test_many_scenes(device, function, scene):
    check(function, scene, device)
